// Stop, and whatever else acts on the motors: always in the same place.

import { change, confirmed } from "./change.js";
import { at, clock, write } from "./dom.js";

async function stop() {
  const pressedMs = Date.now();
  write("stopped", `Stop pressed at ${clock(pressedMs)}: asked.`);
  const found = await change("/command/stop", null, null);
  const after = ((Date.now() - pressedMs) / 1000).toFixed(1);
  write("stopped", `Stop pressed at ${clock(pressedMs)}: ` + (!found ? `not done (${at("said").textContent})`
    : found.motors === "stopped" ? `motors stood within ${after} s.` : `${found.motors} (${after} s later).`));
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
    if (event.key === "Escape" && !event.repeat) { // wherever the cursor is
      event.preventDefault();
      at("question").close();
      stop();
    } else if (event.key === "l" && !at("level").disabled && !event.ctrlKey && !event.altKey
        && !event.metaKey && !event.target.closest("input, select, textarea")) level();
  });
}

/** What can be done now, and why not. */
export function showMotors(command) {
  const connected = command?.state === "connected";
  write("command", !command ? "no command link" : `${command.uri} ${command.state}`
    + (command.client ? `, ${command.client} commands` : ""));
  at("stop-why").className = command && !command.out_of_reach ? "soft" : "bad";
  write("stop-why", !command ? "No command link: Stop reaches no motors."
    : command.out_of_reach ? `${command.out_of_reach}.` : connected ? "Stop acts at once, whoever commands."
      : `The command link is ${command.state}.`);
  at("stop").disabled = !command;
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
