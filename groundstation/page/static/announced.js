// A take-off that a program announces, counted down beside Stop with a sound each second; a landing.

import { at, write } from "./dom.js";

const TICK_MS = 100;
const LAST_S = 3; // the last seconds sound higher
const TONE_HZ = 660, LAST_HZ = 990, TONE_S = 0.15, LOUDNESS = 0.3;
const ANOTHER_MS = 6000; // a time that moves back by more is of another take-off
const PAST_MS = 5000; // so long is shown what was to be by now
const SILENT = "off: click the page once"; // browsers demand a click or a key before the first sound

let audio = null;
let text = "", takesOffMs = 0, shownS = null; // no text: nothing is announced

const sounds = () => audio?.state === "running";

export function watchAnnounced() {
  for (const kind of ["click", "keydown"]) document.addEventListener(kind, unlock, { capture: true });
  setInterval(count, TICK_MS);
}

function unlock() {
  audio ??= new AudioContext();
  if (!sounds()) audio.resume();
}

/** announced: {text, in_s} or null. */
export function showAnnounced(command) {
  const announced = command?.announced ?? null;
  if (announced) {
    const foundMs = performance.now() + 1000 * announced.in_s;
    // a status is late by its way, never early: the soonest is the best
    const same = text === announced.text && (!announced.in_s || foundMs - takesOffMs < ANOTHER_MS);
    if (!same) shownS = null;
    takesOffMs = same ? Math.min(takesOffMs, foundMs) : foundMs;
  }
  text = announced?.text ?? "";
  if (!text) {
    shownS = null;
    write("announced", command?.landing ? "Landing. Stop cuts the motors." : "");
    write("announced-sound", "");
    at("announcement").hidden = !command?.landing;
  }
  count();
}

function count() {
  write("sound", sounds() ? "on" : SILENT);
  if (!text) return;
  const leftMs = takesOffMs - performance.now(), leftS = Math.max(0, Math.ceil(leftMs / 1000));
  at("announcement").hidden = leftMs < -PAST_MS;
  write("announced", leftS ? `${text} in ${leftS} s` : text);
  write("announced-sound", sounds() ? "" : `Sound is ${SILENT}.`);
  if (leftS !== shownS && (leftS || shownS) && sounds()) tone(leftS <= LAST_S ? LAST_HZ : TONE_HZ);
  shownS = leftS;
}

function tone(frequency) {
  const source = audio.createOscillator(), volume = audio.createGain(), endS = audio.currentTime + TONE_S;
  source.frequency.value = frequency;
  volume.gain.setValueAtTime(LOUDNESS, endS - TONE_S / 2);
  volume.gain.linearRampToValueAtTime(0, endS); // no click at its end
  source.connect(volume).connect(audio.destination);
  source.start();
  source.stop(endS);
}
