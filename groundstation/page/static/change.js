// What the operator does: passed on to the control API, after a question where it cannot be undone.

import { at, write } from "./dom.js";

const SHOWN_MS = 30000; // an older result may contradict what is so now
const token = document.querySelector("meta[name=change-token]").content;
const timers = new Map();

/** Shows a result for 30 s; stays: until it is replaced. */
export function tell(id, text, stays = false) {
  write(id, text);
  clearTimeout(timers.get(id));
  if (!stays) timers.set(id, setTimeout(() => write(id, ""), SHOWN_MS));
}

/** One of the control API's operations; what it answered, or null where it refused.
 * done: what is said then; nothing where it is null. */
export async function change(path, content, done) {
  const body = content === null ? null : JSON.stringify(content);
  return send(`do${path}`, body, "application/json", done);
}

/** The same with anything as its body. */
export async function send(address, body, type, done) {
  if (done !== null) tell("said", "…", true);
  try {
    const answer = await fetch(address, {
      method: "POST", headers: { "X-Change-Token": token, "Content-Type": type }, body,
    });
    const found = await answer.json();
    if (!answer.ok) tell("said", found.error);
    else if (done !== null) tell("said", done);
    return answer.ok ? found : null;
  } catch {
    tell("said", "No answer: it is not known whether this was done.");
    return null;
  }
}

const question = at("question");
// Land and Stop can be pressed while something is asked, and nothing else
const others = document.querySelectorAll("header, main, .does");
let answer = () => {}, askedFrom = null;

/** Asks whether to go on. word: on the button that does. */
export function confirmed(title, text, word) {
  answered(false); // whoever asked before
  write("question-title", title);
  write("question-text", text);
  write("question-yes", word);
  askedFrom = document.activeElement;
  for (const one of others) one.inert = true;
  question.show();
  return new Promise((go) => { answer = go; });
}

function answered(yes) {
  if (!question.open) return;
  question.close();
  for (const one of others) one.inert = false;
  askedFrom?.focus();
  answer(yes);
}

at("question-answer").addEventListener("submit", (event) => {
  event.preventDefault();
  answered(event.submitter.value === "yes");
});

const menus = () => [...document.querySelectorAll("details:is(.chooser, .why)[open]")];

document.addEventListener("click", (event) => {
  for (const one of menus()) if (!one.contains(event.target)) one.open = false;
});

/** Closes the question, else the menus that can be seen; whether anything was open. */
export function closeOpen() {
  if (question.open) {
    answered(false);
    return true;
  }
  const open = menus().filter((one) => one.checkVisibility());
  for (const one of open) {
    if (one.contains(document.activeElement)) one.querySelector("summary").focus();
    one.open = false;
  }
  return open.length > 0;
}
