"""Figures 7.34 to 7.56, Tables 7.3 to 7.5: ARX models on angles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from groundstation.dynamics.model import ArxAxis, arx_ahead, model_vehicle, rotor_motors
from groundstation.identification.arx.workflow import (
    WINDOW_S,
    ArxCandidate,
    ArxData,
    ArxSearch,
    arx_data,
    free_run_rms,
    residuals,
    search_arx,
    step_response,
)
from groundstation.identification.estimate import cross_correlation_test
from groundstation.identification.fit_record import liveliest
from groundstation.report.page import Cell
from groundstation.thesis.drawing import both_steps, correlation, overlay
from groundstation.thesis.entry import Entry, Made, Table
from groundstation.thesis.flight import airborne
from groundstation.thesis.printed import (
    CROSS,
    ROLL_ARX,
    ROLL_ON_PITCH,
    ROLL_STEPS,
    YAW_ARX,
    Order,
)
from groundstation.thesis.workshop import Workshop

CHOSEN: Order = (2, 1, 8)
DRAWN_S = 6.0
MODEL = "arx.json"


@dataclass(frozen=True, slots=True)
class AxisSearch:
    """All structures of an axis, and the data that they were fitted and judged on."""

    search: ArxSearch
    fit: list[ArxData]
    held: list[ArxData]

    def of(self, order: Order) -> ArxCandidate:
        """One structure."""
        return next(one for one in self.search.candidates if one.order == order)


def _searched(workshop: Workshop, axis: str) -> AxisSearch:
    def make() -> AxisSearch:
        model = workshop.model("body.json")
        configuration = model_vehicle(model).configuration
        fit, held = (
            [
                arx_data(one.run[one.rows], axis, rotor_motors(model), configuration)
                for one in airborne(workshop, name)
            ]
            for name in ("flight.csv", "held.csv")
        )
        return AxisSearch(search_arx(fit, held), fit, held)

    workshop.use(MODEL)
    return workshop.once(("searched", axis), make)


def label(order: Order) -> str:
    """The structure as the thesis writes it."""
    return f"ARX({','.join(map(str, order))})"


def _fit(axis: str, order: Order) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        found = _searched(workshop, axis)
        one = found.of(order)
        printed = (ROLL_ARX if axis == "roll" else YAW_ARX).get(order)
        beside = f" (printed {printed[1]:.4f})" if printed else " (not in the printed table)"
        return _run_freely(
            one.axis,
            max(found.held, key=lambda data: len(data.outputs)),
            axis,
            f"{label(order)}, free runs of {WINDOW_S:g} s on the held-out flight: RMS"
            f" {one.rms_validation:.4f} rad{beside}; step response"
            f" {'plausible' if one.plausible else 'not plausible'}.",
        )

    return make


def _run_freely(model: ArxAxis, data: ArxData, axis: str, words: str) -> Made:
    every = max(1, round(WINDOW_S / data.period_s))
    starts = np.arange(0, len(data.outputs) - every, every)
    flown = arx_ahead(model, data.inputs, data.outputs, starts, every - 1, 1).ravel()
    measured = data.outputs[: len(flown)]
    rows = liveliest(measured, data.period_s, DRAWN_S)
    time = np.asarray(data.period_s * np.arange(len(measured)), np.float64)
    reach = 3.0 * float(np.abs(measured[rows]).max())
    shown = np.clip(flown[rows], -reach, reach)
    return Made(
        words,
        figures=[
            overlay(
                time[rows],
                np.degrees(measured[rows]),
                np.degrees(shown),
                f"{axis}, deg",
                "free run",
            )
        ],
    )


def _table(axis: str, printed: dict[Order, tuple[float, float]]) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        found = _searched(workshop, axis)
        rows: list[list[Cell]] = []
        for order, (one_printed, other_printed) in printed.items():
            one = found.of(order)
            plausible = "plausible" if one.plausible else "not plausible"
            ours = one.rms_fit, one.rms_validation
            rows.append([label(order), one_printed, other_printed, *ours, plausible])
        best = found.search.candidates[0]
        chosen = found.search.chosen
        if best.order not in printed:
            ours = best.rms_fit, best.rms_validation
            rows.append(
                [
                    f"{best.label}, best here",
                    None,
                    None,
                    *ours,
                    "plausible" if best.plausible else "not plausible",
                ]
            )
        return Made(
            "The thesis's procedure: 88 structures on angles, least squares, ranked by free run,"
            f" here over {WINDOW_S:g} s at a time; RMS in rad. Chosen here: {chosen.label}. The"
            " reported angle is fresh in every second row only, and least squares spends its"
            " coefficients on the repetition (docs/identification.md, ARX models).",
            [
                Table(
                    [
                        "structure",
                        "printed identification",
                        "printed validation",
                        "identification",
                        "validation",
                        "step response",
                    ],
                    rows,
                    f"The whole list: fit.arx.axes.{axis}.table in {MODEL}.",
                )
            ],
        )

    return make


def _steps(axis: str, order: Order) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        one = _searched(workshop, axis).of(order)
        time, output = step_response(one.axis)
        printed = ROLL_STEPS[order] if axis == "roll" else "same sign, no oscillations"
        poles = ", ".join(f"{abs(p):.3f}" for p in np.sort_complex(np.roots([1.0, *one.axis.a])))
        return Made(
            f"Printed: {printed}. Here: {'plausible' if one.plausible else 'not plausible'};"
            f" after 0.5 s {output[-1]:.2e} rad per (rev/s)^2; magnitudes of the poles {poles}.",
            figures=[both_steps(time, output, f"{axis}, rad")],
        )

    return make


def _cross(axis: str, order: Order) -> Callable[[Workshop], Made]:
    def make(workshop: Workshop) -> Made:
        found = _searched(workshop, axis)
        one = found.of(order)
        data = found.held[0]
        left = residuals(one.axis, data)
        rows = sum(len(part.outputs) for part in found.fit)
        test = cross_correlation_test(left, data.inputs[-len(left) :], fitted_rows=rows)
        printed = CROSS[order] if axis == "roll" else "passes"
        return Made(
            f"Printed: {printed}. Here on held-out data: {test.outside} of {len(test.lags)} lags"
            f" outside the 99 % band, the test {'passes' if test.passes else 'fails'} (it allows"
            " for slow inputs, whose neighbouring lags leave the band together).",
            figures=[correlation(test, "correlation")],
        )

    return make


def _roll_on_pitch(workshop: Workshop) -> Made:
    model = _searched(workshop, "roll").of(CHOSEN)
    held = _searched(workshop, "pitch").held
    error = free_run_rms(model.axis, held)
    longest = max(held, key=lambda data: len(data.outputs))
    return _run_freely(
        model.axis,
        longest,
        "pitch",
        f"{label(CHOSEN)} of roll on pitch: RMS {error:.4f} rad (printed {ROLL_ON_PITCH}).",
    )


def _performance(workshop: Workshop) -> Made:
    roll, pitch = _searched(workshop, "roll"), _searched(workshop, "pitch")
    rows: list[list[Cell]] = []
    for words, one in (
        (label(CHOSEN), roll.of(CHOSEN)),
        (f"{roll.search.chosen.label}, chosen here", roll.search.chosen),
    ):
        printed = ROLL_ARX[CHOSEN] if one.order == CHOSEN else (None, None)
        on_pitch = ROLL_ON_PITCH if one.order == CHOSEN else None
        rows.append([f"roll, {words}", *printed, one.rms_fit, one.rms_validation])
        rows.append(
            [f"pitch by it, {words}", None, on_pitch, None, free_run_rms(one.axis, pitch.held)]
        )
    return Made(
        "Roll's model serves pitch as well as roll, as the thesis found.",
        [
            Table(
                [
                    "data axis",
                    "printed identification",
                    "printed validation",
                    "identification",
                    "validation",
                ],
                rows,
            )
        ],
    )


COMPARED = {
    "by_body.json": "grey box",
    "by_arx.json": "ARX, angles",
    "by_rates.json": "ARX, rates, one row of 4",
}


def _decision(workshop: Workshop) -> Made:
    said = {words: workshop.said(name)["gap"] for name, words in COMPARED.items()}
    first, *_ = said.values()
    rows: list[list[Cell]] = [
        [channel, *(one["channels"][channel]["before"] for one in said.values())]
        for channel in first["channels"]
    ]
    rows.append(["all", *(one["validation"]["before"] for one in said.values())])
    chosen = ", ".join(f"{axis} {one}" for axis, one in _chosen(workshop, "arx.json").items())
    rates = ", ".join(f"{axis} {one}" for axis, one in _chosen(workshop, "rates.json").items())
    return Made(
        "Printed: ARX is better than the grey box on all axes, for its delay. Here, errors 20 and"
        " 50 ms ahead on the held-out flight over what noise leaves (1: nothing left). The grey box"
        " is the fitted body with its delay and rotor torques; the polynomials turn the craft, its"
        f" thrust is the body's. Angles: the best of the thesis's four structures, {chosen};"
        f" rates: {rates}. On the rates a body that has its delay leaves least; on the reported"
        " angles, which the on-board filter makes and holds for two rows, polynomials are better,"
        " as the thesis found, and those of rates more so than those of angles.",
        [Table(["error over noise", *said], rows)],
    )


def _chosen(workshop: Workshop, name: str) -> dict[str, str]:
    axes = workshop.model(name).fit["arx"]["axes"]
    return {axis: one["chosen"] for axis, one in axes.items()}


FITS: tuple[tuple[str, Order], ...] = (
    ("7.34", (2, 1, 0)),
    ("7.35", (2, 1, 4)),
    ("7.36", (2, 1, 8)),
    ("7.37", (2, 1, 10)),
    ("7.38", (3, 1, 0)),
    ("7.39", (3, 1, 4)),
    ("7.40", (4, 2, 0)),
    ("7.41", (2, 2, 0)),
    ("7.42", (2, 2, 4)),
    ("7.43", (3, 2, 0)),
    ("7.44", (3, 2, 4)),
)
TESTED: tuple[Order, ...] = ((2, 2, 0), (2, 1, 8), (3, 1, 4), (4, 2, 0))
ENTRIES = (
    *(Entry(f"Figure {n}", f"{label(o)} roll model", _fit("roll", o)) for n, o in FITS),
    Entry(
        "Table 7.3",
        "Top results of the iterative ARX identification (roll)",
        _table("roll", ROLL_ARX),
    ),
    *(
        Entry(f"Figure 7.{45 + i}", f"{label(o)} roll model step responses", _steps("roll", o))
        for i, o in enumerate(TESTED)
    ),
    *(
        Entry(f"Figure 7.{49 + i}", f"{label(o)} roll model cross-correlation", _cross("roll", o))
        for i, o in enumerate(TESTED)
    ),
    Entry("Figure 7.53", "Roll model with pitch axis data", _roll_on_pitch),
    Entry("Table 7.4", "Performance of the selected ARX model (roll and pitch)", _performance),
    Entry("Table 7.5", "Top results of ARX identification (yaw)", _table("yaw", YAW_ARX)),
    Entry("Figure 7.54", f"{label(CHOSEN)} yaw model", _fit("yaw", CHOSEN)),
    Entry("Figure 7.55", f"{label(CHOSEN)} yaw model step responses", _steps("yaw", CHOSEN)),
    Entry("Figure 7.56", f"{label(CHOSEN)} yaw model cross-correlation", _cross("yaw", CHOSEN)),
    Entry("Section 7.3.8", "Model decision", _decision),
)
