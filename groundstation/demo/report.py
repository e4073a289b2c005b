"""The demo's page: the whole story in plain words, with figures, and links to every file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from groundstation.control.report import FLIGHT_HEAD, STEPS_TEXT, flight_figure, flight_rows
from groundstation.demo.figures import (
    beside_figure,
    body_figure,
    distance_figure,
    flown_steps,
    gap_steps,
    motor_figure,
    twin_figure,
)
from groundstation.demo.outcome import Outcome, said_found, said_hidden, watched
from groundstation.demo.shell import LOG, SCRIPT
from groundstation.demo.story import CRAFT_FILE, FLIGHT, SEALED
from groundstation.discrepancy.report_figures import evidence_bars, waterfall
from groundstation.dynamics.meanings import meaning_of
from groundstation.dynamics.origin import BODY
from groundstation.dynamics.registry import EFFECTS
from groundstation.report.page import Page

REPORT = "report.html"
BUSY_S = 0.01
"""Setpoints that take effect further apart than this were held up by the machine."""
AXES = ("roll", "pitch", "yaw")


def report_page(outcome: Outcome) -> Page:
    """The page, from the files in the outcome's folder."""
    page = Page(
        "From a motor on the bench to a fault that names itself",
        f"groundstation demo --seed {outcome.seed}: a software craft, the installed commands,"
        " nothing done by hand",
    )
    _summary(page, outcome)
    _motor(page, outcome.folder)
    _body(page, outcome.folder)
    _controller(page, outcome.folder)
    _controller_flies(page, outcome)
    _watched(page, outcome)
    _named(page, outcome)
    _improved(page, outcome)
    _files(page, outcome)
    return page


def _summary(page: Page, outcome: Outcome) -> None:
    hidden = f"Hidden: {said_hidden(outcome.hidden)}. Named: {said_found(outcome.found)}."
    if outcome.good:
        page.verdict(f"{hidden} The improved model flies like the craft.", "good")
    else:
        wrong = "; ".join(claim.text for claim in outcome.claims if not claim.true)
        page.verdict(f"{hidden} Not everything came true: {wrong}.", "bad")
    page.text(
        "A Crazyflie in software sends the same telemetry as the real one. Its motor is measured"
        " on the bench, its body in flight, a controller is designed for the model and flown. Then"
        " a seed hides something in the craft. The file with the answer stays closed: the live"
        " twin sees that the craft no longer does what the model says, the search names what is"
        " missing, and the model that has it is flown beside the craft. At the end the file is"
        " opened."
    )
    page.table(
        ["claim", "came true"],
        [[_sentence(claim.text), "yes" if claim.true else "NO"] for claim in outcome.claims],
    )


def _motor(page: Page, folder: Path) -> None:
    account = _account(folder, "motor")
    page.heading("The motor")
    fit = min(one["rotor_fit_percent"] for one in account["validation"])
    page.text(
        "One motor with an optical gate that times its blades; the thrust jumps about for 40 s."
        f" Three constants are fitted, and the speed that follows from them and the voltage alone"
        f" explains {fit:.1f} % of what was measured in the part that the fit has not seen"
        f" (RMS error {account['validation'][0]['rotor_rms_rev_s']:.2f} rev/s)."
    )
    page.figure(
        motor_figure(folder),
        "The part held out. Points away from the line are blade passages that the gate missed or"
        " counted twice; the fit finds them by itself.",
    )
    _constants(page, account, ("a0", "a1", "a2"))
    page.links([("bench recording", "bench.csv"), ("motor.json", "motor.json"),
                ("the fit's own report", "motor.html")])  # fmt: skip


