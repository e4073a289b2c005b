"""What of recordings a search can use: flights with every channel that is needed, that PWM steers,
and rotor sensors that follow it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from groundstation.comparison.consistency import (
    broken_rotor_sensors,
    missing_channel,
    require_channels,
)
from groundstation.dynamics.model import Model
from groundstation.identification.runs import Run, mostly_saturated

Groups = Sequence[Sequence[Sequence[Run]]]
"""To be fitted and held out, of recordings, of runs."""


def usable(groups: Groups, model: Model) -> tuple[list[list[list[Run]]], list[str]]:
    """The groups without what a search cannot use, and what was left out, in words.

    Raises BadInputError where all of a group are of no use, and one for want of a channel.
    """
    useful, useless = _without_useless(groups)
    require_channels([run for group in useful for part in group for run in part])
    sound, broken = _without_broken_sensors(useful, model)
    return sound, [*useless, *broken]


def _without_useless(groups: Groups) -> tuple[list[list[list[Run]]], list[str]]:
    """Runs without those that tell nothing, where others of their group are left, and what was left
    out."""
    kept: list[list[list[Run]]] = []
    warnings: list[str] = []
    for group in groups:
        parts = [[(run, _useless(run)) for run in part] for part in group if part]
        if not any(why is None for part in parts for _, why in part):
            kept.append([[run for run, _ in part] for part in parts])
            continue
        rest = [[run for run, why in part if why is None] for part in parts]
        kept.append([part for part in rest if part])
        for part in parts:
            alone = all(why is not None for _, why in part)
            lines = [f"{_called(run, alone)}: left out, {why}" for run, why in part if why]
            warnings += lines[:1] if alone else lines
    return kept, warnings


def _useless(run: Run) -> str | None:
    """Why a search has nothing of a run."""
    missing = missing_channel(run)
    if missing is not None:
        return f"{missing} is not in the recording"
    return "a motor is saturated in most rows" if mostly_saturated(run) else None


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
