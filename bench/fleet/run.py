"""Fleets, each made and told in a folder that is gone afterwards."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.results import append, judged
from groundstation.fleet.engine import carried_out

CRAFTS, FLIGHTS, SECONDS = 4, 12, 15
"""The smallest fleet in which a craft can differ from the others, flights as short as they tell."""
ILL = 3
PROGRAM = str(Path(__file__).with_name("programme.toml"))
MAKE = str(Path(__file__).with_name("make.py"))
COMMAND = str(Path(sys.executable).with_name("groundstation"))
PATIENCE_S = 3600.0


@dataclass(frozen=True, slots=True)
class FleetCase:
    """ill: whether something becomes of ``ILL`` of its crafts."""

    ill: bool
    seed: int

    @property
    def name(self) -> str:
        return f"{'ill' if self.ill else 'sound'}:{self.seed}"


def run(cases: Sequence[FleetCase], results: Path, workers: int) -> Iterator[dict[str, Any]]:
    """The line of every case that ``results`` does not hold yet, appended there; what failed is
    tried again."""
    results.mkdir(parents=True, exist_ok=True)
    done = judged(results)
    left = [case for case in cases if case.name not in done]
    for case, line in carried_out(told, left, workers=workers, largest=1):
        kept = line or {"case": case.name, "error": "its process dies, again and again"}
        append(results, kept)
        yield kept


def told(case: FleetCase) -> dict[str, Any]:
    """What became of whom, and what the report found, of one fleet."""
    with tempfile.TemporaryDirectory(prefix="fleet-") as folder:
        make = [sys.executable, MAKE, "--crafts", CRAFTS, "--wear"]
        make += [ILL if case.ill else 0, "--flights", FLIGHTS, "--for", SECONDS, "--program"]
        make += [PROGRAM, "--seed", case.seed, "-o", "flights", "--truth", "sealed.json"]
        steps: list[list[Any]] = [
            make,
            [COMMAND, "fleet", "index", "flights", "-o", "fleet", "--workers", "1"],
            [COMMAND, "fleet", "fit", "fleet", "--workers", "1"],
            [COMMAND, "fleet", "report", "fleet", "--json"],
        ]
        for step in steps:
            words = [str(word) for word in step]
            done = subprocess.run(
                words, cwd=folder, capture_output=True, text=True, timeout=PATIENCE_S, check=False
            )
            if done.returncode:
                said = (done.stderr or done.stdout).strip()[-500:]
                what = f"{' '.join(words[1:4])}: status {done.returncode}: {said}"
                return {"case": case.name, "error": what}
        report = json.loads(done.stdout)
        return {
            "case": case.name,
            "truth": json.loads(Path(folder, "sealed.json").read_text()),
            "findings": report["findings"],
            "tests": report["tests"],
        }
