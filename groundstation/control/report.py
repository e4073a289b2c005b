"""Reports on gains: evaluated, flown and designed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from groundstation.control.design import (
    COMPLIANCE,
    CRITERION,
    DESIGN_BAND,
    OFFSET,
    OVERSHOOT,
    RMS,
    SENSITIVITY,
    SETTLING,
    WINDOW_S,
    AxisDesign,
    Design,
    Limits,
    Robustness,
    comparable,
    estimates_of,
    gain_meaning,
    reasons,
)
from groundstation.control.firmwares import PidGains, Release, gain_unit
from groundstation.control.linear_loop import (
    GAINS,
    RESULTS,
    AxisResult,
    DirectJudge,
    direct_loop,
    evaluate,
)
from groundstation.control.metrics import LoopResponse, Margins, StepMetrics
from groundstation.control.step_analysis import Flown, FlownAxis
from groundstation.dynamics.meanings import WORDS, Use, suitability
from groundstation.dynamics.model import ArxAxis, Model
from groundstation.report.page import (
    BAD,
    HEAT,
    IMPROVED,
    MEASURED,
    MODELLED,
    NEUTRAL,
    SERIES,
    Page,
    figure,
)
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Bode, Nyquist and sensitivity of loops; what they show is computed by python-control.


Loops = Mapping[str, LoopResponse]
NEAR = 2.5
"""The Nyquist locus is drawn this far around -1."""
LEAST_DB, MOST_DB = -60.0, 60.0
WIDTHS = (3.0, 1.3, 1.3)
"""Pitch often lies on roll: both are to be seen."""


def add_loop_figures(page: Page, loops: Loops, broken_at: str, most: float | None = None) -> None:
    """Three figures for loops by axis. most: the maximum sensitivity that a design allows."""
    page.heading("Frequency responses")
    page.figure(bode_figure(loops), f"Bode: the loop broken at {broken_at}. Dots: |L| = 1.")
    page.figure(
        nyquist_figure(loops, most),
        "Nyquist, positive frequencies: the locus keeps from -1 by 1 over the maximum sensitivity"
        " (dot)." + ("" if most is None else f" Inside the circle it would be more than {most:g}."),
    )
    page.figure(
        sensitivity_figure(loops, most),
        "Sensitivity |1/(1+L)|: below 1 pushes are held down, above 1 they are amplified (dot: the"
        " maximum). Dashed, |L/(1+L)|: what of the reference, and of noise, comes through.",
    )


def bode_figure(loops: Loops) -> Figure:
    """Gain and phase of every axis, over each other."""
    made, (gain, phase) = figure(rows=2, height=4.8, sharex=True)
    for color, width, (axis, one) in zip(SERIES, WIDTHS, loops.items(), strict=False):
        size = np.abs(one.loop)
        angle = np.degrees(np.unwrap(np.angle(one.loop)))
        angle -= 360.0 * np.round((angle[0] + 180.0) / 360.0)  # begins nearest to -180
        gain.semilogx(one.omega, 20 * np.log10(size), color=color, linewidth=width, label=axis)
        phase.semilogx(one.omega, angle, color=color, linewidth=width)
        at = one.omega[np.flatnonzero(np.diff(np.sign(size - 1.0)))]
        gain.plot(at, np.zeros(len(at)), "o", color=color, markersize=5)
        phase.plot(at, np.interp(at, one.omega, angle), "o", color=color, markersize=5)
    gain.axhline(0.0, color=NEUTRAL, linewidth=0.8)
    phase.axhline(-180.0, color=NEUTRAL, linewidth=0.8)
    gain.set_ylim(LEAST_DB, MOST_DB)
    phase.set_ylim(-540.0, 90.0)
    phase.set_yticks(np.arange(-540.0, 91.0, 90.0))
    gain.set_ylabel("gain, dB")
    phase.set_ylabel("phase, deg")
    phase.set_xlabel("rad/s")
    gain.legend(loc="upper right")
    return made


def nyquist_figure(loops: Loops, most: float | None = None) -> Figure:
    """One panel an axis around -1, with the unit circle and the one that a design keeps out of."""
    made, panels = figure(rows=1, columns=len(loops), height=3.4, sharey=True)
    turn = np.exp(1j * np.linspace(0.0, 2 * np.pi, 200))
    for color, panel, (axis, one) in zip(SERIES, panels, loops.items(), strict=False):
        panel.plot(turn.real, turn.imag, color=NEUTRAL, linewidth=0.8)
        if most is not None:
            panel.fill((turn / most - 1).real, (turn / most).imag, color=BAD, alpha=0.12)
        near = np.abs(one.loop + 1.0) < 4 * NEAR
        shown = np.where(near, one.loop, np.nan)
        panel.plot(shown.real, shown.imag, color=color)
        panel.plot([-1.0], [0.0], "+", color=BAD, markersize=10)
        nearest = one.loop[np.argmin(np.abs(one.loop + 1.0))]
        panel.plot([nearest.real], [nearest.imag], "o", color=color, markersize=5)
        panel.set_xlim(-1.0 - NEAR, -1.0 + NEAR)
        panel.set_ylim(-NEAR, NEAR)
        panel.set_aspect("equal")
        panel.set_title(axis)
        panel.set_xlabel("real part of L")
    panels[0].set_ylabel("imaginary part of L")
    return made


def sensitivity_figure(loops: Loops, most: float | None = None) -> Figure:
    """What a push and a reference become in the closed loop, of every axis."""
    made, (panel,) = figure(height=3.2)
    for color, width, (axis, one) in zip(SERIES, WIDTHS, loops.items(), strict=False):
        left, through = one.sensitivities
        panel.loglog(one.omega, left, color=color, linewidth=width, label=axis)
        panel.loglog(one.omega, through, color=color, linestyle="--", linewidth=0.9)
        top = int(np.argmax(left))
        panel.plot([one.omega[top]], [left[top]], "o", color=color, markersize=5)
    panel.axhline(1.0, color=NEUTRAL, linewidth=0.8)
    if most is not None:
        panel.axhline(most, color=BAD, linewidth=0.8, linestyle=":", label="the most allowed")
    panel.set_ylim(0.01, 30.0)
    panel.set_xlabel("rad/s")
    panel.set_ylabel("closed loop")
    panel.legend(loc="lower right")
    return made


# Figures and pages of evaluations and designs.


METRICS_HEAD = (
    "axis",
    "RMS error",
    "overshoot %",
    "settling s (5 %)",
    "steady-state error",
    "max sensitivity",
    "gain may grow by",
    "delay margin ms",
)
DEFINITIONS = (
    "RMS of reference minus response over the window; overshoot beyond the reference in percent"
    " of the step; settling: after it the response stays within 5 % of the step of its settled"
    " value, the mean over the last tenth of the window; steady-state error: reference minus that"
    " value."
)


def evaluation_page(results: Sequence[AxisResult], title: str, loop: str) -> Page:
    """Step responses, the table, and what the words mean."""
    page = Page(title, LOOP_NAMES[loop])
    page.verdict(*_verdict(results))
    page.table(METRICS_HEAD, [metrics_row(one) for one in results], DEFINITIONS)
    page.heading("Step responses")
    page.figure(step_figure(results), "Response over the step; the band is +-5 % of the step.")
    add_loop_figures(page, {one.axis: one.loop for one in results}, BROKEN_AT[loop])
    return page


def _verdict(results: Sequence[AxisResult]) -> tuple[str, str]:
    """In words, and of which kind: a loop that is hardly stable is not good."""
    lost = [one.axis for one in results if not one.stable]
    if lost:
        return f"Unstable: {', '.join(lost)}.", "bad"
    limit = Limits().sensitivity
    near = [
        f"{one.axis} (maximum sensitivity {one.margins.max_sensitivity:.1f}, unstable with"
        f" {1e3 * one.margins.delay_s:.1f} ms more delay)"
        for one in results
        if one.margins is not None and one.margins.max_sensitivity > limit
    ]
    if near:
        return f"Stable, with less margin than a design may leave: {'; '.join(near)}.", "neutral"
    kept = ", ".join(one.axis for one in results)
    return f"Stable within a maximum sensitivity of {limit:g}: {kept}.", "good"


BROKEN_AT = {
    "direct": "the controller's output, u'",
    "whole": "the controller's output, PWM counts",
    "firmware": "the motors' input",
}


LOOP_NAMES = {
    "direct": "direct loop: the controller's output is u' in (rev/s)^2",
    "whole": "whole simulation (Figure 8.10): PWM, battery, motors, mixer, body, delay",
    "firmware": "the firmware's cascaded loops of angles and rates",
}


def metrics_row(one: AxisResult) -> list[Any]:
    """A row under ``METRICS_HEAD``."""
    margins, settling = one.margins, one.metrics.settling_s
    if margins is None:
        return [one.axis, "unstable", "", "", "", "", "", ""]
    return [
        one.axis,
        f"{one.metrics.rms / one.step:.3f}",
        f"{one.metrics.overshoot_pct:.1f}",
        "not settled" if settling is None else f"{settling:.3f}",
        f"{one.metrics.steady_state_error / one.step:.3f}",
        f"{margins.max_sensitivity:.2f}",
        f"{margins.gain_up:.1f}",
        f"{1e3 * margins.delay_s:.1f}",
    ]


def step_figure(results: Sequence[AxisResult], others: Sequence[AxisResult] = ()) -> Figure:
    """One panel an axis; ``others`` in grey behind, the stock gains say."""
    made, panels = _step_panels([one.axis for one in results])
    for panel, one in zip(panels, results, strict=True):
        for other in others:
            if other.axis == one.axis:
                panel.plot(_seconds(other.response), other.response, color=NEUTRAL)
        panel.plot(_seconds(one.response), one.response, color=IMPROVED if one.stable else BAD)
    shown = [float(one.response.max()) for one in (*results, *others) if one.stable]
    panels[0].set_ylim(-0.2, max(1.4, 1.05 * max(shown, default=2.0)))
    return made


def _step_panels(axes: Sequence[str]) -> tuple[Figure, list[Axes]]:
    """A panel an axis for responses over the step, with the band in which they have settled."""
    made, panels = figure(rows=1, columns=len(axes), height=3.0, sharey=True)
    for panel, axis in zip(panels, axes, strict=True):
        panel.axhspan(0.95, 1.05, color=NEUTRAL, alpha=0.2, linewidth=0)
        panel.set_title(axis)
        panel.set_xlabel("s")
    panels[0].set_ylabel("response / step")
    return made, panels


def _seconds(response: Array) -> Array:
    return np.asarray(np.arange(len(response)) * SAMPLE_PERIOD_S, np.float64)


FLIGHT_HEAD = (
    "axis",
    "steps",
    "RMS measured",
    "predicted",
    "overshoot % measured",
    "predicted",
    "settling s measured",
    "predicted",
    "agree",
)


def flight_rows(flown: Flown) -> list[list[Any]]:
    """Rows under ``FLIGHT_HEAD``."""

    def cells(one: FlownAxis, metrics: StepMetrics | None) -> tuple[str, str, str]:
        if metrics is None:
            return "", "", ""
        settling = metrics.settling_s
        return (
            f"{metrics.rms / one.step:.3f}",
            f"{metrics.overshoot_pct:.1f}",
            "not settled" if settling is None else f"{settling:.3f}",
        )

    rows: list[list[Any]] = []
    for one in flown.axes:
        measured, predicted = cells(one, one.measured), cells(one, one.predicted)
        agree = "" if one.predicted is None else "; ".join(one.apart) or "yes"
        pairs = [cell for pair in zip(measured, predicted, strict=True) for cell in pair]
        rows.append([one.axis, one.edges, *pairs, agree])
    return rows


def flight_lines(flown: Flown) -> list[str]:
    """The table for a terminal, and when setpoints took effect."""
    delay = f"{1e3 * flown.delay_s:.1f} ms after they were sent"
    if flown.delay_s <= 0.0:
        # the promptest packets tie host and device, so a small delay may come out below 0
        delay = "at once, as far as the two clocks tell"
    effect = (
        f"setpoints took effect {delay} (middle half within {1e3 * flown.spread_s:.1f} ms),"
        f" seen in the motors at {flown.found} of {flown.edges} edges"
    )
    if not flown.found:
        effect = (
            f"no setpoint is seen in the motors (0 of {flown.edges} edges): when they took effect"
            " is not known, the moment of sending is taken for it"
        )
    return [*table_lines(FLIGHT_HEAD, flight_rows(flown)), effect]


def table_lines(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[str]:
    """A table in columns of text."""
    table = [list(head), *([str(cell) for cell in row] for row in rows)]
    widths = [max(len(row[i]) for row in table) for i in range(len(head))]
    return [
        "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip()
        for row in table
    ]


def flight_page(flown: Flown, name: str, model: str | None) -> Page:
    """A flown programme: measured beside predicted."""
    page = Page(f"Flight {name}", f"predicted by {model}" if model else "no model given")
    if model:
        apart = [f"{one.axis}: {', '.join(one.apart)}" for one in flown.axes if one.apart]
        page.verdict(
            "Measured and predicted disagree. " + "; ".join(apart)
            if apart
            else "Measured and predicted agree within 15 %, 3 points or 20 ms.",
            "bad" if apart else "good",
        )
    page.table(FLIGHT_HEAD, flight_rows(flown), DEFINITIONS)
    page.figure(
        flight_figure(flown), "Averages over all steps of the flight, in the device's time."
    )
    page.text(flight_lines(flown)[-1] + ".")
    return page


def flight_figure(flown: Flown) -> Figure:
    """One panel an axis: the mean step, measured and predicted."""
    made, panels = _step_panels([one.axis for one in flown.axes])
    for panel, one in zip(panels, flown.axes, strict=True):
        time = _seconds(one.response)
        panel.plot(time, one.response, color=MEASURED, label=f"measured, {one.edges} steps")
        if one.predicted_response is not None:
            # dashed: the better the prediction, the less of what was measured would be seen
            panel.plot(time, one.predicted_response, "--", color=IMPROVED, label="predicted")
        panel.legend(loc="lower right")
    return made


def front_figure(
    axis: str,
    design: Design,
    nominal: Array | None = None,
    printed: Sequence[tuple[str, float, float]] = (),
) -> Figure:
    """Overshoot against settling, coloured by maximum sensitivity, with what was chosen.

    nominal: its judgement on the model alone, where the front is one of the model's corners.
    printed: (name, overshoot, settling) of results to be shown beside.
    """
    made, (panel,) = figure(height=3.6, width=7.5)
    front = design.front
    shown = panel.scatter(
        1e3 * front[:, SETTLING],
        front[:, OVERSHOOT],
        c=front[:, SENSITIVITY],
        cmap=HEAT,
        s=9,
        vmin=1,
        vmax=3,
        edgecolors=NEUTRAL,
        linewidths=0.3,
    )
    made.colorbar(shown, ax=panel, label="maximum sensitivity")
    for judged, fill, name in (
        (design.judgement, "full", "chosen"),
        (nominal, "none", "chosen, on the fitted model itself"),
    ):
        if judged is not None:
            at = 1e3 * judged[SETTLING], judged[OVERSHOOT]
            panel.plot(*at, "D", color=MODELLED, fillstyle=fill, label=name)
    for name, overshoot, settling in printed:
        panel.plot(1e3 * settling, overshoot, "x", color=BAD)
        panel.annotate(f"printed {name}", (1e3 * settling, overshoot), fontsize=8)
    panel.set_xlabel("settling, ms")
    panel.set_ylabel("overshoot, %")
    panel.set_title(axis)
    panel.legend(loc="best", frameon=True)
    return made


# What a design reports: numbers for programs, a page for people.


Found = Mapping[str, tuple[PidGains, Design, Margins, ArxAxis]]
FRONT_ROWS = 200
"""Points of the front that a report carries."""
PURPOSES = {
    "kp": "holds the unstable pole and sets how fast the angle follows",
    "ki": "removes the steady-state error",
    "kd": "damps; the delay limits it",
}
GAINS_HEAD = ("gain", "value", "unit", "meaning")


ASSUMED_CURVE = (
    "the thrust curve of the craft's own propellers is assumed, and releases differ from it by -18"
    " to +25 %: fit the body on flights that today's daemon recorded, and it is the craft's own"
)
"""Slopes at hover of the releases of 2023.11 to 2026.08 on a 2.1, a 2.1+ and a Brushless, over that
of the design."""


def firmware_report(
    model: Model,
    release: Release,
    designs: Sequence[AxisDesign],
    tried: Robustness | None,
    limits: Limits,
) -> dict[str, Any]:
    """``pid design --json`` for the firmware's loops."""
    notes = [CRITERION, limits_line(limits)]
    if release == "2.x" and model.firmware_curve is None:
        notes.insert(0, ASSUMED_CURVE)
    axes, known = {}, suitability(model)
    for one in designs:
        stock, gains, reasons = one.stock_margins, one.gains, list(one.reasons)
        entry = axis_entry(one.nominal, one.margins, one.design, gains, reasons)
        entry["notes"] = [
            f"stock gains: maximum sensitivity {stock.max_sensitivity:.1f},"
            f" delay margin {1e3 * stock.delay_s:.1f} ms; {_beside_stock(one, limits)}"
        ]
        bears = known.get(one.axis)
        if bears is not None and bears.use != Use.DESIGN:
            entry["notes"].insert(0, f"the model is {WORDS[bears.use]}: {bears.reasons[0]}")
        if tried is not None:
            table = tried.judgements[one.axis]
            entry["draws"] = {
                "drawn": tried.drawn,
                "stable": tried.stable[one.axis],
                "sensitivity_95": _of_95_percent(table[:, SENSITIVITY]),
                "settling_s_95": _of_95_percent(table[:, SETTLING]),
                "overshoot_pct_95": _of_95_percent(table[:, OVERSHOOT]),
            }
            settling = entry["draws"]["settling_s_95"]
            settle = "more than 5 % of them do not settle"
            if settling is not None:
                settle = f"95 % of them settle within {settling:.3f} s"
            entry["notes"].append(
                f"{tried.stable[one.axis]} of {tried.drawn} models drawn from the fit's covariance"
                f" are stable; {settle}"
            )
        axes[one.axis] = entry
    if not estimates_of(model):
        notes.append("the model carries no covariance: what its uncertainty does is not known")
    return {
        "form": "firmware",
        "firmware": release,
        "vehicle": model.vehicle,
        "max_sensitivity": limits.sensitivity,
        "axes": axes,
        "notes": notes,
    }


