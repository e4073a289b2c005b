// What must not be overlooked, in an area of its own that moves nothing else.

import { at, element } from "./dom.js";

export function showAlarms(alarms) {
  const text = JSON.stringify(alarms);
  if (at("alarms").dataset.shown === text) return; // or a screen reader says it ten times a second
  at("alarms").dataset.shown = text;
  at("alarms").replaceChildren(...alarms.map((one) => {
    const item = element("li", one.level, one.text);
    if (one.level === "busy") {
      item.append(element("progress")); // of what nobody knows how long it takes
      item.lastChild.setAttribute("aria-label", one.text);
    }
    return item;
  }));
  const urgent = alarms.find((one) => one.level === "alarm");
  document.title = urgent ? `! ${urgent.text}` : "groundstation";
}
