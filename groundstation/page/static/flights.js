// Recordings and the work on them: a list each, asked for while they are looked at.

import { at, link, watch } from "./listing.js";

const WORDS = { finished: "complete", torn: "torn: see recover", recording: "being recorded" };

const pictures = new Map(); // of files
const drawn = new Map(); // of lists, as text

/** change: asks for an operation of the control API; what it answered, or null. */
export function watchFlights(change) {
  watch("flights", "flights", (found) => {
    if (isNew("recordings", found.recordings)) showRecordings(found.recordings);
    if (isNew("jobs", found.jobs)) showJobs(found.jobs, change);
  });
  for (const button of document.querySelectorAll("#work button[data-kind]")) {
    button.addEventListener("click", async () => {
      const chosen = [...document.querySelectorAll("#recordings select")];
      const files = (use) => chosen.filter((one) => one.value === use).map((one) => one.name);
      await change("/jobs/start", {
        kind: button.dataset.kind, recordings: files("use"), validate: files("hold out"),
        model: ["compare", "discrepancy"].includes(button.dataset.kind) ? at("model").value : "",
      }, "Begun; its state is in the list of jobs.");
    });
  }
}

/** A list stays as it is, and can be clicked, while only the other one changes. */
function isNew(name, rows) {
  const text = JSON.stringify(rows), changed = text !== drawn.get(name);
  drawn.set(name, text);
  return changed;
}

function showRecordings(recordings) {
  const uses = new Map([...document.querySelectorAll("#recordings select")]
    .map((one) => [one.name, one.value]));
  // the one that is being written has no time yet
  const newestFirst = recordings.toSorted((a, b) =>
    (b.start_ns ?? Infinity) - (a.start_ns ?? Infinity) || 0);
  at("recordings").replaceChildren(...newestFirst.map((one) =>
    recordingRow(one, uses.get(one.file))));
}

function showJobs(jobs, change) {
  at("jobs").replaceChildren(...jobs.toReversed().map((job) => jobRow(job, change)));
  const models = jobs.filter((job) => job.model_file).map((job) => job.id).toReversed();
  const before = at("model").value;
  at("model").replaceChildren(...[...models, "thesis"].map((name) => new Option(name)));
  if ([...models, "thesis"].includes(before)) at("model").value = before;
}

function recordingRow(one, use) {
  const select = document.createElement("select");
  select.name = one.file;
  select.setAttribute("aria-label", `What ${one.file} is for`);
  select.append(...["–", "use", "hold out"].map((name) => new Option(name)));
  select.value = use ?? "–";
  const when = one.start_ns ? new Date(one.start_ns / 1e6).toLocaleString() : "";
  return row(select, when, one.state === "recording" ? "" : picture(one), one.file,
    one.duration_s === null ? "" : `${one.duration_s.toFixed(1)} s`, one.link ?? "",
    `${(one.bytes / 1e6).toFixed(1)} MB`, WORDS[one.state] ?? one.state,
    link(`file/recording/${encodeURIComponent(one.file)}`, "Download", one.file, true));
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
  if (pictures.has(one.file)) return pictures.get(one.file); // rows are made anew, these are not
  const made = document.createElement("img");
  made.width = 160;
  made.height = 40;
  made.alt = `Motors, roll and pitch of ${one.file}`;
  pictures.set(one.file, made);
  made.dataset.src = `file/thumbnail/${encodeURIComponent(one.file)}`;
  seen.observe(made); // drawn by the daemon when somebody looks
  return made;
}

function jobRow(job, change) {
  const does = document.createElement("span");
  does.className = "links";
  const name = encodeURIComponent(job.id);
  if (job.report) does.append(link(`file/report/${name}`, "Report", job.id));
  if (job.model_file) does.append(link(`file/model/${name}`, "Model", job.id, true));
  if (job.gains_file) does.append(link(`file/gains/${name}`, "Gains", job.id, true));
  does.append(link(`file/log/${name}`, "Log", job.id));
  if (job.state === "waiting" || job.state === "running") {
    const button = document.createElement("button");
    button.textContent = "Cancel";
    button.addEventListener("click", () =>
      change("/jobs/cancel", { id: job.id }, `${job.id} is cancelled.`));
    does.append(button);
  }
  return row(job.kind, job.state, job.recordings.join(", ") || job.model, job.text, does);
}

function row(...cells) {
  const made = document.createElement("tr");
  for (const content of cells) {
    const cell = document.createElement("td");
    cell.append(content);
    made.append(cell);
  }
  return made;
}