def _beside_stock(one: AxisDesign, limits: Limits) -> str:
    """In what gains are no worse than the stock ones, by what judged both."""
    if one.is_stock:
        return "they stay: nothing that was found is better on the model itself"
    if not comparable(one.before, limits):
        return "too little damped to set limits: a push that lasts may move the craft further"
    said = "at their worst by what the fit is unsure of they follow and settle no worse, and a push"
    said += " that lasts moves the craft no further"
    if one.design.judgement[SENSITIVITY] > limits.sensitivity:
        said += (
            f"; no gains within a maximum sensitivity of {limits.sensitivity:g} do that: at worst"
            f" they reach {one.design.judgement[SENSITIVITY]:.1f}, no more than the stock gains"
            " (--sensitivity keeps to less)"
        )
    return said


def _of_95_percent(values: Array) -> float | None:
    """What 95 % of the values do not exceed; None where that is no finite number."""
    ordered = np.sort(np.where(np.isfinite(values), values, np.inf))
    bound = float(ordered[math.ceil(0.95 * len(values)) - 1])
    return bound if math.isfinite(bound) else None


def thesis_report(found: Found, limits: Limits, printed: bool) -> dict[str, Any]:
    """``pid design --json`` for PIDs on u'. printed: the model is the thesis's, so that its figures
    may stand beside."""
    axes = {}
    for axis, (gains, design, margins, plant) in found.items():
        values = msgspec.structs.asdict(gains)
        why = list(reasons(DirectJudge(plant, 2.0), values, PURPOSES, limits))
        entry = axis_entry(design.judgement, margins, design, values, why)
        entry["delay_samples"] = plant.nk
        entry["notes"] = [
            f"at maximum sensitivity {limits.sensitivity:g} no PID on this model overshoots less"
            f" than {design.calmest:.0f} % or settles faster than {design.fastest:.3f} s"
        ]
        beyond = [
            f"{name} ({overshoot:.0f} %, {settling:g} s)"
            for name, overshoot, settling in (_printed(axis) if printed else ())
            if overshoot < design.calmest or settling < design.fastest
        ]
        if beyond:
            entry["notes"].append("beyond that bound as printed: " + ", ".join(beyond))
        axes[axis] = entry
    return {
        "form": "thesis",
        "printed": printed,
        "max_sensitivity": limits.sensitivity,
        "axes": axes,
        "notes": [CRITERION, limits_line(limits)],
    }


