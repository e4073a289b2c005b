// Land and Stop, and whatever else acts on the motors: always in the same place.

import { change, closeOpen, confirmed, tell } from "./change.js";
import { at, clock, write } from "./dom.js";

let presses = 0; // of Land and Stop: what is said is of the last one
let waits = false; // for the answer to the last one
let before = null; // of the status: tells when something new begins

const DONE = { stopped: "motors stood within", landed: "landed within" };

async function press(word, path) {
  const pressedMs = Date.now(), number = ++presses;
  const pressed = `${word} pressed at ${clock(pressedMs)}: `;
  waits = true;
  tell("stopped", `${pressed}asked.`, true);
  const found = await change(path, null, null);
  if (number !== presses) return;
  const after = `${((Date.now() - pressedMs) / 1000).toFixed(1)} s`;
  waits = false;
  tell("stopped", pressed + (!found ? `not done (${at("said").textContent})`
    : DONE[found.motors] ? `${DONE[found.motors]} ${after}.` : `${found.motors} (${after} later).`)
    + (found?.ended.length ? ` ${word} also ended ${found.ended.join(", ")}.` : ""));
  if (!found) write("said", "");
}

const stop = () => press("Stop", "/command/stop");

function land() {
  if (!waits) press("Land", "/command/land");
}

function level() {
  const on = at("level").getAttribute("aria-pressed") !== "true";
  change("/command/level", { on }, on ? "Held level." : "The attitude is the client's again.");
}

async function arm() {
  if (await confirmed("Arm the motors?",
    "Propellers may turn at once. Is everybody away from the craft?", "Arm the motors"))
    change("/command/arm", { on: true }, "The motors are armed.");
}

async function disarm() {
  if (await confirmed("Disarm the motors?",
    "A craft in the air falls. To end a flight at once press Stop motors.", "Disarm the motors"))
    change("/command/arm", { on: false }, "The motors are disarmed.");
}

export function watchMotors() {
  at("stop").addEventListener("click", stop);
  at("land").addEventListener("click", land);
  at("level").addEventListener("click", level);
  at("arm").addEventListener("click", arm);
  at("disarm").addEventListener("click", disarm);
  at("recover").addEventListener("click", () =>
    change("/command/recover", null, "The craft has recovered."));
  at("connect").addEventListener("submit", async (event) => {
    event.preventDefault();
    const uri = at("command-uri").value;
    if (await change("/command/connect", { uri }, `Connecting to ${uri}.`)) event.target.reset();
  });
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && !event.isComposing) { // wherever the cursor is
      event.preventDefault();
      if (event.repeat) return;
      if (closeOpen()) tell("said", "Closed. Esc again stops the motors.");
      else stop();
    } else if (event.key === "l" && !at("level").disabled && !event.ctrlKey && !event.altKey
        && !event.metaKey && !event.target.closest("input, select, textarea")) level();
  });
}

/** Whether since the last status a craft was connected, or somebody began to command. */
function begins(command) {
  const now = { craft: command?.state === "connected" ? command.uri : "", client: command?.client ?? "",
    announced: command?.announced?.text ?? "" };
  const began = before && Object.keys(now).some((one) => now[one] && now[one] !== before[one]);
  before = now;
  return began;
}

/** What can be done now, and why not. */
export function showMotors(command) {
  const connected = command?.state === "connected";
  write("command", !command ? "no command link" : `${command.uri} ${command.state}`
    + (command.client ? `, ${command.client} commands` : ""));
  if (!waits && begins(command)) write("stopped", "");
  at("stop-why").className = command && !command.out_of_reach ? "soft" : "bad";
  write("stop-why", !command ? "Stop unavailable: connect to the craft first."
    : command.out_of_reach ? `${command.out_of_reach}.` : connected ? "Stops immediately, whoever is flying."
      : `The command link is ${command.state}.`);
  at("stop").disabled = !command;
  at("land").disabled = !connected || !command.holds_height;
  at("level").disabled = !command?.client;
  at("level").setAttribute("aria-pressed", String(Boolean(command?.held_level)));
  const today = connected && command.firmware === "2.x"; // older firmware knows no arming
  at("arm").disabled = !today || command.armed === true;
  at("disarm").disabled = !today || command.armed === false;
  at("recover").hidden = !(connected && command.crashed);
  write("armed", !connected ? "–" : command.armed === null ? (today ? "not known" : "always")
    : (command.armed ? "yes" : "no") + (command.hindrance ? `: ${command.hindrance}` : ""));
  at("connect").hidden = connected;
}
