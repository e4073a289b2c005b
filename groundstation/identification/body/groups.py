"""The body's constants by what the craft was doing: do they differ beyond their errors?

The thesis groups its flights by constant or changing altitude, stationary or moving, low or high
(7.3.5), because unregulated air changes what a fit finds. Here every group of rows is fitted alone,
with the motors and effects of the fit of all, and each constant is tested for being one and the
same in all groups (chi-squared). The motor's uncertainty is common to them and not counted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.airborne import flights_in
from groundstation.identification.body.fit import fit_body
from groundstation.identification.estimate import Estimates
from groundstation.identification.excitation import body_excitation
from groundstation.identification.runs import Run
from groundstation.identification.segments import hover
from groundstation.identification.stretches import LEAST_S, PIECE_S, Stretch
from groundstation.identification.velocity import velocity_of
from groundstation.spans import spans

Mask = NDArray[np.bool_]

LOW_M = 0.35
"""Height above the take-off below which a craft is low, where a rest on the ground tells it."""
CLIMB_M_S, CLIMB_WINDOW_S = 0.15, 2.0
"""RMS of the vertical speed around a row beyond which the altitude changes."""
CHANCE = 0.01
"""That any constant of a craft whose constants are the same is said to differ."""


@dataclass(frozen=True, slots=True)
class Group:
    """One group. reason: why it could not be fitted; then there are no estimates."""

    name: str
    seconds: float
    estimates: Estimates | None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Groups:
    """by: what they differ in. chance: by constant, that groups of one craft differ as much or
    more; of constants that two groups or more have."""

    by: str
    groups: tuple[Group, ...]
    chance: dict[str, float]

    @property
    def differ(self) -> tuple[str, ...]:
        """Constants that differ beyond their errors, all tests counted."""
        return tuple(n for n, p in self.chance.items() if p < CHANCE / len(self.chance))

    @property
    def lines(self) -> list[str]:
        """What was found, in words."""
        found = [f"{one.name}: not fitted: {one.reason}" for one in self.groups if one.reason]
        if not self.chance:
            return [*found, f"by {self.by}: fewer than two groups could be fitted"]
        same = [name for name in self.chance if name not in self.differ]
        for name in self.differ:
            sizes = ", ".join(
                f"{one.name} {one.estimates[name]:.4g} +- {_stderr(one.estimates, name):.2g}"
                for one in self.groups
                if one.estimates is not None and name in one.estimates.names
            )
            found.append(f"{name} differs by {self.by} beyond its errors: {sizes}")
        if same:
            found.append(f"by {self.by} the same within their errors: {', '.join(same)}")
        return found

    def as_dict(self) -> dict[str, Any]:
        """For the model file."""
        return {
            "by": self.by,
            "groups": [
                {
                    "name": one.name,
                    "seconds": one.seconds,
                    "reason": one.reason,
                    "estimates": None if one.estimates is None else one.estimates.as_dict(),
                }
                for one in self.groups
            ],
            "chance": self.chance,
            "differ": list(self.differ),
            "lines": self.lines,
        }


def require_grouping(by: str) -> None:
    """Raises BadInputError for a grouping that is none."""
    if by not in GROUPINGS:
        raise BadInputError(f"--by {by}: there are {', '.join(GROUPINGS)}")


def fit_groups(
    stretches: Sequence[Stretch],
    by: str,
    vehicle: Vehicle,
    effects: Sequence[str] = (),
    tie_roll_pitch: bool = False,
) -> Groups:
    """Fit the groups of ``GROUPINGS[by]`` of stretches one by one, as ``fit_body`` does.

    Raises BadInputError where a channel that tells the groups is missing.
    """
    groups: dict[str, list[Stretch]] = {}
    for one in stretches:
        for name, mask in GROUPINGS[by](one.run).items():
            parts = groups.setdefault(name, [])
            for first, last in spans(mask[one.rows]):
                if (last - first) * one.run.period_s >= PIECE_S:
                    parts.append(replace(one, first=one.first + first, last=one.first + last))
    fitted = tuple(
        _fitted(name, parts, vehicle, effects, tie_roll_pitch) for name, parts in groups.items()
    )
    return Groups(by, fitted, _chances([one.estimates for one in fitted if one.estimates]))


def _fitted(
    name: str, parts: Sequence[Stretch], vehicle: Vehicle, effects: Sequence[str], tie: bool
) -> Group:
    seconds = sum(len(one) * one.run.period_s for one in parts)
    if seconds < LEAST_S:
        short = f"{seconds:.1f} s of pieces of {PIECE_S:g} s, at least {LEAST_S:g} s are needed"
        return Group(name, seconds, None, short)
    try:
        body_excitation(parts, vehicle, effects, tie)
        fit = fit_body(parts, vehicle, effects, tie)
    except BadInputError as error:
        return Group(name, seconds, None, str(error))
    return Group(name, seconds, fit.estimates)


def _chances(estimates: Sequence[Estimates]) -> dict[str, float]:
    """Constant -> chance that estimates of one value scatter as much or more."""
    from scipy.stats import chi2

    found = {}
    for name in dict.fromkeys(name for one in estimates for name in one.names):
        have = [one for one in estimates if name in one.names and _stderr(one, name) > 0.0]
        if len(have) > 1:
            weights = np.array([_stderr(one, name) ** -2.0 for one in have])
            values = np.array([one[name] for one in have])
            mean = (weights * values).sum() / weights.sum()
            found[name] = float(chi2.sf((weights * (values - mean) ** 2).sum(), len(have) - 1))
    return found


def _stderr(estimates: Estimates, name: str) -> float:
    return float(estimates.stderr[estimates.names.index(name)])


def _by_altitude(run: Run) -> dict[str, Mask]:
    """Low, and otherwise by vertical speed: what the accelerometer shows of climbs and descents."""
    if not (np.isfinite(run.accelerometer).all() and np.isfinite(run.attitude).all()):
        raise BadInputError(f"{run.name}: no accelerometer and angles to judge the altitude by")
    up = np.square(velocity_of(run)[:, 2])
    width = round(CLIMB_WINDOW_S / run.period_s)
    changing = np.convolve(up, np.ones(width) / width, "same") > CLIMB_M_S**2
    low = np.zeros(len(run), np.bool_)
    for flight in flights_in(run):
        low |= flight.height_m < LOW_M
    return {"low": low, "steady altitude": ~changing & ~low, "changing altitude": changing & ~low}


def _by_motion(run: Run) -> dict[str, Mask]:
    still = hover(run)
    return {"hover": still, "moving": ~still}


def _by_recording(run: Run) -> dict[str, Mask]:
    return {run.name: np.ones(len(run), np.bool_)}


GROUPINGS: dict[str, Callable[[Run], dict[str, Mask]]] = {
    "altitude": _by_altitude,
    "motion": _by_motion,
    "recording": _by_recording,
}