def firmware_page(
    model: Model,
    name: str,
    designs: Sequence[AxisDesign],
    tried: Robustness | None,
    report: dict[str, Any],
) -> Page:
    """The design for people: answers and margins, stock beside; fronts; draws; reasons."""
    page = Page(f"Gains for {name}", LOOP_NAMES["firmware"])
    gains = {key: value for one in designs for key, value in one.gains.items()}
    wanted = [one.axis for one in designs]
    ours, stock = (
        [
            one
            for one in evaluate(model, each, "firmware", WINDOW_S, release=report["firmware"])
            if one.axis in wanted
        ]
        for each in (gains, {})
    )
    page.verdict(*_gained(ours, stock))
    beside: list[list[Any]] = []
    for old, new in zip(stock, ours, strict=True):
        beside.append([old.axis, "stock", *metrics_row(old)[1:]])
        beside.append(["", "designed", *metrics_row(new)[1:]])
    page.table(
        (METRICS_HEAD[0], "gains", *METRICS_HEAD[1:]),
        beside,
        f"{DEFINITIONS} Maximum sensitivity: the most that pushes are amplified by. Delay margin:"
        " how much more delay makes the loop unstable.",
    )
    page.figure(step_figure(ours, stock), "Step responses: designed, and stock gains in grey.")
    loops = {one.axis: one.loop for one in ours}
    add_loop_figures(page, loops, BROKEN_AT["firmware"], report["max_sensitivity"])
    page.heading("Gains and reasons")
    page.table(GAINS_HEAD, [(name, value, *gain_meaning(name)) for name, value in gains.items()])
    page.bullets([line for e in report["axes"].values() for line in e["reasons"]])
    page.heading("What the fit is unsure of")
    page.bullets([f"{axis}: {line}" for axis, e in report["axes"].items() for line in e["notes"]])
    if tried is not None:
        _draws(page, tried)
    page.heading("Pareto fronts")
    for one in designs:
        page.figure(
            front_figure(one.axis, one.design, one.nominal),
            f"{one.axis}: all gains found that no others beat in overshoot, settling and"
            " maximum sensitivity at once. Points and the full diamond are judged on the worst of"
            f" the model's corners, settled within {100 * DESIGN_BAND:g} %; the open one on the"
            " fitted model itself, within 5 %.",
        )
    page.bullets(report["notes"])
    return page