def _body(page: Page, folder: Path) -> None:
    account = _account(folder, "body")
    page.heading("The body")
    held = account["validation"]
    fits = ", ".join(f"{axis} {held[f'gyro_{axis}_fit_percent_50ms']:.1f} %" for axis in AXES)
    page.text(
        "Two flights of 40 s, with the controller at work. How strongly the craft turns for a"
        f" given push of the rotors is fitted from them; 50 ms ahead the model then explains"
        f" {fits} of how the rates move, in the part that was held out."
    )
    page.figure(
        body_figure(folder),
        "The model flies on the recorded motor commands. A quadrotor is unstable, so every 0.5 s"
        " it starts afresh from what was measured.",
    )
    _constants(page, account, BODY)
    arx = json.loads((folder / "arx.json").read_text())["fit"]["arx"]["axes"]
    chosen = ", ".join(f"{axis} {one['chosen']}" for axis, one in arx.items())
    page.text(
        f"The black-box models of the same flights (88 structures tried an axis) chose {chosen}:"
        " poles, inputs, delay in rows."
    )
    page.links([
        ("flight 1", "flight1.csv"), ("flight 2", "flight2.csv"), ("body.json", "body.json"),
        ("the fit's own report", "body.html"), ("black-box models", "arx.json"),
        ("their report", "arx.html"), ("simulated beside measured", "simulated.html"),
    ])  # fmt: skip


def _controller(page: Page, folder: Path) -> None:
    design = json.loads((folder / "design.json").read_text())["axes"]
    page.heading("The controller")
    page.text(
        "Gains of the firmware's own loops, found by optimisation: the best following of steps"
        " that a stated robustness allows, tried on 1000 models drawn from the fit's uncertainty."
    )
    page.table(
        ["axis", "settles in, s", "overshoot, %", "maximum sensitivity", "bears more delay, ms",
         "stable of 1000 models"],
        [
            [axis, one["settling_s"], one["overshoot_pct"], one["max_sensitivity"],
             1e3 * one["delay_margin_s"], one["draws"]["stable"]]
            for axis, one in design.items()
        ],
    )  # fmt: skip
    page.links([("gains.toml", "gains.toml"), ("the design's own report, gain by gain",
                                               "design.html")])  # fmt: skip


def _controller_flies(page: Page, outcome: Outcome) -> None:
    page.heading("The controller flies")
    if outcome.flown is None:
        page.verdict(_sentence(outcome.told.skipped["controller_flies"]), "neutral")
        return
    flown = flown_steps(outcome.folder, outcome.flown)
    apart = [f"{one.axis}: {', '.join(one.apart)}" for one in flown.axes if one.apart]
    if not apart:
        page.verdict(
            "Measured and predicted agree within 15 %, 3 points of overshoot or 20 ms.", "good"
        )
    elif flown.spread_s > BUSY_S:
        page.verdict(
            f"Measured and predicted disagree ({'; '.join(apart)}), but this machine was too busy"
            " to measure it: setpoints took effect spread over"
            f" {1e3 * flown.spread_s:.0f} ms (the middle half of them).",
            "neutral",
        )
    else:
        page.verdict(f"Measured and predicted disagree. {'; '.join(apart)}", "bad")
    page.text(
        "In real time, through the daemon and the official client library: the gains are written,"
        " read back, flown through doublets, and the former ones put back."
    )
    page.figure(flight_figure(flown), STEPS_TEXT)
    page.table(FLIGHT_HEAD, flight_rows(flown))
    recording = Path(outcome.flown["recording"])
    name = recording.parent.name
    page.links([
        ("recording", f"{name}/{recording.name}"), ("for the rerun viewer", f"{name}.rrd"),
        ("the flight's own report", f"{name}.html"),
    ])  # fmt: skip


def _watched(page: Page, outcome: Outcome) -> None:
    page.heading("Something is wrong, and the twin notices")
    (claim,) = (one for one in outcome.claims if one.name == "noticed")
    page.verdict(_sentence(claim.text), "good" if claim.true else "bad")
    page.text(
        "Now the craft has something that the model has not. It flies in real time while the twin"
        " predicts, from each moment, what it will do in the next 50 ms, and compares. The twin"
        " speaks up when a disagreement is more than chance allows, and says in which channel and"
        " in what kind of flight."
    )
    page.figure(
        twin_figure(outcome.folder, outcome.noticed),
        "Prediction error of every half second over what noise leaves; the three channels that"
        " disagree most in colour. The twin learns the noise first, in the air.",
    )
    page.table(["what the twin said"], [[str(one["text"])] for one in outcome.noticed])
    page.links([("recording", str(watched(outcome.folder).relative_to(outcome.folder))),
                ("for the rerun viewer", "watched.rrd")])  # fmt: skip


