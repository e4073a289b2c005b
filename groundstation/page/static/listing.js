// What the lists of flights and of models share.

const ASK_MS = 2000;
export const at = (id) => document.getElementById(id);

/** Asks for ``address`` while the part of that name is looked at; show: given what is new of it. */
export function watch(part, address, show) {
  let shown = "";
  const look = async () => {
    if (!at(part).hidden && !document.hidden) {
      try {
        const answer = await fetch(address);
        const text = answer.ok ? await answer.text() : shown;
        if (text !== shown) { // what is chosen, open or read stays as it is
          shown = text;
          show(JSON.parse(text));
        }
      } catch { /* the alarms say so */ }
    }
    setTimeout(look, ASK_MS);
  };
  look();
}

export function link(address, text, of, download) {
  const made = document.createElement("a");
  made.href = address;
  if (download) made.download = "";
  else made.target = "_blank";
  made.textContent = text;
  made.setAttribute("aria-label", `${text} of ${of}`);
  return made;
}
