"""What an identification found and the arrays behind it, and whether it is a result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import msgspec
import numpy as np

from groundstation.dynamics.meanings import is_unusual, profile_constants
from groundstation.dynamics.model import EffectTerm, Estimate, Model, with_origin
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.estimate import (
    CorrelationTest,
    Estimates,
    cross_correlation_test,
    whiteness_test,
)
from groundstation.report.page import Result
from groundstation.telemetry.arrays import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# What an identification found and the arrays behind it: for model files, and for figures.


TOLD = 3.0
"""Standard errors from which a lag is told from none."""
Progress = Callable[[float, str], None]
"""(share done, what is being done)."""


def silent(_share: float, _what: str) -> None:
    """No progress shown."""


@dataclass(frozen=True, slots=True)
class Trace:
    """A measured channel and what the model says of it, on data that no fit has seen.

    time_s, measured, modelled: (n,). note: how the model was run.
    """

    channel: str
    unit: str
    time_s: Array
    measured: Array
    modelled: Array
    note: str


@dataclass(frozen=True, slots=True)
class ResidualTest:
    """Residuals of one channel, scaled to standard deviations, against themselves and an input."""

    channel: str
    against: str
    whiteness: CorrelationTest
    cross: CorrelationTest

    def as_dict(self) -> dict[str, Any]:
        """For the model file."""
        return {
            "whiteness": {"passes": self.whiteness.passes, "outside": self.whiteness.outside},
            "cross_correlation": {
                "against": self.against,
                "passes": self.cross.passes,
                "outside": self.cross.outside,
            },
        }


@dataclass(frozen=True, slots=True)
class Step:
    """Response of an ARX model to a unit step of u'."""

    axis: str
    label: str
    time_s: Array
    output: Array
    plausible: bool
    chosen: bool


class Preparation(Protocol):
    """What was made of the recordings before the fit."""

    def figures(self) -> list[tuple[Figure, str]]:
        """Figures with what one sees in them."""
        ...


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the report draws. estimates: by title."""

    estimates: Mapping[str, Estimates] = field(default_factory=dict)
    traces: Sequence[Trace] = ()
    residuals: Sequence[ResidualTest] = ()
    steps: Sequence[Step] = ()
    preparation: Preparation | None = None

    @classmethod
    def of_all(cls, parts: Sequence[Evidence]) -> Evidence:
        """One after the other; without what was made of recordings."""
        return cls(
            {title: found for one in parts for title, found in one.estimates.items()},
            [trace for one in parts for trace in one.traces],
            [test for one in parts for test in one.residuals],
            [step for one in parts for step in one.steps],
        )


@dataclass(frozen=True, slots=True, repr=False)
class Identified(Result):
    """A model with what was identified in it, the account that its file keeps, the arrays behind.

    account: ``what``, ``method``, ``samples``, ``estimates``, ``identification``, ``validation``,
    ``warnings`` and what else the kind of fit has.
    """

    model: Model
    account: dict[str, Any]
    evidence: Evidence
    SHOWN_BY: ClassVar[str] = "groundstation.identification.report:identified"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is doubtful, in words."""
        return tuple(self.account["warnings"])

    def _what(self) -> str:
        found = self.account.get("estimates") or {"names": (), "values": (), "stderr": ()}
        numbers = ", ".join(
            f"{name} {value:.4g} +- {error:.1g}"
            for name, value, error in zip(
                found["names"], found["values"], found["stderr"], strict=True
            )
        )
        return f"{self.account['what']} of {self.model.vehicle}" + f": {numbers}" * bool(numbers)

    def documented(self, **provenance: Any) -> Model:
        """The model with the account under ``fit``, as later fits and designs need it.

        provenance: ``recordings``, ``held_out`` or whatever else belongs into the account.
        """
        account = {**self.account, **provenance}
        fit = {**self.model.fit, account["what"]: account}
        return with_origin(msgspec.structs.replace(self.model, fit=fit))


