// The operator's page: asks what is new, shows it, and passes on what the operator does.
// Nothing is ever queued for a browser: one that is slow asks seldom and gets fewer rows.

import { showAlarms } from "./alarms.js";
import { watchAnnounced } from "./announced.js";
import { change } from "./change.js";
import { Charts } from "./charts.js";
import { CraftView } from "./craft.js";
import { at, button, fixed, reconcile, write } from "./dom.js";
import { watchFlights } from "./flights.js";
import { watchJobs } from "./jobs.js";
import { watchModels } from "./models.js";
import { watchMotors } from "./motors.js";
import { watchOpened } from "./opened.js";
import { watchParameters } from "./parameters.js";
import { poseAt } from "./pose.js";
import { clockText, LIVE_S, showEvents, showStatus } from "./status.js";
import { Store } from "./store.js";
import { View, viewTools } from "./view.js";

const ASK_MS = 100; // ten times a second
const HIDDEN_MS = 1000;
const PATIENCE_MS = 10000;
const DRAW_MS = 200; // plots and numbers; the craft is drawn more often
const SCAN_MS = 30000;
const SHOWN_AFTER_S = 0.2; // the craft is drawn where it was then: rows come ten times a second
const DRIFT = 2e-4; // by which two clocks may part, of the time

const store = new Store(130);
let number = 0;
let statusNumber = 0;
let clockS = -Infinity; // of the machine's clock, on this browser's
let clockAskedMs = 0;
let newestMs = null; // on this browser's clock: when the newest row that is shown was measured
let lastAnswerMs = performance.now();
let vehicle = "";
let receives = false, scanned = false;

const nowS = () => (Number.isFinite(clockS) ? clockS + performance.now() / 1000 : 0);
const view = new View({ nowS, beginS: () => store.oldest() ?? 0, windowS: 20 });
const charts = new Charts(at("plots"), store, view,
  { shown: ["Attitude", "Rates", "Motors"], clockText, key: "groundstation-live" });
viewTools(at("view-tools"), view, charts, { live: true });
const craft = new CraftView(at("craft-view"), () => {
  const timeS = charts.cursor ?? (view.fixed ? view.fixed[1] : nowS() - SHOWN_AFTER_S);
  return poseAt(store, timeS, vehicle);
});

async function ask() {
  const askedMs = performance.now();
  try {
    const answer = await fetch(`now?after=${number}&status=${statusNumber}`,
      { signal: AbortSignal.timeout(PATIENCE_MS) });
    if (answer.status === 401) return showAlarms([{ level: "alarm", text:
      "This browser is no longer let in. Open the address that 'groundstation page' prints." }]);
    const found = await answer.json();
    lastAnswerMs = performance.now();
    take(found, askedMs);
  } catch {
    if (performance.now() - lastAnswerMs > 2000) showAlarms([{ level: "alarm", text:
      "The page gets no answer: the groundstation has ended, or is being started again." }]);
  }
  const wait = document.hidden ? HIDDEN_MS : ASK_MS - (performance.now() - askedMs);
  setTimeout(ask, Math.max(10, wait));
}

function take(found, askedMs) {
  number = found.number;
  statusNumber = found.status_number;
  // counted from the asking, so that the age that is shown is never less than the true one
  newestMs = found.age_s === null ? null : askedMs - 1000 * found.age_s;
  showAlarms(found.alarms);
  if (found.status) {
    vehicle = found.status.vehicle;
    receives = found.status.link.state === "streaming";
    showStatus(found.status);
  }
  if (found.events) showEvents(found.events);
  write("twin", found.twin_event ? found.twin_event.text : "no events");
  // it is no earlier than each answer says, and the quickest one says it best
  const answeredS = found.now_s - performance.now() / 1000;
  const slippedS = clockS - DRIFT * (askedMs - clockAskedMs) / 1000;
  clockS = Math.abs(answeredS - clockS) > 60 ? answeredS : Math.max(slippedS, answeredS);
  clockAskedMs = askedMs;
  store.add(found.tables);
}

