// What the operator does: passed on to the control API, after a question where it cannot be undone.

import { at, write } from "./dom.js";

const token = document.querySelector("meta[name=change-token]").content;

/** One of the control API's operations; what it answered, or null where it refused.
 * done: what is said then; nothing where it is null. */
export async function change(path, content, done) {
  const body = content === null ? null : JSON.stringify(content);
  return send(`do${path}`, body, "application/json", done);
}

/** The same with anything as its body. */
export async function send(address, body, type, done) {
  if (done !== null) write("said", "…");
  try {
    const answer = await fetch(address, {
      method: "POST", headers: { "X-Change-Token": token, "Content-Type": type }, body,
    });
    const found = await answer.json();
    if (!answer.ok) write("said", found.error);
    else if (done !== null) write("said", done);
    return answer.ok ? found : null;
  } catch {
    write("said", "No answer: it is not known whether this was done.");
    return null;
  }
}

/** Asks whether to go on. word: on the button that does. */
export function confirmed(title, text, word) {
  const dialog = at("question");
  write("question-title", title);
  write("question-text", text);
  write("question-yes", word);
  dialog.returnValue = "";
  dialog.showModal();
  return new Promise((go) => dialog.addEventListener("close",
    () => go(dialog.returnValue === "yes"), { once: true }));
}