def residual_test(
    channel: str, left: Array, against: str, inputs: Array, fitted_rows: int
) -> ResidualTest:
    """Both tests of held-out residuals (n,) and the input (n,) behind them."""
    cross = cross_correlation_test(left, inputs, fitted_rows=fitted_rows)
    return ResidualTest(channel, against, whiteness_test(left), cross)


def effect_terms(estimates: Estimates, units: Callable[[str, str], str]) -> list[EffectTerm]:
    """The effects among ``effect.parameter`` estimates, as models hold them."""
    found: dict[str, dict[str, Estimate]] = {}
    for name, value, error in zip(estimates.names, estimates.values, estimates.stderr, strict=True):
        effect, dot, parameter = name.partition(".")
        if dot:
            estimate = Estimate(float(value), float(error), units(effect, parameter))
            found.setdefault(effect, {})[parameter] = estimate
    return [EffectTerm(name, parameters) for name, parameters in found.items()]


def along_term(value: float, stderr: float) -> list[EffectTerm]:
    """The lag of the sensor of rotor speeds, in s, as models hold it; nothing where none is told.

    A fit without a model of the motors (``fit body``) says it after the motors' and in its place.
    """
    from groundstation.identification.likelihood.motion import ALONG

    (size,) = ALONG.definition.sizes
    if not (value > TOLD * stderr and size.low <= value <= size.high):
        return []
    return [EffectTerm(ALONG.effect, {size.name: Estimate(value, stderr, size.unit)})]


def unit_of(effect: str, parameter: str) -> str:
    """The catalogue's unit."""
    from groundstation.dynamics.registry import EFFECTS

    return EFFECTS[effect].parameter(parameter).unit


def with_effects(model: Model, terms: Sequence[EffectTerm]) -> tuple[EffectTerm, ...]:
    """A model's effects, those of the same name replaced and the rest kept."""
    new = {term.name for term in terms}
    return (*(term for term in model.effects if term.name not in new), *terms)


def fitted_effects(names: Sequence[str], model: Model, known: Sequence[str]) -> tuple[str, ...]:
    """The effects to fit: those that were asked for, then those of the starting model that this
    fit knows (a base that was fitted beside an effect is wrong without it)."""
    wanted = [*names, *(term.name for term in model.effects if term.name in known)]
    return tuple(dict.fromkeys(wanted))


def liveliest(signal: Array, period_s: float, seconds: float) -> slice:
    """The rows of ``seconds`` in which a signal (n,) varies most: what is worth drawing.

    Vibration, which is everywhere, does not count: changes of the mean over 50 ms do.
    """
    smooth = max(1, round(0.05 / period_s))
    sums = np.concatenate([[0.0], np.cumsum(signal)])
    means = (sums[smooth:] - sums[:-smooth]) / smooth if len(signal) >= smooth else signal
    width = min(len(means), max(2, round(seconds / period_s)))
    moved = np.concatenate([[0.0], np.cumsum(np.square(np.diff(means, prepend=means[:1])))])
    first = int(np.argmax(moved[width:] - moved[:-width]))
    return slice(first, first + width)


# Is this estimate a result? One set of rules for every fit, whatever it fitted.
#
# An estimate that stands where it began, one that no error is known of, one that no craft of the
# profile can have, and a model that predicts what it has not seen worse than the mean does, are
# what a fit leaves that could not fit: they are never passed on as a result.


UNLIKE = 5.0
"""Times the profile's value, or one over it, that no craft of the profile has; one beyond
``suitability.UNUSUAL`` is worth a word."""
FREE = ("c2", "a1", "a2")
"""Constants that differ more from craft to craft, with the propellers and what drags on them: they
are worth a word where others are none, and the rest of the model stands."""
USELESS = -100.0
"""Per cent of fit, errors of twice the mean's, from which a model is none."""
TILT = ("roll", "pitch")
AWAY = 1e-9
"""Relative distance from its start by which an estimate has moved."""