function showNewest() {
  const newest = store.newest();
  if (newest === null) return;
  const pose = poseAt(store, newest, vehicle);
  write("battery", fixed(store.at("telemetry", "battery.voltage", newest), 2, "V"));
  for (const name of ["roll", "pitch", "yaw"]) write(name, fixed(pose[name], 1, "°"));
  at("horizon").setAttribute("transform",
    `rotate(${-(pose.roll ?? 0)}) translate(0 ${-Math.max(-60, Math.min(60, pose.pitch ?? 0))})`);
  const duties = pose.motors;
  write("motors", !duties ? "not sent" : duties.some((one) => one > 0)
    ? `running, ${(duties.reduce((a, b) => a + b) / duties.length).toFixed(0)} %` : "off");
  const [x, y, z] = pose.position;
  at("place").hidden = at("place-title").hidden = z === null;
  if (z !== null) write("place", x === null ? `${z.toFixed(2)} m high`
    : `${x.toFixed(2)}, ${y.toFixed(2)}, ${z.toFixed(2)} m`);
}

function draw() {
  const ageS = newestMs === null ? null : (performance.now() - newestMs) / 1000;
  const live = ageS !== null && ageS <= LIVE_S;
  write("live", ageS === null ? "no rows yet" : live ? "live" : `${ageS.toFixed(0)} s behind`);
  at("live").className = `badge ${live ? "good" : ageS === null ? "" : "bad"}`;
  showNewest();
  if (!view.fixed) charts.draw();
  setTimeout(() => requestAnimationFrame(draw), DRAW_MS); // hidden pages draw nothing
}

at("record").addEventListener("click", () => {
  const does = at("record").dataset.does;
  change(`/record/${does}`, null, does === "stop" ? "The recording is finished." : "Recording.");
});
at("mark").addEventListener("submit", async (event) => {
  event.preventDefault();
  const text = at("mark-text").value;
  if (await change("/record/mark", { text }, `Marked: ${text}`)) event.target.reset();
});
at("switch").addEventListener("submit", async (event) => {
  event.preventDefault();
  const name = at("link-name").value;
  if (await change("/link", { name }, `Receiving from ${name}.`)) event.target.reset();
});
document.addEventListener("keydown", (event) => {
  if (event.key !== "m" || event.ctrlKey || event.altKey || event.metaKey
      || event.target.closest("input, select, textarea")) return;
  event.preventDefault();
  location.hash = "#now";
  showPart();
  at("mark-text").focus();
});

let looking = false; // one request at a time: a browser has six for everything, Stop too

/** What there is to choose from, asked for when somebody is about to choose. */
async function offer() {
  if (looking) return;
  looking = true;
  try {
    const answer = await fetch("devices");
    if (!answer.ok) return;
    const { devices, links, commands } = await answer.json();
    showFound(devices.filter((one) => one.usable && one.link));
    const described = (one) => devices.find((device) => device.link === one)?.description ?? "";
    for (const [id, names] of [["links", links], ["commands", commands]]) {
      at(id).replaceChildren(...names.map((name) => new Option(described(name), name)));
    }
  } catch { /* the alarms say so */ } finally { looking = false; }
}
/** Crafts that are plugged in or in reach, a button each. */
function showFound(devices) {
  reconcile(at("found"), devices, (one) => one.link, (one) => {
    const made = button(`Receive from ${one.link}`, one.description, () =>
      change("/link", { name: one.link }, `Receiving from ${one.link}.`));
    made.className = "quiet";
    return made;
  }, () => {});
}

/** By itself at first, and then while there is nothing to receive: each look costs a second. */
function scan() {
  if (!document.hidden && (!scanned || !receives)) {
    scanned = true;
    offer();
  }
  setTimeout(scan, SCAN_MS);
}

for (const id of ["link-name", "command-uri"]) at(id).addEventListener("focus", offer);

function showPart() {
  const parts = [...document.querySelectorAll("main")].map((one) => one.id);
  const part = parts.find((name) => location.hash === `#${name}`) ?? "now";
  for (const name of parts) {
    at(name).hidden = name !== part;
    if (name === part) at(`to-${name}`).setAttribute("aria-current", "page");
    else at(`to-${name}`).removeAttribute("aria-current");
  }
}
window.addEventListener("hashchange", showPart);

showPart();
watchMotors();
watchAnnounced();
ask();
draw();
setTimeout(scan, 3000);
watchFlights();
watchJobs();
watchModels();
watchOpened();
watchParameters();
window.frames_drawn = () => craft.frames; // for who measures
