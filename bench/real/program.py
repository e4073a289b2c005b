"""What the commands say about a split, as a user would run them, each in a process of its own."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.command import run_command
from bench.real.sets import FlightSet, Split

CONSTANTS = ("c0", "c1", "c2", "thrust_per_mass")


def fitted(data: Path, flights: FlightSet, split: Split, folder: Path) -> dict[str, Any]:
    """``fit motor`` (where speeds were measured) and ``fit body``; the model and its seconds."""
    model = folder / f"{flights.name}_{split.name}.json"
    motor = folder / f"{flights.name}_{split.name}_motor.json"
    for path in (model, motor):
        path.unlink(missing_ok=True)
    recordings = [str(data / flights.folder / name) for name in split.fitted]
    validate = [f"--validate={data / flights.folder / name}" for name in split.held]
    options = [f"--vehicle={flights.vehicle}"]
    seconds = 0.0
    if flights.measured:
        said, seconds, _ = run_command("fit", "motor", *recordings, *options, "-o", motor)
        if said:
            return {"refused": said, "seconds": seconds}
        options += [f"--model={motor}", "--measured-rotors"]
    said, more, _ = run_command("fit", "body", *recordings, *validate, *options, "-o", model)
    if said:
        return {"refused": said, "seconds": seconds + more}
    read = json.loads(model.read_text())
    account = read["fit"]["body"]
    names = account["estimates"]["names"]
    stderr = dict(zip(names, account["estimates"]["stderr"], strict=True))
    return {
        "model": str(model),
        "seconds": seconds + more,
        "constants": {name: read["body"][name] for name in CONSTANTS},
        "stderr": {name: stderr.get(name) for name in CONSTANTS},
        "validation": account["validation"],
        "warnings": account["warnings"],
    }


def searched(
    data: Path, flights: FlightSet, split: Split, model: str, folder: Path
) -> dict[str, Any]:
    """``discrepancy`` from the split's own fitted model, judged on its held-out flights."""
    return find(
        [data / flights.folder / name for name in split.fitted],
        [data / flights.folder / name for name in split.held],
        model,
        folder / f"{flights.name}_{split.name}_report.json",
    )


def find(
    recordings: Sequence[Path], validate: Sequence[Path], model: str, report: Path
) -> dict[str, Any]:
    """The report's findings, and the improved model where one was written."""
    improved = report.with_suffix(".improved.json")
    for path in (report, improved):
        path.unlink(missing_ok=True)
    held = [f"--validate={path}" for path in validate]
    options = [f"--model={model}", f"--json={report}", "-o", str(improved)]
    said, seconds, _ = run_command("discrepancy", *recordings, *held, *options)
    if not report.is_file():
        return {"refused": said or "no report", "seconds": seconds}
    read = json.loads(report.read_text())
    return {
        "seconds": seconds,
        "model": str(improved if improved.is_file() else model),
        "verdict": read["verdict"],
        "effects": {one["name"]: one["parameters"] for one in read["effects"]},
        "gap": read["gap"]["validation"],
        "channels": read["gap"].get("channels", {}),
        "base_changes": read.get("base_changes", []),
        "where": read["where"][:3],
    }