def thesis_design_page(name: str, found: Found, report: dict[str, Any]) -> Page:
    """The design of PIDs on u' for people."""
    page = Page(f"PID on u' for {name}", LOOP_NAMES["direct"])
    page.table(
        ("axis", *(head for head, _, _ in DESIGN_COLUMNS)),
        [
            (
                axis,
                *(None if e[key] is None else factor * e[key] for _, key, factor in DESIGN_COLUMNS),
            )
            for axis, e in report["axes"].items()
        ],
    )
    loops = {axis: direct_loop(plant, gains) for axis, (gains, _, _, plant) in found.items()}
    add_loop_figures(page, loops, BROKEN_AT["direct"], report["max_sensitivity"])
    for axis, (_, design, _, plant) in found.items():
        page.heading(f"{axis}, {plant.nk} samples of delay")
        page.table(
            GAINS_HEAD,
            [
                (name, value, gain_unit(name, "direct"), PURPOSES[name])
                for name, value in report["axes"][axis]["gains"].items()
            ],
        )
        page.bullets([*report["axes"][axis]["reasons"], *report["axes"][axis]["notes"]])
        page.figure(
            front_figure(axis, design, printed=_printed(axis) if report["printed"] else ()),
            "Gains that no others beat in overshoot, settling and maximum sensitivity at once.",
        )
    page.bullets(report["notes"])
    return page


