// Work on recordings: how far it is, and what came of it.

import { change, confirmed } from "./change.js";
import { at, button, element, link, reconcile, watch } from "./dom.js";

export function watchJobs() {
  at("learn").addEventListener("click", () => learn(""));
  watch("flights", "jobs", (jobs) => {
    reconcile(at("jobs"), jobs.toReversed(), (one) => one.id, make, update);
    const models = jobs.filter((one) => one.model_file).map((one) => one.id).toReversed();
    const option = (one) => new Option(one || "the vehicle's profile", one);
    reconcile(at("model"), [...models, "thesis"], (one) => one, option, () => {});
    reconcile(at("start"), ["", ...models], (one) => one, option, () => {});
  });
  setInterval(() => {
    for (const row of at("jobs").children) row.tell?.();
  }, 1000);
}

/** Fly the craft and learn it, in the folder of an earlier job where one is named. */
async function learn(model) {
  if (await confirmed("Learn this craft?",
    "It takes off by itself several times. Each take-off is announced here 10 s before, with a sound. "
    + "Land and Stop motors end all of it. Is everybody away, and is there room?", "Fly and learn"))
    change("/jobs/start", { kind: "learn", model }, "Started. See Jobs.");
}

function make(job) {
  const row = element("tr");
  const state = element("td"), word = element("span"), bar = element("progress");
  bar.setAttribute("aria-label", `How far ${job.id} is`);
  state.append(word, bar);
  const found = element("td"), links = element("span", "links"), does = element("td");
  does.append(links);
  row.append(element("td", "", job.kind), state, element("td", "", on(job)), found, does);
  const cancel = button("Cancel", job.id, () =>
    change("/jobs/cancel", { id: job.id }, `${job.id} is cancelled.`));
  const text = element("p"), again = element("p");
  found.append(text, again);
  row.tell = () => {
    const { state: now, began_ns: began, ended_ns: ended, stage, share } = row.job;
    const long = now === "waiting" || !began ? "" : `, ${spell(((ended || Date.now() * 1e6) - began) / 1e9)}`;
    word.textContent = now + long;
    bar.hidden = now !== "running";
    if (share === null) bar.removeAttribute("value");
    else bar.value = share;
    text.textContent = now === "running" ? stage || "beginning" : row.job.text;
  };
  row.show = () => {
    const name = encodeURIComponent(job.id), { state: now, advice } = row.job, see = [];
    if (row.job.report) see.push(link(`file/report/${name}`, "Report", job.id));
    if (row.job.model_file) see.push(link(`file/model/${name}`, "Model", job.id, true));
    if (row.job.gains_file) see.push(link(`file/gains/${name}`, "Gains", job.id, true));
    see.push(link(`file/log/${name}`, "Log", job.id));
    if (now === "waiting" || now === "running") see.push(cancel);
    else if (job.kind === "learn" && now !== "done") see.push(button("Go on", job.id, () => learn(job.model || job.id)));
    reconcile(links, see, (one) => one.textContent, (one) => one, () => {});
    again.replaceChildren(...advised(row.job, advice));
  };
  return row;
}

/** What a fit advises, and the button that does it. */
function advised(job, { effects, measured_rotors: measured }) {
  if (!effects.length && !measured) return [];
  const what = [...effects.map((one) => one.replaceAll("_", " ")), ...(measured ? ["recorded rotor speeds"] : [])];
  const made = button("Fit again with these", job.id, () => change("/jobs/start", {
    kind: "fit", recordings: job.recordings, validate: job.validate, model: job.model,
    effects: [...new Set([...job.effects, ...effects])], measured_rotors: job.measured_rotors || measured,
  }, "Started. See Jobs."));
  return [`The fit advises: ${what.join(", ")}. `, made];
}

function update(row, job) {
  row.job = job;
  row.tell();
  const shown = JSON.stringify([job.state, job.report, job.model_file, job.gains_file, job.advice]);
  if (row.shown !== shown) row.show();
  row.shown = shown;
}

function on(job) {
  const parts = [];
  if (job.recordings.length) parts.push((job.validate.length || job.kind === "fit" ? "fit: " : "") + job.recordings.join(", "));
  if (job.validate.length) parts.push(`proof: ${job.validate.join(", ")}`);
  else if (["fit", "discrepancy"].includes(job.kind)) parts.push("proof: a third of each");
  if (job.kind === "learn") parts.push(job.model ? `the craft, going on with ${job.model}` : "the craft");
  else if (job.model) parts.push(`model: ${job.model}`);
  if (job.effects.length) parts.push(`with ${job.effects.join(", ")}`);
  if (job.measured_rotors) parts.push("recorded rotor speeds");
  return parts.join("; ");
}

const spell = (s) => (s < 60 ? `${s.toFixed(0)} s` : `${Math.floor(s / 60)} min ${Math.floor(s % 60)} s`);
