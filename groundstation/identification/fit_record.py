"""What an identification found and the arrays behind it: for model files, and for figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import msgspec
import numpy as np

from groundstation.dynamics.model import EffectTerm, Estimate, Model, with_origin
from groundstation.identification.arx.residual_tests import (
    CorrelationTest,
    cross_correlation_test,
    whiteness_test,
)
from groundstation.identification.estimate import Estimates
from groundstation.report.page import Result
from groundstation.telemetry.arrays import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
    SHOWN_BY: ClassVar[str] = "groundstation.identification.shown:identified"

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
    from groundstation.identification.likelihood.parameters import ALONG

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