def require_results(
    account: Mapping[str, Any], before: Model, vehicle: Vehicle, of_recordings: Sequence[str] = ()
) -> list[str]:
    """What is doubtful of a fit, in words.

    of_recordings: what is wrong with what it was made on, as far as that is known.

    Raises BadInputError, with the reasons, where estimates of it are no results.
    """
    reasons, doubts = no_results(account, before, vehicle)
    if reasons:
        raise BadInputError(
            f"{account['what']} not identified, because {'; '.join(reasons)}"
            + (f" ({'; '.join(of_recordings)})" if of_recordings else "")
            + ": look at the recordings with 'groundstation inspect', and is --vehicle the craft?"
        )
    return doubts


def no_results(
    account: Mapping[str, Any], before: Model, vehicle: Vehicle
) -> tuple[list[str], list[str]]:
    """Why estimates of a fit are none, and what is doubtful of those that are, in words.

    account: what a workflow says of its fit. before: the model it began with.
    """
    reasons: list[str] = []
    doubts: list[str] = []
    for name, value, error in _estimates(account):
        told = account.get("not_identified", {})
        if name in told:
            continue
        start, usual = _starts(before, vehicle).get(name), profile_constants(vehicle).get(name)
        if not np.isfinite(value) or not np.isfinite(error):
            reasons.append(f"{name} is {value:.3g} +- {error:.2g}")
        elif error == 0.0:
            at = " where it began" if start is not None and _is_at(value, start) else ""
            reasons.append(f"{name} stands at {value:.4g}{at} and nothing tells its error")
        elif start is not None and _is_at(value, start):
            reasons.append(f"{name} did not move from where it began, {value:.4g}")
        elif usual and is_unusual(value, usual, UNLIKE):
            line = f"{name} is {value:.3g}, and {usual:.3g} by the profile {vehicle.name!r}"
            (doubts if name in FREE else reasons).append(line)
        elif usual and is_unusual(value, usual):
            doubts.append(f"{name} is {value:.3g}, and {usual:.3g} by the profile {vehicle.name!r}")
    for name, percent, decides in _fits(account.get("validation")):
        if percent < 0.0:
            line = (
                f"{name} on unseen data is predicted worse than by its mean (fit {percent:.0f} %)"
            )
            (reasons if decides and percent < USELESS else doubts).append(line)
    return reasons, doubts


def _estimates(account: Mapping[str, Any]) -> Iterator[tuple[str, float, float]]:
    found = account.get("estimates") or {}
    columns: Sequence[Sequence[Any]] = [found.get(key, ()) for key in ("names", "values", "stderr")]
    for name, value, error in zip(*columns, strict=True):
        if "." not in name:  # of an effect: its own range is judged by who fits it
            yield str(name), float(value), float(error)


def _fits(validation: Any) -> Iterator[tuple[str, float, bool]]:
    """Name and per cent of what was predicted of unseen data, and whether it decides.

    Of a body roll and pitch do, where neither is predicted better than by its mean: a flight may
    hardly turn about one axis, or hardly climb, and then its mean is a better prediction than any
    model's that misses an effect.
    """
    if isinstance(validation, Mapping):
        percents = {k: float(v) for k, v in validation.items() if "fit_percent" in k}
        for name, percent in percents.items():
            both = (name.replace("roll", "pitch"), name.replace("pitch", "roll"))
            decides = any(one in name for one in TILT) and all(percents[one] < 0.0 for one in both)
            yield name.replace("_fit_percent", "").replace("_", " "), percent, decides
    elif isinstance(validation, Sequence):
        yield from (
            (f"rotor speed of {one['recording']}", float(one["rotor_fit_percent"]), True)
            for one in validation
            if "rotor_fit_percent" in one
        )


def _is_at(value: float, start: float) -> bool:
    return abs(value - start) <= AWAY * abs(start)


def _starts(before: Model, vehicle: Vehicle) -> dict[str, float]:
    """Where a fit began: the model's constants, or else the profile's."""
    found = profile_constants(vehicle)
    motor, body = before.motor, before.body
    found |= {"a0": motor.a0, "a1": motor.a1, "a2": motor.a2}
    if body is not None:
        found |= {
            **{"c0": body.c0, "c1": body.c1, "c2": body.c2},
            "thrust_per_mass": body.thrust_per_mass,
        }
    return found
