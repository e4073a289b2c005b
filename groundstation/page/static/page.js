// The operator's page: asks what is new, draws it, and passes on what the operator does.
// Nothing is ever queued for a browser: one that is slow asks seldom and gets fewer rows.

import { watchFlights } from "./flights.js";
import { watchModels } from "./models.js";
import { Plot } from "./plot.js";

const ASK_MS = 100; // ten times a second
const HIDDEN_MS = 1000;
const PATIENCE_MS = 10000;
const LIVE_S = 1.0; // what is older is said to be behind
const token = document.querySelector("meta[name=change-token]").content;
const at = (id) => document.getElementById(id);

const plots = [
  new Plot(at("attitude-plot"), at("attitude-legend"), "attitude_deg", ["roll", "pitch", "yaw"]),
  new Plot(at("gyro-plot"), at("gyro-legend"), "gyro_dps", ["x", "y", "z"]),
  new Plot(at("motors-plot"), at("motors-legend"), "motors_pct", ["M1", "M2", "M3", "M4"]),
];

let number = 0;
let statusNumber = 0;
let beginMs = -Infinity; // of the machine's clock, on this browser's
let newestMs = null; // on this browser's clock: when the newest row that is shown was measured
let lastAnswerMs = performance.now();
let recordingRate = null;

function write(id, text) {
  const element = at(id);
  if (element.textContent !== text) element.textContent = text;
}

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
      "The page gets no answer: the groundstation has ended, or is being begun anew." }]);
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
  if (found.status) showStatus(found.status);
  if (found.events) showEvents(found.events);
  write("twin", found.twin_event ? found.twin_event.text : "nothing told");
  if (found.rows.length) showRow(found.rows[found.rows.length - 1]);
  // it is no earlier than each asking says, and the quickest answer says it best
  const begunMs = askedMs - 1000 * found.now_s;
  if (Math.abs(begunMs - beginMs) > 60000) beginMs = begunMs; // a slept or another machine
  beginMs = Math.max(beginMs, begunMs);
  for (const plot of plots) plot.add(found.rows, beginMs + 1000 * found.now_s);
}

function showAlarms(alarms) {
  const text = JSON.stringify(alarms);
  if (at("alarms").dataset.shown === text) return; // or a screen reader says it ten times a second
  at("alarms").dataset.shown = text;
  at("alarms").replaceChildren(...alarms.map((one) => {
    const item = document.createElement("li");
    item.className = one.level;
    item.textContent = one.text;
    if (one.level === "busy") {
      item.append(document.createElement("progress")); // of what nobody knows how long it takes
      item.lastChild.setAttribute("aria-label", one.text);
    }
    return item;
  }));
  const urgent = alarms.find((one) => one.level === "alarm");
  document.title = urgent ? `! ${urgent.text}` : "groundstation";
}

const fixed = (value, digits, unit) =>
  value === null || value === undefined ? "–" : `${value.toFixed(digits)} ${unit}`;

function showRow(row) {
  write("battery", fixed(row.battery_v, 2, "V"));
  const [roll, pitch, yaw] = row.attitude_deg ?? [null, null, null];
  write("roll", fixed(roll, 1, "°"));
  write("pitch", fixed(pitch, 1, "°"));
  write("yaw", fixed(yaw, 1, "°"));
  at("horizon").setAttribute("transform",
    `rotate(${-(roll ?? 0)}) translate(0 ${-Math.max(-60, Math.min(60, pitch ?? 0))})`);
  const duties = row.motors_pct;
  write("motors", !duties ? "not told" : duties.some((one) => one > 0)
    ? `running, ${(duties.reduce((a, b) => a + b) / duties.length).toFixed(0)} %` : "off");
}

