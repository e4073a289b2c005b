"""Findings of a search that never ran, beside real comparisons: for tests of reports; and a folder
of ``learn`` up to some phase, without what it takes to get there.
"""

import functools
import json
import shutil
from pathlib import Path

import msgspec

from groundstation.comparison.gap import FURTHER_EVERY_S
from groundstation.discrepancy.engine import Discrepancy
from groundstation.discrepancy.proof import (
    Alternative,
    Candidate,
    EffectFound,
    Explained,
    Findings,
    Leftover,
    NotShown,
    Proof,
    Reason,
    Step,
    Verdict,
)
from groundstation.discrepancy.report_json import discrepancy_report
from groundstation.dynamics.model import Estimate
from support import RECORDINGS
from support.flights import BASE, MEDIUM, affected, hidden, judged

NAME = "velocity_moment"
IMPLAUSIBLE = "not plausible", Reason.IMPLAUSIBLE.value
INSIGNIFICANT = "not <significant>", Reason.INSIGNIFICANT.value


def findings(verdict=Verdict.EFFECTS_FOUND, residual=None):
    """One effect found, or none."""
    found = EffectFound(
        NAME,
        1,
        "",
        {"moment": Estimate(15.0, 0.2, "rad/s^2 per m/s")},
        {"likelihood_ratio": 5000.0, "t": 60.0, "held_out": 2300.0},
        (Alternative("rate_damping", 9.0, "hover doublets"),),
        Step(4.0, 1.0),
        ("gyro_x", "gyro_y"),
        recurrence=0.97,
    )
    some = verdict in (Verdict.EFFECTS_FOUND, Verdict.FOUND_IN_PART)
    return Findings(
        verdict=verdict,
        effects=(found,) if some else (),
        models=(affected(NAME),) if some else (),
        base=BASE,
        given=BASE,
        moved=BASE,
        base_changes=(),
        model=affected(NAME) if some else BASE,
        candidates=(
            Candidate(NAME, 5000.0, 60.0, 2300.0, some, *(() if some else IMPLAUSIBLE)),
            Candidate("rate_damping", 900.0, 20.0, 0.0, False, *INSIGNIFICANT),
        ),
        not_shown=(NotShown("ground_effect", "gain", 2.0, 0.25, "", "take off and land"),),
        lost={"attitude_filter_lean": "attitude"},
        residual=residual or Leftover(),
        warnings=("motor assumed known by 2 %",),
    )


@functools.cache
def _given():
    """The given model on a flight with the effect, near and further ahead."""
    before = judged(effects=hidden(NAME, MEDIUM[NAME]))
    return before, before.further()


def _with(model):
    """The same of another model."""
    before, far = _given()
    return before.with_model(model), far.with_model(model, FURTHER_EVERY_S)


def proof(found):
    """What predictions say of these findings."""
    before, far = _given()
    after, ahead = _with(found.model) if found.effects else _given()
    steps = [("given model", before.gap)]
    steps += [(one.name, after.beside(before)) for one in found.effects]
    explained = Explained(0.9, 0.0, 0.06, 0.04) if found.effects else None
    pair = before, after
    return Proof(*pair, *pair, pair, (far, ahead), tuple(steps), explained)


def report(found, proven):
    """The report on them."""
    return discrepancy_report(
        Discrepancy(found, proven),
        recordings=["a.mcap"],
        validation=["b.mcap"],
        model="base.json",
        created_by="test",
    )


BODY = Path(__file__).parents[1] / "learn" / "data" / "body.json"
"""Of a Crazyflie 2.1."""
PHASES = ("plan", "search", "design", "steps")


def begun(folder, link, phase, craft=None):
    """``phase`` is what comes next: two flights of a Crazyflie 2.1 were flown and the body is
    fitted, the third flight and the proof were flown, effects were looked for, or gains are
    designed. craft: which of the daemon's it was."""
    done = PHASES.index(phase)
    files = ["flight1.mcap", "flight2.mcap", *(["flight3.mcap", "proof.mcap"] if done else [])]
    folder.mkdir()
    (folder / "craft.toml").write_text('[stand_in]\nplant = "reduced"\ncraft = "crazyflie21"\n')
    (folder / "commands.sh").write_text("#!/bin/sh\n")
    for file in files:
        shutil.copy(RECORDINGS / "stand_in_flight.mcap", folder / file)
    shutil.copy(BODY, folder)
    if done >= 1:
        planned(folder)
    if done >= 2:
        shutil.copy(BODY, folder / "found1.model.json")
        found = findings()
        nothing = msgspec.structs.replace(report(found, proof(found)), effects=[])
        (folder / "found1.json").write_bytes(msgspec.json.encode(nothing))
    if done >= 3:
        (folder / "gains.toml").write_text('firmware = "2.x"\n"pid_rate.roll_kp" = 251.0\n')
    flown = [{"file": file, "purpose": "", "seconds": 30.0, "battery": 1, "timeline": []}
             for file in files]  # fmt: skip
    task = {"link": link, "vehicle": "crazyflie21", "height_m": 0.5, "reach_m": 1.0, "seed": 1,
            "batteries": 3, "craft": craft}  # fmt: skip
    log = {"task": task, "flights": flown, "said": ["hover: ", "body: ", "search1: "]}
    (folder / "learn.json").write_text(json.dumps(log))


def planned(folder):
    """A plan of the third flight: to hover."""
    chosen = {"fly": "hover", "gain_nats": 1.0, "tells": ["c0"]}
    plan = {"seed": 1, "timeline": [chosen, chosen], "expected_stderr": {}}
    (folder / "plan1.json").write_text(json.dumps(plan))
