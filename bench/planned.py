"""``python -m bench.planned FOLDER...``: how long the fixed programme takes to tell as much as a
designed flight, by the expected errors of all constants and effects.

A folder is one that ``learn`` left (``bench.learn``). Both begin with what the flights for hover,
motors and body told.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from groundstation.cli.learn import FastPlace
from groundstation.dynamics.model import load_model
from groundstation.learn.planning import (
    BODY,
    HOVER,
    PROOF,
    Information,
    Limits,
    choose,
    library,
    rehearsed,
)
from groundstation.learn.story import BODY_MODEL, DESIGNED_S

FIXED = (*HOVER, *BODY, *PROOF)
"""Again and again."""
MOST = 100
"""Manoeuvres of the fixed programme at most."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.planned", description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    limits = Limits()
    seconds = {name: one.held_s for name, one in library(limits).items()}
    ratios = []
    for folder in parser.parse_args().folders:
        model = load_model(folder / BODY_MODEL)
        place = FastPlace(
            str(folder / "craft.toml"), limits.height_m, limits.reach_m, str(folder / BODY_MODEL)
        )
        told = rehearsed(place, model, limits, seed=1)
        begun = (*HOVER, *BODY)
        designed = [one.name for one in choose(told, seconds, DESIGNED_S, flown=begun)]
        flown_s = sum(seconds[name] for name in designed)
        least = _mean_error(told, (*begun, *designed))
        fixed_s = next(
            (count * seconds[FIXED[0]] for count in range(1, MOST)
             if _mean_error(told, (*begun, *itertools.islice(itertools.cycle(FIXED), count)))
             <= least),
            float("inf"),
        )  # fmt: skip
        ratios.append(flown_s / fixed_s)
        print(f"{folder.name}: designed {flown_s:.0f} s, fixed {fixed_s:.0f} s", flush=True)
    print(f"designed over fixed, median of {len(ratios)}: {np.median(ratios):.2f}")
    return 0


def _mean_error(told: Information, flown: Sequence[str]) -> float:
    """Geometric mean of the expected standard errors, each fitted jointly with all others."""
    return float(np.exp(np.mean(np.log(list(told.errors(flown).values())))))


if __name__ == "__main__":
    raise SystemExit(main())