function showStatus(status) {
  const { link, recording, command, statistics } = status;
  write("link", `${link.name}: ${link.state}`);
  at("link").className = `badge ${link.state === "streaming" || link.pauses ? "good" : "bad"}`;
  write("rate", `${link.rate_hz.toFixed(0)} a second`);
  write("loss", statistics ? `${statistics.loss_pct.toFixed(2)} % lately, ${link.lost} in all` : "–");
  write("late", fixed(link.latency_ms, 1, "ms"));
  write("vehicle", status.vehicle);
  showViewer(status.viewer);
  write("doing", link.doing);
  at("doing").hidden = at("doing-title").hidden = !link.doing;
  write("command", !command ? "no command link" : `${command.uri} ${command.state}`
    + (command.client ? `, ${command.client} commands` : ""));
  at("stop-why").className = command && !command.out_of_reach ? "soft" : "bad";
  write("stop-why", !command ? "No command link: these motors cannot be stopped from here."
    : command.out_of_reach ? `${command.out_of_reach}.` : command.state === "connected" ? "At once, whoever commands." : `The command link is ${command.state}.`);
  at("stop").disabled = !command;
  at("level").disabled = !command?.client;
  const connected = command?.state === "connected";
  const today = connected && command.firmware === "2.x"; // older firmware knows no arming
  at("arm").disabled = !today || command.armed === true;
  at("disarm").disabled = !today || command.armed === false;
  at("recover").hidden = !(connected && command.crashed);
  write("armed", !connected ? "–" : command.armed === null ? (today ? "not told" : "always")
    : (command.armed ? "yes" : "no") + (command.hindrance ? `: ${command.hindrance}` : ""));
  at("connect").hidden = connected;
  at("level").setAttribute("aria-pressed", String(Boolean(command?.held_level)));
  showBattery(status.battery);
  showRecording(recording);
}

function showViewer({ state, viewers, behind_s: behind, urls }) {
  const text = state !== "serving" ? state : !viewers ? "nobody looks"
    : behind > LIVE_S ? `${behind.toFixed(0)} s behind` : "live";
  if (at("viewer").dataset.shown === text + urls[0]) return;
  at("viewer").dataset.shown = text + urls[0];
  at("viewer").replaceChildren(text);
  if (state !== "serving") return;
  const open = document.createElement("a");
  open.href = urls[0];
  open.target = "_blank";
  open.rel = "noreferrer";
  open.textContent = "open it";
  at("viewer").append(" · ", open);
}

function showBattery({ flown_s: flown, left_s: left, known }) {
  const spell = (s) => `${Math.floor(s / 60)}:${String(Math.floor(s % 60)).padStart(2, "0")}`;
  const as = known === 1 ? "the battery before it" : `the last ${known} batteries`;
  const less = !left ? (known ? "time left not known yet"
    : "time left not known: no battery of this craft was flown until low here")
    : left[1] <= 0 ? "low: land" : `${spell(left[0])} to ${spell(left[1])} min left, as ${as}`;
  write("battery-left", `${spell(flown)} min flown; ${less}`);
}

function showRecording(recording) {
  const records = recording.state === "recording";
  write("recording", records ? `${(recording.bytes / 1e6).toFixed(1)} MB` : recording.state);
  write("file", recording.file ?? "no file yet");
  const nowS = performance.now() / 1000;
  if (!records) recordingRate = null;
  else if (recordingRate?.file !== recording.file)
    recordingRate = { file: recording.file, bytes: recording.bytes, sinceS: nowS };
  let left = "";
  if (recordingRate && nowS - recordingRate.sinceS > 5) {
    const perS = (recording.bytes - recordingRate.bytes) / (nowS - recordingRate.sinceS);
    if (perS > 0) left = `, enough for ${duration(recording.free_mb * 1e6 / perS)}`;
  }
  write("disk", recording.free_mb === null ? "" :
    `${(recording.free_mb / 1000).toFixed(1)} GB free${left}`);
  const button = at("record");
  button.disabled = false;
  button.dataset.does = recording.wanted ? "stop" : "start";
  write("record", recording.wanted ? "Stop recording" : "Start recording");
}

function duration(seconds) {
  if (seconds > 2 * 86400) return `${(seconds / 86400).toFixed(0)} days`;
  if (seconds > 2 * 3600) return `${(seconds / 3600).toFixed(0)} hours`;
  return `${(seconds / 60).toFixed(0)} minutes`;
}

