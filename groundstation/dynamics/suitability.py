"""What a fitted model is good for: the one judgement that fits, reports and designs ask.

It uses all that a model file says of its fit: standard errors, what was not identified, held-out
predictions, inputs that show in the residuals, delay, and the distance from the profile's
constants. An axis is as good as the worst of these says.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from groundstation.dynamics.model import Model, model_vehicle
from groundstation.dynamics.registry import DELAY
from groundstation.dynamics.vehicle import Vehicle
from groundstation.telemetry.arrays import AXES
from groundstation.text import listed

CONSTANT = dict(zip(AXES, ("c0", "c1", "c2"), strict=True))
DESIGN, MOST_STDERR = 0.1, 0.15
"""Standard errors over the value: up to which a constant bears a design as it is, and beyond which
no gains are given. Twice that, either way, is a loop gain that one design cannot serve at full
performance."""
MOST_DELAY_S = 0.002
"""Delay that a design bears beside the model's: the most for a standard error of it, and for a
delay that a fit found and left out."""
UNUSUAL = 2.5
"""Times the profile's value, or one over it, that is worth a word: measured constants of one type
of craft lie within a half of each other."""
DEAD_TIME = DELAY.partition(".")[0]


class Use(IntEnum):
    """What an axis of a model is good for, the least first."""

    NOTHING = 0
    """It was not identified: the file has the profile's value."""
    SIMULATION = 1
    """A rough simulation: no gains are designed on it."""
    FIRST_DESIGN = 2
    """A first, cautious design: its gains are to be tried with care."""
    DESIGN = 3
    """A design as it is."""


WORDS = {
    Use.DESIGN: "good enough to design with",
    Use.FIRST_DESIGN: "for a first, cautious design",
    Use.SIMULATION: "for a rough simulation only",
    Use.NOTHING: "not identified",
}


@dataclass(frozen=True, slots=True)
class Suitability:
    """use: of one axis. reasons: why it is no better, in words, the gravest first. key: of the
    estimate that the first of them is about. share: standard error over value of the axis's
    constant, None where that is not known."""

    use: Use
    reasons: tuple[str, ...]
    key: str
    share: float | None

    @property
    def designs(self) -> bool:
        """Whether gains are designed on it."""
        return self.use >= Use.FIRST_DESIGN


def suitability(model: Model) -> dict[str, Suitability]:
    """Axis -> what the model is good for there. Empty where no fit of the body is in the file: then
    nothing is known of its errors."""
    account = model.fit.get("body", {})
    if not account.get("estimates"):
        return {}
    vehicle, known = model_vehicle(model), _known(account)
    found = {}
    for axis in AXES:
        name = CONSTANT[axis]
        tied = "c0" if name == "c1" and name not in known else name
        share = _share(*known[tied]) if tied in known else None
        said = [
            *((*one, name) for one in _of_the_axis(model, account, vehicle, axis, share)),
            *((*one, DELAY) for one in _of_the_delay(model, account)),
        ]
        said.sort(key=lambda one: one[0])  # stable: of one use the first that was said
        use, key = (said[0][0], said[0][2]) if said else (Use.DESIGN, name)
        found[axis] = Suitability(use, tuple(words for _, words, _ in said), key, share)
    return found


def verdict(found: Mapping[str, Suitability]) -> str:
    """The axes by what they are good for, each with its gravest reason, in one sentence."""
    parts = []
    if best := [axis for axis, one in found.items() if one.use == Use.DESIGN]:
        parts.append(f"good enough to design {listed(best)} with")
    for use in (Use.FIRST_DESIGN, Use.SIMULATION, Use.NOTHING):
        by_reason: dict[str, list[str]] = {}
        for axis, one in found.items():
            if one.use == use:
                by_reason.setdefault(one.reasons[0], []).append(axis)
        parts += [f"{listed(axes)}: {WORDS[use]} ({why})" for why, axes in by_reason.items()]
    words = "; ".join(parts)
    return words[:1].upper() + words[1:]


