"""On clean flights every candidate's estimate is zero within its interval, at the nominal rate.

The search's own first look at flights in which nothing is hidden: each effect alone beside the
base model, with its standard error.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench.sealed.cases import Case
from bench.sealed.flights import Generator
from bench.sealed.judge import INTERVAL

FILE = "zero.jsonl"
GROUPS = {"nominal noise": "quiet", "noise x6": "quiet_noise"}


def run(results: Path, seeds: range) -> Iterator[dict[str, Any]]:
    """One line a clean craft and noise, appended to ``results``; those there are are left out."""
    results.mkdir(parents=True, exist_ok=True)
    done = {line["case"] for line in read(results)}
    generator = Generator(results / "families")
    for seed in seeds:
        for group in GROUPS.values():
            case = Case(group, (), seed)
            if case.name in done:
                continue
            with tempfile.TemporaryDirectory() as parent:
                folder = Path(parent) / "case"
                generator.make(case, folder)
                line = {"case": case.name, "group": group, "estimates": _estimates(folder)}
            with (results / FILE).open("a") as file:
                file.write(json.dumps(line) + "\n")
            yield line


def _estimates(folder: Path) -> dict[str, float]:
    """Estimate less the value that means absent, over its standard error, by parameter."""
    from groundstation.discrepancy.engine import find_effects
    from groundstation.dynamics.model import load_model
    from groundstation.identification.likelihood.parameters import ABSENT
    from groundstation.identification.recordings import flights_of
    from groundstation.recording.open_recording import open_recording

    flights = [
        run
        for path in sorted(folder.glob("fit*.mcap"))
        for run in flights_of(open_recording(path).samples)
    ]
    findings = find_effects(flights, load_model(folder / "model.json"))
    out = {}
    for one in findings.candidates:
        for key, estimate in one.parameters.items():
            name = f"{one.name.partition('.')[0]}.{key}"
            assert estimate.stderr is not None
            out[name] = (estimate.value - ABSENT[name]) / estimate.stderr
    return out


def read(results: Path) -> list[dict[str, Any]]:
    path = results / FILE
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def table(lines: list[dict[str, Any]]) -> str:
    """How many estimates lie within 1.96 standard errors of zero, by parameter and noise."""
    if not lines:
        return ""
    rows = [
        f"| estimate | {' | '.join(f'{k}: inside, spread' for k in GROUPS)} |",
        "|---" * (1 + len(GROUPS)) + "|",
    ]
    sizes: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    every: dict[str, list[float]] = defaultdict(list)
    for line in lines:
        for key, size in line["estimates"].items():
            sizes[f"`{key}`"][line["group"]].append(size)
            every[line["group"]].append(size)
    for key, some in [*sorted(sizes.items()), ("all of them", every)]:
        cells = []
        for group in GROUPS.values():
            here = np.array(some[group])
            inside = int((np.abs(here) <= INTERVAL).sum())
            spread = math.sqrt(float(np.mean(here**2))) if len(here) else 0.0
            cells.append(f"{inside}/{len(here)}, {spread:.2f}")
        rows.append(f"| {key} | {' | '.join(cells)} |")
    return "\n".join(rows)
