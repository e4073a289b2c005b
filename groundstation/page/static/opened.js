// A recording in the same plots and the same space as what is live, with a scrubber.

import { send } from "./change.js";
import { Charts } from "./charts.js";
import { askColumns, closeColumns, saved, wrong } from "./columns.js";
import { CraftView } from "./craft.js";
import { at, decimals, element, pressable, write } from "./dom.js";
import { poseAt } from "./pose.js";
import { Store } from "./store.js";
import { View, viewTools } from "./view.js";

const store = new Store();
let endS = 1, timeS = 0, vehicle = "", file = "";
let playing = null; // since which moment, and from which second on
let charts = null;
const view = new View({ nowS: () => endS, beginS: () => 0, windowS: null });

const clockText = (time, step) => time.toFixed(step >= 1 ? 0 : step >= 0.1 ? 1 : step >= 0.01 ? 2 : 3);

export function watchOpened() {
  at("open-file").addEventListener("change", () => {
    if (at("open-file").files[0]) addFile(at("open-file").files[0]);
    at("open-file").value = "";
  });
  document.addEventListener("dragover", (event) => {
    if (event.dataTransfer.types.includes("Files")) event.preventDefault();
  });
  document.addEventListener("drop", (event) => {
    const [dropped] = event.dataTransfer.files;
    if (!dropped) return;
    event.preventDefault();
    location.hash = "#opened";
    addFile(dropped);
  });
  at("scrubber").addEventListener("input", () => seek(Number(at("scrubber").value)));
  at("play").addEventListener("click", () => (playing ? pause() : play()));
  window.addEventListener("hashchange", offerExamples);
  offerExamples();
}

async function offerExamples() {
  if (location.hash !== "#opened" || at("examples").firstChild) return;
  const answer = await fetch("examples");
  const names = answer.ok ? await answer.json() : [];
  at("examples").replaceChildren(...names.map((name) =>
    pressable("quiet", name, () => add("example", name, null, "text/plain"))));
  at("examples-part").hidden = !names.length;
}

const addFile = (file) => add("file", file.name, file, "application/octet-stream");

async function add(kind, name, content, type) {
  closeColumns();
  at("opened-state").textContent = `Reading ${name}…`;
  const found = await send(`add/${kind}/${encodeURIComponent(name)}`, content, type, null);
  if (location.hash !== "#opened") return; // somebody went on meanwhile
  if (!found) at("opened-state").textContent = at("said").textContent;
  else if (found.form) askFor(name, content, type, found);
  else await openAdded(found);
}

/** Asks which column is which channel, and opens the file by the answers. */
function askFor(name, content, type, { form, why }) {
  at("opened-state").textContent = "";
  at("opened-view").hidden = true;
  askColumns(name, why, form, async (chosen) => {
    wrong(`Reading ${name}…`);
    const answers = encodeURIComponent(JSON.stringify(chosen));
    const found = await send(`add/file/${encodeURIComponent(name)}?columns=${answers}`, content, type, null);
    if (!found) return wrong(at("said").textContent);
    closeColumns();
    return openAdded(found, saved(`${name.replace(/\.[^.]*$/, "")}.map.toml`, found.map));
  });
}

async function openAdded({ file: added, said }, link = null) {
  await openRecording(added);
  if (said) at("opened-state").textContent += `; ${said}`;
  if (link) at("opened-state").append(" ", link);
}

/** Shows a file of the recordings folder. */
export async function openRecording(name) {
  location.hash = "#opened";
  at("opened-state").textContent = `Opening ${name}…`;
  const answer = await fetch(`series/${encodeURIComponent(name)}`).catch(() => null);
  if (!answer?.ok) {
    at("opened-state").textContent = answer ? (await answer.json()).error : "No answer.";
    return;
  }
  const content = await answer.arrayBuffer();
  const headBytes = new DataView(content).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(content, 4, headBytes)));
  take(head, content, 4 + headBytes);
}

function take(head, content, from) {
  const tables = {};
  let at_ = from;
  const array = (Kind, rows) => {
    const found = new Kind(content, at_, rows);
    at_ += Math.ceil(found.byteLength / 8) * 8;
    return found;
  };
  for (const { name, columns, rows } of head.tables) {
    tables[name] = { columns, times: array(Float64Array, rows), values: columns.map(() => array(Float32Array, rows)) };
  }
  store.set(tables);
  ({ vehicle, file } = head);
  endS = Math.max(0.1, ...Object.values(tables).map((one) => one.times.at(-1) ?? 0));
  at("scrubber").max = endS;
  const thinned = Math.max(1, ...head.tables.map((one) => one.every));
  write("opened-title", file);
  at("opened-state").textContent = [`${endS.toFixed(1)} s`, vehicle,
    ...(thinned > 1 ? [`one sample in ${thinned} is shown`] : []), ...head.damage].filter(Boolean).join("; ");
  at("opened-view").hidden = false;
  at("examples-part").open = false;
  showEvents(head.events);
  begin();
  view.follow();
  seek(0);
}

function begin() {
  if (charts) return;
  charts = new Charts(at("opened-plots"), store, view,
    { shown: ["Attitude", "Rates", "Motors"], clockText, key: "groundstation-opened", playhead: () => timeS });
  viewTools(at("opened-tools"), view, charts, { live: false });
  new CraftView(at("opened-craft"), () => {
    if (playing) step();
    return poseAt(store, (playing ? null : charts.cursor) ?? timeS, vehicle);
  });
}

function showEvents(events) {
  at("opened-events").replaceChildren(...events.map(({ time_s: time, text }) => {
    const item = element("li");
    item.append(pressable("quiet", `${time.toFixed(1)} s`,
      () => seek(Math.max(0, Math.min(endS, time)))), ` ${text}`);
    return item;
  }));
}

function seek(time) {
  timeS = time;
  if (playing) playing = { atMs: performance.now(), fromS: time };
  tell();
  charts.draw();
}

function tell() {
  at("scrubber").value = timeS;
  const pose = poseAt(store, timeS, vehicle);
  const angle = (value) => (value === null || Number.isNaN(value) ? "–" : `${decimals(value, 1)}°`);
  at("scrubber").setAttribute("aria-valuetext", `${timeS.toFixed(2)} s of ${endS.toFixed(1)}`);
  write("opened-time", `${timeS.toFixed(2)} s`);
  write("opened-pose", `roll ${angle(pose.roll)}, pitch ${angle(pose.pitch)}, yaw ${angle(pose.yaw)}`);
}

function play() {
  if (timeS >= endS) timeS = 0;
  playing = { atMs: performance.now(), fromS: timeS, drawnMs: 0 };
  write("play", "Pause");
}

function pause() {
  playing = null;
  write("play", "Play");
}

/** With each frame of the craft, while it plays. */
function step() {
  const nowMs = performance.now();
  timeS = Math.min(endS, playing.fromS + (nowMs - playing.atMs) / 1000);
  if (timeS >= endS) pause();
  if (playing && nowMs - (playing.drawnMs ?? 0) < 150) return;
  if (playing) playing.drawnMs = nowMs;
  tell();
  charts.draw();
}
