// The recordings folder: a list that is updated where it stands, and what is done with the chosen.

import { change } from "./change.js";
import { at, button, dated, element, link, reconcile, watch, write, writeIn } from "./dom.js";
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
      }, "Begun; its state is in the list of jobs.");
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
  const row = element("tr");
  const cells = [select, one.file, "", "", "", "", "", "",
    element("span", "links")];
  cells[8].append(button("Open", one.file, () => openRecording(one.file)),
    link(`file/recording/${encodeURIComponent(one.file)}`, "Download", one.file, true));
  for (const content of cells) {
    const cell = element("td");
    cell.append(content);
    row.append(cell);
  }
  return row;
}

function update(row, one) {
  const records = one.state === "recording";
  const began = one.start_ns ? one.start_ns / 1e6 : begunAt(one.file);
  const long = one.duration_s ?? (records && began ? (Date.now() - began) / 1000 : null);
  const texts = { 3: began ? dated(began) : "",
    4: long === null ? "" : `${long.toFixed(1)} s`, 5: one.link ?? "",
    6: `${(one.bytes / 1e6).toFixed(1)} MB`, 7: WORDS[one.state] ?? one.state };
  for (const [place, text] of Object.entries(texts)) {
    writeIn(row.cells[place], text);
  }
  if (!records && !row.cells[2].firstElementChild) row.cells[2].append(picture(one));
}

const LOADING_MOST = 2; // of the six requests that a browser has for all its pages, Stop among them
const waiting = [];
let loading = 0;

function loadNext() {
  while (loading < LOADING_MOST && waiting.length) {
    const { made, src } = waiting.shift();
    loading += 1;
    for (const end of ["load", "error"]) made.addEventListener(end, ended, { once: true });
    made.src = src;
  }
}

function ended() {
  loading -= 1;
  loadNext();
}

const seen = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    if (!isIntersecting) continue;
    seen.unobserve(target);
    waiting.push({ made: target, src: target.dataset.src });
  }
  loadNext();
});

function picture(one) {
  const made = element("img");
  made.width = 160;
  made.height = 40;
  made.alt = `Motors, roll and pitch of ${one.file}`;
  made.dataset.src = `file/thumbnail/${encodeURIComponent(one.file)}`;
  seen.observe(made); // drawn by the daemon when somebody looks
  return made;
}
