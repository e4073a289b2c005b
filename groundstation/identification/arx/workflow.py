"""From flights to ARX polynomials, with the thesis's tables and tests (7.3.7)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from groundstation.dynamics.model import ArxAxis, Model, rotor_motors
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.arx.data import (
    LEAST_ROWS,
    ArxData,
    arx_data,
    input_shows,
    require_usable,
)
from groundstation.identification.arx.fit import (
    ArxCandidate,
    ArxSearch,
    Criterion,
    Order,
    arx_estimates,
    free_run_rms,
    prediction_rms,
    predictions,
    residuals,
    search_arx,
    step_response,
)
from groundstation.identification.division import divided
from groundstation.identification.fit_record import (
    Evidence,
    Identified,
    Progress,
    ResidualTest,
    Step,
    Trace,
    liveliest,
    residual_test,
    silent,
)
from groundstation.identification.runs import Run
from groundstation.identification.segments import EVERYTHING, Selection
from groundstation.identification.stretches import LEAST_S, Stretch, stretches_of
from groundstation.telemetry.arrays import AXES

STEPS_DRAWN = 4
AHEAD_S = (0.02, 0.05)
DRAWN_S = 3.0
LEAST_F = 3.0
LONGEST_ROWS = 12
"""Rows that the largest structure looks back."""
UNITS = {"attitude": ("rad", "angle"), "gyro": ("rad/s", "rate")}


def identify_arx(
    runs: Sequence[Run],
    held: Sequence[Run],
    before: Model,
    vehicle: Vehicle,
    criterion: Criterion = Criterion.FREE_RUN,
    channel: str = "attitude",
    decimate: int = 1,
    selection: Selection = EVERYTHING,
    orders: Sequence[Order] = (),
    progress: Progress = silent,
) -> Identified:
    """One ARX polynomial per axis, angle (or rate) from u', with the table of all structures.

    held: what no fit sees (none: ``division``). channel: ``attitude`` or ``gyro``. decimate:
    rows of the recording per row of the model. orders: structures to choose from and to show
    beside each other, instead of all.
    """
    motors = rotor_motors(before)
    fit_on, validate_on, apart = _parts(runs, held, before, vehicle, selection, decimate)

    def rows_of(part: Sequence[Stretch], axis: str) -> list[ArxData]:
        runs = [one.run[one.rows] for one in part]
        plus_or_x = vehicle.configuration
        return [
            arx_data(run, axis, motors, plus_or_x, channel=channel, decimate=decimate)
            for run in runs
        ]

    data = {axis: (rows_of(fit_on, axis), rows_of(validate_on, axis)) for axis in AXES}
    for one, other in data.values():
        for part in (*one, *other):
            require_usable(part, one[0].period_s, LONGEST_ROWS)
    found: dict[str, _Found] = {}
    for number, (axis, parts) in enumerate(data.items()):
        progress(number / 3, f"searching models of {axis}")
        found[axis] = _found(axis, channel, criterion, orders, *parts)
    account = {
        "what": "arx",
        "method": f"least squares, chosen by {criterion.value.replace('_', ' ')}",
        "channel": channel,
        "decimate": decimate,
        "samples": sum(len(one) for one in fit_on),
        "selection": str(selection),
        "held_out": apart,
        "orders": [list(order) for order in orders],
        "axes": {axis: one.report for axis, one in found.items()},
        "other_axis": {
            "roll_model_on_pitch": free_run_rms(found["roll"].chosen, data["pitch"][1]),
            "pitch_model_on_roll": free_run_rms(found["pitch"].chosen, data["roll"][1]),
        },
        "warnings": [line for one in found.values() for line in one.warnings],
    }
    model = msgspec.structs.replace(before, arx={axis: one.chosen for axis, one in found.items()})
    return Identified(model, account, Evidence.of_all([one.evidence for one in found.values()]))


@dataclass(frozen=True, slots=True)
class _Found:
    """The model of one axis. report: its part of the account."""

    chosen: ArxAxis
    report: dict[str, Any]
    warnings: list[str]
    evidence: Evidence


def _found(
    axis: str,
    channel: str,
    criterion: Criterion,
    orders: Sequence[Order],
    fit_on: Sequence[ArxData],
    validate_on: Sequence[ArxData],
) -> _Found:
    """The search of one axis; what is shown of it has the chosen structure first."""
    shown = _require_shown(axis, fit_on)
    search = search_arx(fit_on, validate_on, criterion=criterion, among=orders)
    chosen, beside = search.chosen, _beside(search, orders)
    estimates = arx_estimates(chosen.axis, fit_on)
    rows = sum(len(part.outputs) for part in fit_on)
    tests = [_tested(axis, channel, c, validate_on[0], rows) for c in beside]
    report = {
        "chosen": chosen.label,
        "input_shows_f": shown,
        "estimates": estimates.as_dict(),
        **_judged(search, fit_on, validate_on, UNITS[channel][0]),
        **tests[0].as_dict(),
        **_named(beside, tests),
    }
    traces = [_trace(axis, channel, c.axis, validate_on[0]) for c in beside]
    steps = _steps(axis, search, beside)
    evidence = Evidence({f"{axis} {chosen.label}": estimates}, traces, tests, steps)
    return _Found(chosen.axis, report, list(_warnings(axis, chosen, tests[0])), evidence)


def _parts(
    runs: Sequence[Run],
    held: Sequence[Run],
    before: Model,
    vehicle: Vehicle,
    selection: Selection,
    decimate: int,
) -> tuple[list[Stretch], list[Stretch], str]:
    """What is fitted on, what no fit sees, and in words how the two were divided."""
    motors = rotor_motors(before)
    stretches = stretches_of(runs, motors, selection=selection)
    if held:
        return stretches, stretches_of(held, motors, selection=selection), ""
    least_s = max((LEAST_ROWS + LONGEST_ROWS) * decimate * stretches[0].run.period_s, LEAST_S)
    return divided(stretches, vehicle.configuration, least_s)


def _warnings(axis: str, chosen: ArxCandidate, test: ResidualTest) -> Iterator[str]:
    if not chosen.plausible:
        yield f"{axis}: the step response of the chosen model is not plausible"
    if not test.cross.passes:
        yield f"{axis}: the residuals of the chosen model follow its input"


def _require_shown(axis: str, data: Sequence[ArxData]) -> float:
    shown = input_shows(data)
    if shown < LEAST_F:
        names = ", ".join(sorted({one.name for one in data}))
        raise BadInputError(
            f"{names}: torque does not show in {axis} (F = {shown:.1f}, at least {LEAST_F:.0f} is"
            " needed); excite that axis"
        )
    return shown


def _ahead(part: str, axis: ArxAxis, data: Sequence[ArxData], unit: str) -> dict[str, float]:
    unit = unit.replace("/", "_")
    return {
        f"rms_{1e3 * horizon:.0f}ms_{part}_{unit}": prediction_rms(
            axis, data, max(1, round(horizon / axis.ts))
        )
        for horizon in AHEAD_S
    }


def _judged(
    search: ArxSearch, one: Sequence[ArxData], other: Sequence[ArxData], unit: str
) -> dict[str, Any]:
    """How well the chosen structure predicts either part, and the table of all."""
    chosen = search.chosen.axis
    return {
        **_ahead("identification", chosen, one, unit),
        **_ahead("validation", chosen, other, unit),
        "table": _table(search, one, other, unit),
    }


def _table(
    search: ArxSearch, one: Sequence[ArxData], other: Sequence[ArxData], unit: str
) -> list[dict[str, Any]]:
    """Every structure, the best by free run first, as the thesis's tables 7.3 and 7.5."""
    name = unit.replace("/", "_")
    return [
        {
            "model": candidate.label,
            f"rms_identification_{name}": candidate.rms_fit,
            f"rms_validation_{name}": candidate.rms_validation,
            f"rms_1row_identification_{name}": candidate.rms_step,
            **_ahead("identification", candidate.axis, one, unit),
            **_ahead("validation", candidate.axis, other, unit),
            "plausible_step": candidate.plausible,
        }
        for candidate in search.candidates
    ]


