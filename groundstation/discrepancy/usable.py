"""What of recordings a search can use: flights that PWM steers, rotor sensors that follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from groundstation.comparison.consistency import broken_rotor_sensors
from groundstation.comparison.stretches import Marked
from groundstation.dynamics.model import Model
from groundstation.identification.runs import Run
from groundstation.identification.torque import by_saturation

Groups = Sequence[Sequence[Sequence[Run]]]
"""To be fitted and held out, of recordings, of runs."""


def usable(groups: Groups, model: Model) -> tuple[list[list[list[Run]]], list[str]]:
    """The groups without what a search cannot use, and what was left out, in words."""
    steered, saturated = _without_saturated(groups)
    mended, broken = _without_broken_sensors(steered, model)
    return mended, [*saturated, *broken]


def still_there(asked: Sequence[Marked], groups: Groups) -> tuple[list[Marked], list[str]]:
    """The stretches of which a recording is left, and what is not shown, in words."""
    names = {run.name for group in groups for part in group for run in part}
    kept = [one for one in asked if one.recording in names]
    gone = [one for one in asked if one.recording not in names]
    return kept, [
        f"{one.recording}: left out, so its seconds {one.begin_s:g} to {one.end_s:g} are not shown"
        for one in gone
    ]


def _without_saturated(groups: Groups) -> tuple[list[list[list[Run]]], list[str]]:
    """Runs without those in which PWM steers nothing, where others of their group are left, and
    what was left out."""
    kept, warnings = [], []
    for group in groups:
        parts = [by_saturation(part) for part in group]
        if not any(steered for steered, _ in parts):
            kept.append([list(part) for part in group])
            continue
        kept.append([steered for steered, _ in parts if steered])
        warnings += [
            f"{_called(run, alone=not steered)}: left out, a motor is saturated in most rows"
            for steered, saturated in parts
            for run in (saturated if steered else saturated[:1])
        ]
    return kept, warnings


def _called(run: Run, alone: bool) -> str:
    """A recording, or one run of it by its seconds."""
    first = run.start_s - run.recording_start_s
    return run.name if alone else f"{run.name}, {first:.0f} to {first + run.seconds:.0f} s"


def _without_broken_sensors(
    groups: Groups, model: Model
) -> tuple[list[list[list[Run]]], list[str]]:
    """Runs without rotor speeds that do not follow PWM and voltage, and what was left out."""
    warnings: dict[str, str] = {}

    def mended(run: Run) -> Run:
        broken = broken_rotor_sensors(run, model)
        if not broken:
            return run
        motors = " and ".join(f"M{rotor + 1}" for rotor in broken)
        warnings[run.name] = (
            f"{run.name}: the measured speed of {motors} does not follow its PWM and voltage (a"
            " dead sensor, or its column is another motor's): rotor speeds are taken from the motor"
            " model"
        )
        return replace(run, rotor_rev_s=np.full_like(run.rotor_rev_s, np.nan))

    mended_groups = [[[mended(run) for run in part] for part in group] for group in groups]
    return mended_groups, list(warnings.values())
