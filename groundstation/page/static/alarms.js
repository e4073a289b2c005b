// What must not be overlooked, in an area of its own that moves nothing else.

import { at, element, reconcile, writeIn } from "./dom.js";

export function showAlarms(alarms) {
  const text = JSON.stringify(alarms);
  if (at("alarms").dataset.shown === text) return; // or a screen reader says it ten times a second
  at("alarms").dataset.shown = text;
  reconcile(at("alarms"), alarms, (one) => `${one.level} ${one.text}`, make, update);
  const urgent = alarms.find((one) => one.level === "alarm");
  document.title = urgent ? `! ${urgent.text}` : "groundstation";
}

function make({ level, text, details }) {
  const item = element("li", level, details ? "" : text);
  if (level === "busy") {
    item.append(element("progress")); // of what nobody knows how long it takes
    item.lastChild.setAttribute("aria-label", text);
  }
  if (details) {
    const more = element("details", "why");
    more.append(element("summary", "", text), element("p"));
    item.append(more);
  }
  return item;
}

function update(item, { details }) {
  if (details) writeIn(item.querySelector("p"), details);
}