DESIGN_COLUMNS = (
    ("RMS of step", "rms", 1.0),
    ("overshoot %", "overshoot_pct", 1.0),
    ("settling s", "settling_s", 1.0),
    ("max sensitivity", "max_sensitivity", 1.0),
    ("gain may grow by", "gain_up", 1.0),
    ("gain may fall to", "gain_down", 1.0),
    ("delay margin ms", "delay_margin_s", 1e3),
)
"""Heading, key of ``axis_entry``, factor."""


def axis_entry(
    judgement: Array,
    margins: Margins,
    design: Design,
    gains: Mapping[str, float],
    reasons: Sequence[str],
) -> dict[str, Any]:
    """gains: in the design's order."""
    rows = np.unique(np.linspace(0, len(design.front) - 1, FRONT_ROWS).astype(int))
    return {
        "rms": float(judgement[RMS]),
        "overshoot_pct": float(judgement[OVERSHOOT]),
        "settling_s": float(judgement[SETTLING]),
        "steady_state_error": float(judgement[OFFSET]),
        **margins.as_dict(),
        "compliance": float(judgement[COMPLIANCE]),
        "fastest_settling_s": design.fastest,
        "smallest_overshoot_pct": design.calmest,
        "front": [
            {
                "overshoot_pct": float(row[OVERSHOOT]),
                "settling_s": float(row[SETTLING]),
                "max_sensitivity": float(row[SENSITIVITY]),
                "gains": dict(zip(gains, values.tolist(), strict=True)),
            }
            for row, values in zip(design.front[rows], design.front_gains[rows], strict=True)
        ],
        "gains": gains,
        "reasons": reasons,
    }


