// Says over the web viewer how old its newest row is, and tells the relay, which sends less then.
// rerun 0.41 takes a few messages with each frame it draws, so that one that draws slowly (without a
// GPU) falls behind for ever: while it is behind it draws small, under a still of what it showed; so it
// does from its opening on, until it has taken in what was before.
"use strict";

const EVERY_MS = 500;
const LIVE_S = 1.5; // rows come at least once a second
const SMALL_FROM_S = 3.5; // behind
const SMALL_UNTIL_S = 1;
const EMPTY_S = 5; // without any row: there is nothing to take in
const LOST_S = 10; // without a new row; then the page is loaded again if it has lost its connection
const who = Math.random().toString(36).slice(2);

const view = document.getElementById("the_canvas_id");
view.classList.add("small");
const badge = document.createElement("output");
badge.id = "live";
const veil = document.createElement("div"); // until it shows what is live
veil.id = "veil";
veil.setAttribute("role", "status");
veil.textContent = "Loading, catching up";
document.body.append(veil, badge);
let frame_ms = 0;
let drawn_ms = performance.now();
let newest = 0;
let opened_ms = null; // when the viewer began to draw
let still = null; // while the viewer draws small, of what it showed before
let moved_ms = drawn_ms;

function draw(now_ms) {
  frame_ms = now_ms - drawn_ms;
  drawn_ms = now_ms;
  requestAnimationFrame(draw);
}

// Fields of a protobuf message: [number, value], a BigInt or bytes.
function* fields(bytes) {
  let at = 0;
  const varint = () => {
    let value = 0n;
    for (let shift = 0n; ; shift += 7n) {
      const byte = bytes[at++];
      value |= BigInt(byte & 127) << shift;
      if (byte < 128) return value;
    }
  };
  while (at < bytes.length) {
    const key = Number(varint());
    if (key % 8 === 0) yield [key >> 3, varint()];
    else if (key % 8 === 2) {
      const length = Number(varint());
      yield [key >> 3, bytes.subarray(at, (at += length))];
    } else at += key % 8 === 1 ? 8 : 4;
  }
}

// When the newest row that the viewer holds was received, ms since 1970: of rerun's
// GetStateResponse, timeline host_time (ns).
function newest_ms(state) {
  let found = 0;
  for (const [number, recording] of fields(state)) {
    if (number !== 3) continue;
    for (const [part, timeline] of fields(recording)) {
      if (part !== 2) continue;
      let name = "";
      for (const [key, value] of fields(timeline)) {
        if (key === 1) name = new TextDecoder().decode(value);
        if (key !== 3 || !name.includes("host_time")) continue;
        for (const [end, at] of fields(value)) if (end === 2) found = Math.max(found, Number(at / 1000000n));
      }
    }
  }
  return found;
}

// Seconds; the last frame's time included, for what it holds is drawn with the next one.
window.age_s = () => {
  const found = newest_ms(window._handle.viewer_state());
  if (found !== newest) [newest, moved_ms] = [found, performance.now()];
  return newest ? (Date.now() - newest + frame_ms) / 1000 : null;
};

function draw_small() {
  still = document.createElement("canvas");
  still.id = "still";
  setTimeout(() => requestAnimationFrame(() => {
    // after the viewer's own callback of this frame: before and later WebGL's picture is gone
    if (!still) return;
    [still.width, still.height] = [view.width, view.height];
    still.getContext("2d").drawImage(view, 0, 0);
    badge.before(still);
    view.classList.add("small");
  }));
}

function draw_large() {
  veil.remove();
  view.classList.remove("small");
  still?.remove();
  still = null;
}

async function tell() {
  if (!window._handle) return;
  opened_ms ??= performance.now();
  const age_s = window.age_s();
  if (age_s === null) {
    if (performance.now() - opened_ms > 1000 * EMPTY_S) draw_large();
    return;
  }
  badge.textContent = age_s < LIVE_S ? "live" : `${Math.round(age_s)} s behind`;
  badge.className = age_s < LIVE_S ? "" : "behind";
  const small = still || view.classList.contains("small");
  if (!small && age_s > SMALL_FROM_S) draw_small();
  else if (small && age_s < SMALL_UNTIL_S) draw_large();
  const answer = await fetch(`behind?${who}`, { method: "POST", body: age_s.toFixed(1) });
  const { connected } = await answer.json();
  if (!connected && performance.now() - moved_ms > 1000 * LOST_S) location.reload();
}

requestAnimationFrame(draw);
setInterval(() => tell().catch(() => {}), EVERY_MS); // a relay that is away is asked again