def _trace(axis: str, channel: str, chosen: ArxAxis, data: ArxData) -> Trace:
    ahead = max(1, round(AHEAD_S[1] / chosen.ts))
    modelled, first = predictions(chosen, data, ahead)
    measured = data.outputs[first:]
    rows = liveliest(measured, data.period_s, DRAWN_S)
    scale = 180.0 / np.pi
    unit, name = ("deg", "angle") if channel == "attitude" else ("deg/s", "rate")
    return Trace(
        f"{axis} {name}",
        unit,
        np.asarray(data.period_s * (first + np.arange(len(measured)))[rows], np.float64),
        scale * measured[rows],
        scale * modelled[first:][rows],
        f"predicted {1e3 * AHEAD_S[1]:.0f} ms ahead by {_label(chosen)}",
    )


def _beside(search: ArxSearch, orders: Sequence[Order]) -> list[ArxCandidate]:
    """What is shown beside each other: the chosen structure, then the others that were named."""
    named = [one for one in search.candidates if one.order in orders and one is not search.chosen]
    return [search.chosen, *named]


def _tested(
    axis: str, channel: str, candidate: ArxCandidate, data: ArxData, fitted_rows: int
) -> ResidualTest:
    left = residuals(candidate.axis, data)
    return residual_test(
        f"{axis} {UNITS[channel][1]}, {candidate.label}",
        left,
        f"{axis} u'",
        data.inputs[-len(left) :],
        fitted_rows,
    )


def _named(beside: Sequence[ArxCandidate], tests: Sequence[ResidualTest]) -> dict[str, Any]:
    """Residuals of the structures that were named beside the chosen one, by label."""
    others = zip(beside[1:], tests[1:], strict=True)
    return {"beside": {one.label: test.as_dict() for one, test in others}} if beside[1:] else {}


def _steps(axis: str, search: ArxSearch, beside: Sequence[ArxCandidate]) -> list[Step]:
    """Step responses of the structures that are shown, of the best by validation where only one
    is."""
    best = [one for one in search.candidates[:STEPS_DRAWN] if one is not search.chosen]
    return [
        Step(
            axis,
            one.label,
            *step_response(one.axis),
            plausible=one.plausible,
            chosen=one is search.chosen,
        )
        for one in (beside if beside[1:] else (search.chosen, *best))
    ]


def _label(axis: ArxAxis) -> str:
    return f"ARX({axis.na},{axis.nb},{axis.nk})"