def profile_constants(vehicle: Vehicle) -> dict[str, float]:
    """What a profile says of each constant that a fit finds."""
    motor = vehicle.motor
    return {
        **dict(zip(CONSTANT.values(), vehicle.body_constants, strict=True)),
        "thrust_per_mass": vehicle.thrust_per_mass,
        **{"a0": motor.a0, "a1": motor.a1, "a2": motor.a2},
    }


def is_unusual(value: float, usual: float, times: float = UNUSUAL) -> bool:
    """Whether a constant lies beyond so many times the profile's."""
    return not 1 / times < value / usual < times


def _known(account: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Name -> value and standard error, by the covariance where there is one: designs use it."""
    found = account["estimates"]
    errors = [float(error) for error in found["stderr"]]
    for place, row in enumerate(found.get("covariance", ())):
        errors[place] = math.sqrt(max(row[place], 0.0)) if row[place] is not None else math.inf
    columns = zip(found["names"], found["values"], errors, strict=True)
    return {str(name): (float(value), error) for name, value, error in columns}


def _share(value: float, error: float) -> float:
    return error / abs(value) if value else math.inf


def _of_the_axis(
    model: Model, account: Mapping[str, Any], vehicle: Vehicle, axis: str, share: float | None
) -> Iterator[tuple[Use, str]]:
    """Why an axis is no better than this use."""
    name = CONSTANT[axis]
    if name in account.get("not_identified", {}):
        yield Use.NOTHING, f"the file has the profile's {name}"
        return
    if share is not None and not share <= DESIGN:
        use = Use.FIRST_DESIGN if share <= MOST_STDERR else Use.SIMULATION
        yield use, f"known to {100 * share:.0f} % only"
    for horizon, use in (("20ms", Use.SIMULATION), ("50ms", Use.FIRST_DESIGN)):
        percent = _held_out(account, f"gyro_{axis}_fit_percent_{horizon}")
        if percent is not None and percent < 0.0:
            far = horizon.replace("ms", " ms")
            yield use, f"unseen data are predicted worse than by their mean {far} ahead"
    percent = _held_out(account, "accelerometer_z_fit_percent")
    if percent is not None and percent < 0.0:
        yield Use.FIRST_DESIGN, "thrust on unseen data is predicted worse than by its mean"
    value = getattr(model.body, name, None)
    usual = profile_constants(vehicle)[name]
    if value is not None and usual and is_unusual(value, usual):
        yield Use.FIRST_DESIGN, f"{name} is {_times(value / usual)} the profile's"
    if axis in account.get("crossed", ()):
        yield Use.FIRST_DESIGN, "it turns with the torque of another axis as well"
    if account.get("contradictions"):
        yield Use.FIRST_DESIGN, "channels of the recordings contradict each other"
    search = model.fit.get("discrepancy", {})
    if search.get("verdict") == "unexplained":
        yield Use.FIRST_DESIGN, "a search for what is missing left errors unexplained"
    test = account.get("residual_tests", {}).get(f"{axis} rate", {}).get("cross_correlation", {})
    if not search and not test.get("passes", True):  # a search has looked into it
        yield Use.FIRST_DESIGN, "the input still shows in its residuals"


def _of_the_delay(model: Model, account: Mapping[str, Any]) -> Iterator[tuple[Use, str]]:
    """The same of the delay, which every loop has."""
    _, error = _known(account).get(DELAY, (0.0, 0.0))
    if not error <= MOST_DELAY_S:
        yield Use.SIMULATION, f"the dead time is known to ±{1e3 * error:.1f} ms only"
    along = account.get("fitted_along", {}).get(DELAY, {}).get("value", 0.0)
    has_one = any(term.name == DEAD_TIME for term in model.effects)
    if not has_one and DEAD_TIME in account.get("left_out", ()) and along > MOST_DELAY_S:
        late = f"{1e3 * along:.1f} ms"
        yield Use.FIRST_DESIGN, f"the model has no dead time and the data show {late}"


def _held_out(account: Mapping[str, Any], name: str) -> float | None:
    held = account.get("validation")
    value = held.get(name) if isinstance(held, Mapping) else None
    return None if value is None else float(value)


def _times(ratio: float) -> str:
    return f"{ratio:.2g} times" if ratio > 1.0 else f"1/{1 / ratio:.2g} of"
