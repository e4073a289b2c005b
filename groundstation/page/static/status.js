// What the daemon is doing, once a second.

import { showAnnounced } from "./announced.js";
import { at, clock, element, fixed, write } from "./dom.js";
import { showMotors } from "./motors.js";

export const LIVE_S = 1.0; // what is older is said to be behind
let recordingRate = null;

const spell = (s) => `${Math.floor(s / 60)}:${String(Math.floor(s % 60)).padStart(2, "0")}`;

/** A Unix time in s on a time axis whose steps are that fine. */
export function clockText(timeS, step = 1) {
  const time = clock(timeS * 1000);
  return step >= 1 ? time : time + (timeS % 1).toFixed(step < 0.01 ? 3 : step < 0.1 ? 2 : 1).slice(1);
}

export function showStatus(status) {
  const { link, statistics } = status;
  const preparing = link.state === "opening";
  write("link", `${link.name}: ${preparing && link.doing ? link.doing : link.state}`);
  at("link").className = `badge ${link.state === "streaming" || link.pauses ? "good" : preparing ? "" : "bad"}`;
  write("rate", `${link.rate_hz.toFixed(0)} a second`);
  write("loss", statistics ? `${statistics.loss_pct.toFixed(2)} % lately, ${link.lost} in all` : "–");
  write("late", fixed(link.latency_ms, 1, "ms"));
  write("vehicle", status.vehicle);
  showViewer(status.viewer);
  write("doing", link.doing);
  at("doing").hidden = at("doing-title").hidden = !link.doing;
  showMotors(status.command);
  showAnnounced(status.command);
  showRecording(status.recording, link);
}

function showViewer({ state, viewers, behind_s: behind, urls }) {
  const text = state !== "serving" ? state : !viewers ? "no viewer open"
    : behind > LIVE_S ? `${behind.toFixed(0)} s behind` : "live";
  if (at("viewer").dataset.shown === text + urls[0]) return;
  at("viewer").dataset.shown = text + urls[0];
  at("viewer").replaceChildren(text);
  if (state !== "serving") return;
  const open = element("a", "", "open it");
  open.href = urls[0];
  open.target = "_blank";
  open.rel = "noreferrer";
  at("viewer").append(" · ", open);
}

function showRecording(recording, link) {
  const records = recording.state === "recording";
  const nowS = performance.now() / 1000;
  if (!records) recordingRate = null;
  else if (recordingRate?.file !== recording.file)
    recordingRate = { file: recording.file, bytes: recording.bytes, sinceS: nowS };
  const began = records && begunAt(recording.file);
  write("recording", !records ? recording.state : began ? spell((Date.now() - began) / 1000)
    : `${(recording.bytes / 1e6).toFixed(1)} MB`);
  write("record-what", records ? `min of ${link.name}, ${(recording.bytes / 1e6).toFixed(1)} MB` : "");
  write("file", recording.file ?? "no file yet");
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

/** From its name, in ms; null where it says nothing. */
export function begunAt(file) {
  const found = /(?:^|\/)(\d{4}-\d\d-\d\d)T(\d\d)-(\d\d)-(\d\d)-(\d{3})Z/.exec(file ?? "");
  return found && Date.parse(`${found[1]}T${found[2]}:${found[3]}:${found[4]}.${found[5]}Z`);
}

function duration(seconds) {
  if (seconds > 2 * 86400) return `${(seconds / 86400).toFixed(0)} days`;
  if (seconds > 2 * 3600) return `${(seconds / 3600).toFixed(0)} hours`;
  return `${(seconds / 60).toFixed(0)} minutes`;
}

export function showEvents(events) {
  const isConsole = (one) => one.kind === "console";
  list("events", events.filter((one) => !isConsole(one)).slice(-40));
  list("console", events.filter(isConsole));
  at("console-part").hidden = !events.some(isConsole);
}

function list(id, events) {
  at(id).replaceChildren(...events.toReversed().map((event) => {
    const item = element("li");
    item.append(element("time", "", clock(event.time_ns / 1e6)),
      event.kind === "console" ? event.text : `${event.link} ${event.kind}: ${event.text}`);
    return item;
  }));
}
