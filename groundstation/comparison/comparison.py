"""A model against recordings: its prediction errors beside the noise floor of the same rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

from groundstation.comparison.consistency import require_consistent
from groundstation.comparison.gap import (
    FURTHER_EVERY_S,
    FURTHER_S,
    HORIZONS_S,
    AheadErrors,
    ahead_errors,
    overall,
    pooled_rms,
)
from groundstation.comparison.localisation import Place, where
from groundstation.comparison.noise_floor import BlackBox, Floor, floor_errors, learn, prepare
from groundstation.comparison.refusals import (
    require_channels,
    require_flight,
    require_predictions,
)
from groundstation.comparison.regimes import motion_of
from groundstation.comparison.rotor_drive import driven_by_speeds
from groundstation.dynamics.model import Model, Turning, model_vehicle, require_body
from groundstation.identification.runs import Run, without_gaps
from groundstation.report.page import Result
from groundstation.telemetry.arrays import Array


@dataclass(frozen=True, repr=False)
class Comparison(Result):
    """One model on some runs.

    errors, floors: one of each per run. black_box: what the floors come from. turning: what of the
    model turns the craft. warnings: recordings whose predictions are not driven by their PWM, and
    why. horizons_s: how far ahead.
    """

    model: Model
    errors: tuple[AheadErrors, ...]
    floors: tuple[Floor, ...]
    black_box: BlackBox
    turning: Turning = "body"
    warnings: Mapping[str, str] = field(default_factory=dict)
    horizons_s: tuple[float, ...] = HORIZONS_S
    SHOWN_BY: ClassVar[str] = "groundstation.discrepancy.shown:comparison"

    def _what(self) -> str:
        names = ", ".join(dict.fromkeys(one.run.name for one in self.errors))
        return f"{names}: prediction errors {self.gap:.2f} times noise"

    @cached_property
    def rms(self) -> Array:
        """Of the errors at all horizons, (9,), SI."""
        return pooled_rms([error for one in self.errors for error in one.horizons])

    @cached_property
    def noise_floor(self) -> Array:
        """The same of what noise leaves, (9,), SI."""
        return pooled_rms([error for one in self.floors for error in one.horizons])

    @property
    def gap(self) -> float:
        """All channels in one number; 1.0 says that nothing is left to explain."""
        return overall(self.rms, self.noise_floor)

    def beside(self, other: Comparison) -> float:
        """The gap in units of another comparison's noise floor."""
        return overall(self.rms, other.noise_floor)

    @cached_property
    def places(self) -> list[Place]:
        """Channel by regime, the most significant excess first."""
        return where(self.errors, self.floors)

    def at_horizon(self, number: int) -> tuple[Array, Array]:
        """(error, noise floor), (9,) each, SI, at one of ``horizons_s``."""
        error = pooled_rms([one.horizons[number] for one in self.errors])
        return error, pooled_rms([one.horizons[number] for one in self.floors])

    def with_model(
        self, model: Model, every_s: float = 0.0, same_observer: bool = False
    ) -> Comparison:
        """Another model on the same runs, beside the same floor. every_s: predictions start no more
        often than that. same_observer: of one that hardly differs, with the noise that suits this
        one."""
        errors = tuple(
            ahead_errors(
                one.recorded,
                model,
                like=one,
                same_observer=same_observer,
                turning=self.turning,
                every_s=every_s,
                horizons_s=self.horizons_s,
            )
            for one in self.errors
        )
        return replace(self, model=model, errors=errors)

    def further(self, black_box: BlackBox | None = None) -> Comparison:
        """The same model on the same rows 200 and 500 ms ahead, beside the noise floor there.

        black_box: learnt that far ahead on other runs; None: learnt on these.
        """
        far = replace(self, horizons_s=FURTHER_S).with_model(self.model, FURTHER_EVERY_S)
        floors, learnt = _floors(far.errors, self.model, black_box)
        return replace(far, floors=floors, black_box=learnt)


@dataclass(frozen=True, slots=True)
class Judged:
    """Rows ``first`` to ``last`` of a run; those before only tell the state in which it begins."""

    run: Run
    first: int
    last: int


def compare(
    flights: Sequence[Run | Judged],
    model: Model,
    black_box: BlackBox | None = None,
    turning: Turning = "body",
) -> Comparison:
    """Judge a model on runs (``recordings.flights_of``), or on parts of them.

    black_box: learnt on other runs, so that it has not seen these; None: learnt on these.
    turning: what turns the craft, the model's body or its ARX polynomials.

    Raises BadInputError where the model has no body or is another craft's, where channels that
    every prediction needs are missing or do not fit together, and where nothing flies.
    """
    parts = [one if isinstance(one, Judged) else Judged(one, 0, len(one)) for one in flights]
    require_channels([part.run for part in parts])
    require_body(model)
    motions = [motion_of(without_gaps(part.run), model) for part in parts]
    require_consistent([part.run for part in parts], model, motions)
    warnings: dict[str, str] = {}
    for number, (part, motion) in enumerate(zip(parts, motions, strict=True)):
        run, why = driven_by_speeds(part.run, model, motion)
        if why:
            parts[number], warnings[run.name] = replace(part, run=run), why
            motions[number] = motion_of(without_gaps(run), model)
    errors = tuple(
        ahead_errors(part.run, model, slice(part.first, part.last), motion=motion, turning=turning)
        for part, motion in zip(parts, motions, strict=True)
    )
    require_flight(errors)
    require_predictions(errors)
    floors, learnt = _floors(errors, model, black_box)
    return Comparison(model, errors, floors, learnt, turning, warnings)


def _floors(
    errors: Sequence[AheadErrors], model: Model, black_box: BlackBox | None
) -> tuple[tuple[Floor, ...], BlackBox]:
    configuration = model_vehicle(model).configuration
    prepared = [prepare(one, configuration) for one in errors]
    learnt = black_box if black_box is not None else learn(prepared)
    return tuple(floor_errors(learnt, one) for one in prepared), learnt