def _named(page: Page, outcome: Outcome) -> None:
    found = outcome.found
    page.heading("What is it?")
    (claim,) = (one for one in outcome.claims if one.name == "named")
    page.verdict(_sentence(claim.text), "good" if claim.true else "bad")
    page.bullets(
        f"{effect.name} in words: {EFFECTS[effect.name].signature}" for effect in found.effects
    )
    page.text(
        "The watched flight and one more are searched for every effect in the list; a third flight"
        " is held out as a judge. Many effects explain a little of what another does; only what"
        " passes every test is accepted."
    )
    page.figure(
        evidence_bars(found.candidates),
        "What each effect alone would explain, before any was added.",
    )
    page.text("With what was named in the model, the gap on the held-out flight closes:")
    page.figure(
        waterfall(gap_steps(found)),
        "Error of predictions 20 and 50 ms ahead, over what noise alone leaves; 1 is perfect.",
    )
    page.table(
        ["channel", "unit", "error before", "after", "noise alone"],
        [
            [name.replace("_", " "), one.own_unit.unit, one.own_unit.before, one.own_unit.after,
             one.own_unit.noise_floor]
            for name, one in found.gap.channels.items()
        ],
    )  # fmt: skip
    page.links([
        ("the search's own report", "found.html"), ("the same for programs", "found.json"),
        ("measured and both models in the rerun viewer", "found.rrd"),
        ("improved.json", "improved.json"), ("second flight", "hidden1.csv"),
        ("held-out flight", "hidden2.csv"),
    ])  # fmt: skip


def _improved(page: Page, outcome: Outcome) -> None:
    old, new = outcome.distance.overall
    page.heading("The improved model flies")
    page.text(
        "Last, the stand-in flies the models themselves: the same commands, the same noise as the"
        " held-out flight, once with the first model and once with the improved one. Over all"
        f" channels the first strays from what the hidden craft did by {100 * old:.2g} % of how"
        f" much they move, the improved one by {100 * new:.2g} %."
    )
    page.figure(
        beside_figure(outcome.folder, outcome.distance),
        "The channel in which the first model strays most, where it drifts away fastest"
        " (accelerations averaged over 40 ms).",
    )
    page.figure(distance_figure(outcome.distance), "Every channel; further left is closer.")
    page.links([("hidden craft", "hidden2.csv"), ("first model", "as_body.csv"),
                ("improved model", "as_improved.csv")])  # fmt: skip


def _files(page: Page, outcome: Outcome) -> None:
    page.heading("Repeat it")
    page.text(
        "Every command is in commands.sh, in order, to be run by hand. A rerun file opens with"
        " 'rerun FILE'."
    )
    page.links([
        ("all commands", SCRIPT), ("what they said", LOG), ("the craft", CRAFT_FILE),
        ("the flight programme", FLIGHT), ("the craft with what was hidden", SEALED),
    ])  # fmt: skip
    page.table(
        ["stage", "seconds", "processor seconds"],
        [[name.replace("_", " "), wall, processor]
         for name, (wall, processor) in outcome.told.cost.items()],
    )  # fmt: skip


def _constants(page: Page, account: dict[str, Any], names: tuple[str, ...]) -> None:
    estimates = account["estimates"]
    rows = []
    for name in names:
        k = estimates["names"].index(name)
        value, error = estimates["values"][k], estimates["stderr"][k]
        unit, meaning = meaning_of(name)
        rows.append([name, meaning, value, error, unit, 100 * error / abs(value)])
    page.table(["constant", "meaning", "value", "standard error", "unit", "%"], rows)


def _account(folder: Path, what: str) -> dict[str, Any]:
    account: dict[str, Any] = json.loads((folder / f"{what}.json").read_text())["fit"][what]
    return account


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."
