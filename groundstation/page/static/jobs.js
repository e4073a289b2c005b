// Work on recordings: its state, and what came of it.

import { at, button, element, link, reconcile, watch } from "./dom.js";

/** change: asks for an operation of the control API; what it answered, or null. */
export function watchJobs(change) {
  watch("flights", "jobs", (jobs) => {
    reconcile(at("jobs"), jobs.toReversed(), (one) => one.id, (one) => make(one, change), update);
    const models = jobs.filter((one) => one.model_file).map((one) => one.id).toReversed();
    reconcile(at("model"), [...models, "thesis"], (one) => one, (one) => new Option(one), () => {});
  });
}

function make(job, change) {
  const row = element("tr");
  for (const text of [job.kind, "", job.recordings.join(", ") || job.model, ""]) row.append(element("td", "", text));
  const does = element("td"), links = element("span", "links");
  does.append(links);
  row.append(does);
  row.cancel = button("Cancel", job.id, () =>
    change("/jobs/cancel", { id: job.id }, `${job.id} is cancelled.`));
  return row;
}

function update(row, job) {
  if (row.shown === JSON.stringify(job)) return;
  row.shown = JSON.stringify(job);
  row.cells[1].textContent = job.state;
  row.cells[3].textContent = job.text;
  const name = encodeURIComponent(job.id), found = [];
  if (job.report) found.push(link(`file/report/${name}`, "Report", job.id));
  if (job.model_file) found.push(link(`file/model/${name}`, "Model", job.id, true));
  if (job.gains_file) found.push(link(`file/gains/${name}`, "Gains", job.id, true));
  found.push(link(`file/log/${name}`, "Log", job.id));
  if (job.state === "waiting" || job.state === "running") found.push(row.cancel);
  reconcile(row.cells[4].firstChild, found, (one) => one.textContent, (one) => one, () => {});
}
