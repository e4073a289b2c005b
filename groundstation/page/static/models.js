// The models that jobs have made: their numbers, and what can be done with them.

import { change } from "./change.js";
import { at, button as action, element, link, row, watch } from "./dom.js";

export function watchModels() {
  watch("models", "models", show);
}

function show(found) {
  const open = new Set([...document.querySelectorAll("#models details[open]")]
    .map((one) => one.dataset.model));
  const cards = found.models.toReversed().map((one) => card(one, found, open.has(one.id)));
  at("models").replaceChildren(...cards);
}

function card(one, { flown, watching }, open) {
  const made = element("section", "card wide model");
  const title = element("h2", "", one.id === "thesis" ? "thesis (built in)" : one.id);
  title.id = `model-${one.id}`;
  made.setAttribute("aria-labelledby", title.id);
  made.append(title);
  if (one.problem) {
    made.append(element("p", "", one.problem));
    return made;
  }
  const facts = element("dl");
  const fact = (name, value) => facts.append(element("dt", "", name), element("dd", "", value));
  fact("made by", one.kind === "built-in" ? "the thesis" : one.kind);
  if (one.recordings.length) fact("from", one.recordings.join(", "));
  if (one.validate.length) fact("proof", one.validate.join(", "));
  fact("vehicle", one.vehicle);
  fact("effects", one.effects.length ? one.effects.join(", ") : "none");
  made.append(facts, numbers(one, open));
  if (one.notes.length) {
    const notes = element("ul", "soft");
    notes.append(...one.notes.map((note) => element("li", "", note)));
    made.append(notes);
  }
  const does = element("div", "links");
  const flies = flown === one.id, watches = watching === one.id;
  does.append(
    button(flies ? "Flies in the stand-in" : "Fly in the stand-in", one.id, flies, () =>
      change("/link", { name: `stand-in:${one.id}` }, `The stand-in flies ${one.id}.`)),
    watches
      ? button("Watch no more", one.id, false, () =>
        change("/models/watch", { model: "" }, "No model watches the craft."))
      : button("Watch the craft with this", one.id, false, () =>
        change("/models/watch", { model: one.id }, `${one.id} watches the craft.`)));
  does.append(button("Design a controller", one.id, false, () =>
    change("/jobs/start", { kind: "design", model: one.id },
      "Started. See Jobs under Flights.")));
  if (one.report) does.append(link(`file/report/${encodeURIComponent(one.id)}`, "Report", one.id));
  if (one.file) does.append(link(`file/model/${encodeURIComponent(one.id)}`, "Model file", one.id, true));
  made.append(does);
  return made;
}

function numbers(one, open) {
  const details = element("details");
  details.dataset.model = one.id;
  details.open = open;
  details.append(element("summary", "", `${one.parameters.length} numbers`));
  const region = element("div", "scroll");
  region.tabIndex = 0;
  region.setAttribute("role", "region");
  region.setAttribute("aria-label", `Numbers of ${one.id}`);
  const table = element("table");
  const head = element("tr");
  for (const name of ["number", "value", "95 % from", "to", "unit", "meaning"]) {
    const cell = element("th", "", name);
    cell.scope = "col";
    head.append(cell);
  }
  const body = element("tbody");
  for (const number of one.parameters) {
    body.append(row(number.name, digits(number.value),
      ...(number.low === null ? [`– (${number.origin})`, "–"] : [digits(number.low), digits(number.high)]),
      number.unit, number.meaning));
  }
  const top = element("thead");
  top.append(head);
  table.append(top, body);
  region.append(table);
  details.append(region);
  return details;
}

const digits = (value) => value.toPrecision(5);

function button(text, of, disabled, work) {
  const made = action(text, of, work);
  made.disabled = disabled;
  return made;
}