function showEvents(events) {
  at("events").replaceChildren(...events.toReversed().map((event) => {
    const item = document.createElement("li");
    const time = document.createElement("time");
    time.textContent = new Date(event.time_ns / 1e6).toLocaleTimeString();
    item.append(time, `${event.link} ${event.kind}: ${event.text}`);
    return item;
  }));
}

function draw() {
  const nowMs = performance.now();
  const ageS = newestMs === null ? null : (nowMs - newestMs) / 1000;
  const live = ageS !== null && ageS <= LIVE_S;
  write("live", ageS === null ? "no rows yet" : live ? "live" : `${ageS.toFixed(0)} s behind`);
  at("live").className = `badge ${live ? "good" : "bad"}`;
  for (const plot of plots) plot.draw(nowMs);
  setTimeout(() => requestAnimationFrame(draw), ASK_MS); // hidden pages draw nothing
}

/** One of the control API's operations; what it answered, or null where it refused. */
async function change(path, content, done) {
  write("said", "…");
  try {
    const answer = await fetch(`do${path}`, {
      method: "POST",
      headers: { "X-Change-Token": token, "Content-Type": "application/json" },
      body: content === null ? null : JSON.stringify(content),
    });
    const found = await answer.json();
    write("said", answer.ok ? (found.motors ? `Motors: ${found.motors}.` : done) : found.error);
    return answer.ok ? found : null;
  } catch {
    write("said", "No answer: it is not known whether this was done.");
    return null;
  }
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
const stopMotors = () => change("/command/stop", null, "Asked to stop the motors.");
const holdLevel = () => {
  const on = at("level").getAttribute("aria-pressed") !== "true";
  change("/command/level", { on }, on ? "Held level." : "The attitude is the client's again.");
};
at("stop").addEventListener("click", stopMotors);
at("level").addEventListener("click", holdLevel);
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape" && !event.repeat) { // wherever the cursor is
    event.preventDefault();
    stopMotors();
    return;
  }
  if (event.target.closest("input, select, textarea") || event.ctrlKey || event.altKey
      || event.metaKey) return;
  if (event.key === "m") {
    event.preventDefault();
    at("mark-text").focus();
  } else if (event.key === "l" && !at("level").disabled) holdLevel();
});

at("connect").addEventListener("submit", async (event) => {
  event.preventDefault();
  const uri = at("command-uri").value;
  if (await change("/command/connect", { uri }, `Connecting to ${uri}.`)) event.target.reset();
});
at("arm").addEventListener("click", () => at("arming").showModal());
at("arming").addEventListener("close", () => {
  if (at("arming").returnValue === "arm") change("/command/arm", { on: true }, "The motors are armed.");
  at("arming").returnValue = "";
});
at("disarm").addEventListener("click", () =>
  change("/command/arm", { on: false }, "The motors are disarmed."));
at("recover").addEventListener("click", () =>
  change("/command/recover", null, "The craft has recovered."));

let looking = false; // one request at a time: a browser has six for everything, Stop too

/** What there is to choose from, asked for when somebody is about to choose. */
async function offer() {
  if (looking) return;
  looking = true;
  try {
    const answer = await fetch("devices");
    if (!answer.ok) return;
    const { devices, links, commands } = await answer.json();
    const described = (one) => devices.find((device) => device.link === one)?.description ?? "";
    for (const [id, names] of [["links", links], ["commands", commands]]) {
      at(id).replaceChildren(...names.map((name) => new Option(described(name), name)));
    }
  } catch { /* the alarms say so */ } finally { looking = false; }
}
for (const id of ["link-name", "command-uri"]) at(id).addEventListener("focus", offer);

function showPart() {
  const parts = ["now", "flights", "models"];
  const part = parts.find((name) => location.hash === `#${name}`) ?? "now";
  for (const name of parts) {
    at(name).hidden = name !== part;
    if (name === part) at(`to-${name}`).setAttribute("aria-current", "page");
    else at(`to-${name}`).removeAttribute("aria-current");
  }
}
window.addEventListener("hashchange", showPart);

showPart();
ask();
draw();
watchFlights(change);
watchModels(change);
