"""A folder of ``learn`` up to some phase, without what it takes to get there."""

import json
import shutil
from pathlib import Path

import msgspec

from support import RECORDINGS
from support.findings import findings, proof, report

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
