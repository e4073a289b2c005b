// The craft's parameters: read, searched, changed after a question, put back, and stored.

import { confirmed, send } from "./change.js";
import { at, element, reconcile, row, write, writeIn } from "./dom.js";

const SHOWN_MOST = 150;
let values = null; // by name, as the craft last said
let stored = {}; // what the craft keeps while it is switched off
const first = new Map(); // as this page read them first: what is put back
const digits = (value) => String(Number(value.toPrecision(7)));

export function watchParameters() {
  at("parameter-search").addEventListener("input", show);
  at("parameter-read").addEventListener("click", read);
  at("parameter-back").addEventListener("click", putBack);
  at("gains-store").addEventListener("click", store);
  at("gains-clear").addEventListener("click", clear);
  window.addEventListener("hashchange", () => {
    if (location.hash === "#parameters" && !values) read();
  });
  if (location.hash === "#parameters") read();
}

async function read() {
  write("parameter-state", "Reading…");
  const answer = await fetch("parameters").catch(() => null);
  const found = await answer?.json();
  if (!answer?.ok) {
    write("parameter-state", found?.error ?? "No answer.");
    return;
  }
  take(found.values);
  takeStored(found);
}

function takeStored(found) {
  stored = found.stored;
  const why = found.stores ? "" : "This craft's firmware stores no parameters.";
  for (const id of ["gains-store", "gains-clear"]) at(id).title = why;
  at("gains-store").disabled = !found.stores;
  at("gains-clear").disabled = !Object.keys(stored).some((name) => name.startsWith("pid_"));
  show();
}

function take(found) {
  values = { ...values, ...found };
  for (const [name, value] of Object.entries(values)) if (!first.has(name)) first.set(name, value);
  show();
}

const changed = () => Object.entries(values ?? {}).filter(([name, value]) => first.get(name) !== value);

function show() {
  if (!values) return;
  const wanted = at("parameter-search").value.toLowerCase();
  const names = Object.keys(values).filter((one) => one.toLowerCase().includes(wanted)).sort();
  const shown = names.slice(0, SHOWN_MOST);
  write("parameter-state", `${names.length} of ${Object.keys(values).length} parameters`
    + (shown.length < names.length ? `, the first ${shown.length} are shown: search for more` : ""));
  at("parameter-back").disabled = !changed().length;
  write("parameter-back", changed().length ? `Put back ${changed().length}` : "Put back");
  reconcile(at("parameter-rows"), shown, (one) => one, make, update);
}

function make(name) {
  const form = element("form", "inline-form"), input = element("input");
  input.type = "number";
  input.step = "any";
  input.required = true;
  input.setAttribute("aria-label", `New value of ${name}`);
  const set = element("button", "", "Set…");
  set.setAttribute("aria-label", `Set ${name}`);
  form.append(input, set);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    if (await change({ [name]: Number(input.value) })) input.value = "";
  });
  return row(name, "", form);
}

function update(shown, name) {
  const now = digits(values[name]), before = digits(first.get(name));
  const text = now === before ? now : `${now} (was ${before})`;
  writeIn(shown.cells[1], name in stored ? `${text}, stored ${digits(stored[name])}` : text);
}

async function change(wanted) {
  const lines = Object.entries(wanted).map(([name, value]) => `${name}: ${digits(values[name])} to ${digits(value)}`);
  if (!await confirmed("Change the craft's parameters?", lines.join("; "), "Change")) return false;
  const found = await send("parameters", JSON.stringify({ values: wanted }), "application/json",
    "Changed, and read back from the craft.");
  if (found) take(found.values);
  return Boolean(found);
}

const putBack = () => change(Object.fromEntries(changed().map(([name]) => [name, first.get(name)])));

async function keep(clears, done) {
  const found = await send("parameters/stored", JSON.stringify({ clear: clears }), "application/json", done);
  if (found) takeStored(found);
}

async function store() {
  if (await confirmed("Store the gains?", "The craft keeps the gains that it has now when it is switched off.",
    "Store")) await keep(false, "Stored, and read back from the craft.");
}

async function clear() {
  if (await confirmed("Clear the stored gains?", "The stock gains are back when the craft is switched off and on.",
    "Clear")) await keep(true, "Cleared. The gains stay until the craft is switched off.");
}
