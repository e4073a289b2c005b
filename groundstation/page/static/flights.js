// The recordings folder: a list that is updated where it stands, and what is done with the chosen.

import { change } from "./change.js";
import { at, button, dated, element, link, reconcile, row, watch, write, writeIn } from "./dom.js";
import { openRecording } from "./opened.js";
import { begunAt } from "./status.js";

const WORDS = { finished: "complete", torn: "torn: see recover", recording: "being recorded" };

export function watchFlights() {
  watch("flights", "recordings", show);
  for (const work of document.querySelectorAll("#work button[data-kind]")) {
    work.addEventListener("click", async () => {
      const kind = work.dataset.kind, fits = kind === "fit";
      await change("/jobs/start", {
        kind, recordings: chosen("use"), validate: chosen("proof"),
        model: fits ? at("start").value : kind === "inspect" ? "" : at("model").value,
        effects: fits ? effects() : [], measured_rotors: fits && at("measured").checked,
      }, "Started. See Jobs.");
    });
  }
  at("with").addEventListener("toggle", async () => {
    await offerEffects();
    at("with").scrollIntoView({ block: "nearest" });
  });
}

const effects = () => [...document.querySelectorAll("#effects input:checked")].map((one) => one.value);

/** Asked for once, when somebody wants to choose. */
async function offerEffects() {
  if (at("effects").firstChild) return;
  const answer = await fetch("effects");
  if (!answer.ok) return;
  at("effects").replaceChildren(...(await answer.json()).map(({ name, adds }) => {
    const label = element("label"), box = element("input");
    box.type = "checkbox";
    box.value = name;
    box.addEventListener("change", () => write("with-what", effects().join(", ") || "none"));
    label.append(box, ` ${name.replaceAll("_", " ")}`, element("span", "soft", `: ${adds}`));
    return label;
  }));
}

/** Files by their role: use or proof. */
export function chosen(role) {
  return [...document.querySelectorAll("#recordings select")]
    .filter((one) => one.value === role).map((one) => one.name);
}

function show(recordings) {
  // the one that is being written has no time yet
  const newestFirst = recordings.toSorted((a, b) =>
    (b.start_ns ?? Infinity) - (a.start_ns ?? Infinity) || 0);
  reconcile(at("recordings"), newestFirst, (one) => one.file, make, update);
}

function make(one) {
  const select = element("select");
  select.name = one.file;
  select.setAttribute("aria-label", `Role of ${one.file}`);
  select.append(new Option("–", ""), new Option("fit", "use"), new Option("proof", "proof"));
  const links = element("span", "links");
  links.append(button("Open", one.file, () => openRecording(one.file)),
    link(`file/recording/${encodeURIComponent(one.file)}`, "Download", one.file, true));
  return row(select, one.file, "", "", "", "", "", links);
}

function update(shown, one) {
  const records = one.state === "recording";
  const began = one.start_ns ? one.start_ns / 1e6 : begunAt(one.file);
  const long = one.duration_s ?? (records && began ? (Date.now() - began) / 1000 : null);
  const texts = { 2: began ? dated(began) : "",
    3: long === null ? "" : `${long.toFixed(1)} s`, 4: one.link ?? "",
    5: `${(one.bytes / 1e6).toFixed(1)} MB`, 6: WORDS[one.state] ?? one.state };
  for (const [place, text] of Object.entries(texts)) {
    writeIn(shown.cells[place], text);
  }
}
