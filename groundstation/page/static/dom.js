// Elements, and lists that are asked for while they are looked at.

const ASK_MS = 2000;
export const at = (id) => document.getElementById(id);

/** Only where it changes: what is the same is not read out again. */
export function writeIn(one, text) {
  if (one.textContent !== text) one.textContent = text;
}

export const write = (id, text) => writeIn(at(id), text);

/** A number with so many decimals, of which none is left of a small negative one but its sign. */
export const decimals = (value, digits) => value.toFixed(digits).replace(/^-(?=[0.]+$)/, "");

export const fixed = (value, digits, unit) =>
  value === null || value === undefined ? "–" : `${decimals(value, digits)} ${unit}`;

/** The time of day, and with its date, of ms since 1970. */
export const clock = (ms) => new Date(ms).toLocaleTimeString("sv");
export const dated = (ms) => new Date(ms).toLocaleString("sv"); // 2026-11-28 09:29:40

export function element(kind, style = "", text = "") {
  const made = document.createElement(kind);
  if (style) made.className = style;
  if (text) made.textContent = text;
  return made;
}

export function cell(content) {
  const made = element("td");
  made.append(content);
  return made;
}

/** A row of a table, with a cell for each content. */
export function row(...contents) {
  const made = element("tr");
  made.append(...contents.map(cell));
  return made;
}

/** A button that says by its own words what it does. */
export function pressable(style, text, work) {
  const made = element("button", style, text);
  made.type = "button";
  made.addEventListener("click", work);
  return made;
}

/** of: what it acts on, for those who hear the page. */
export function button(text, of, work) {
  const made = pressable("", text, work);
  made.setAttribute("aria-label", `${text}: ${of}`);
  return made;
}

export function link(address, text, of, download) {
  const made = element("a", "", text);
  made.href = address;
  if (download) made.download = "";
  else made.target = "_blank";
  made.setAttribute("aria-label", `${text} of ${of}`);
  return made;
}

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

/** Brings the children of ``parent`` in line with ``items``: those that are there already are
 * updated where they stand, so that focus, open menus and what was chosen stay.
 * key: of an item; make: its element; update: (element, item), for old and new ones. */
export function reconcile(parent, items, key, make, update) {
  const before = new Map([...parent.children].map((one) => [one.dataset.key, one]));
  let place = parent.firstElementChild;
  for (const item of items) {
    const name = String(key(item));
    let one = before.get(name);
    if (one) before.delete(name);
    else {
      one = make(item);
      one.dataset.key = name;
    }
    if (one === place) place = place.nextElementSibling;
    else parent.insertBefore(one, place);
    update(one, item);
  }
  for (const one of before.values()) one.remove();
}