def _printed(axis: str) -> list[tuple[str, float, float]]:
    return [(name, RESULTS[name][axis][1], RESULTS[name][axis][2]) for name in GAINS]


def limits_line(limits: Limits) -> str:
    return (
        f"limits: maximum sensitivity {limits.sensitivity:g}, {1e3 * limits.delay_s:g} ms of spare"
        f" delay, steady-state error {100 * limits.offset:g} % of the step"
    )


def _gained(ours: Sequence[AxisResult], stock: Sequence[AxisResult]) -> tuple[str, str]:
    """What the design gains over the stock gains, axis by axis."""

    def settled(one: AxisResult) -> str:
        value = one.metrics.settling_s
        return "not in the window" if value is None else f"{value:.2f} s"

    changes = []
    for one, old in zip(ours, stock, strict=True):
        now, was = one.margins, old.margins
        if now is None:
            return f"{one.axis} is unstable with these gains.", "bad"
        words = [
            f"settles in {settled(one)} (stock {settled(old)})",
            f"overshoot {one.metrics.overshoot_pct:.0f} % ({old.metrics.overshoot_pct:.0f} %)",
            f"maximum sensitivity {now.max_sensitivity:.1f}"
            + (" (unstable)" if was is None else f" ({was.max_sensitivity:.1f})"),
        ]
        changes.append(f"{one.axis}: {', '.join(words)}")
    return "; ".join(changes) + ".", "good"


def _draws(page: Page, tried: Robustness) -> None:
    """What 95 % of the drawn models do."""
    rows: list[list[Any]] = []
    for axis, table in tried.judgements.items():
        good = table[np.isfinite(table[:, [SETTLING, OVERSHOOT, SENSITIVITY]]).all(axis=1)]
        cells = ["none", "", ""]
        if len(good):
            low, high = np.quantile(good, (0.025, 0.975), axis=0)
            cells = [
                f"{1e3 * low[SETTLING]:.0f} to {1e3 * high[SETTLING]:.0f}",
                f"{low[OVERSHOOT]:.1f} to {high[OVERSHOOT]:.1f}",
                f"{low[SENSITIVITY]:.2f} to {high[SENSITIVITY]:.2f}",
            ]
        rows.append([axis, tried.stable[axis], len(good), *cells])
    page.table(
        ("axis", "stable", "settle", "settling ms", "overshoot %", "max sensitivity"),
        rows,
        f"{tried.drawn} models drawn from the fit's covariance: how many are stable and settle in"
        " the window, and the range of 95 % of those.",
    )
