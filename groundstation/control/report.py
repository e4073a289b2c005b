"""Figures and pages of evaluations and designs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from groundstation.control.design import OVERSHOOT, SENSITIVITY, SETTLING, Design, Limits
from groundstation.control.evaluate import AxisResult
from groundstation.control.loop_figures import add_loop_figures
from groundstation.control.metrics import StepMetrics
from groundstation.control.step_analysis import Flown, FlownAxis
from groundstation.report.page import BAD, HEAT, IMPROVED, MEASURED, MODELLED, NEUTRAL, Page, figure
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    margins = one.margins
    settling = one.metrics.settling_s
    if not one.stable:
        return [one.axis, "unstable", "", "", "", "", "", ""]
    return [
        one.axis,
        f"{one.metrics.rms / one.step:.3f}",
        f"{one.metrics.overshoot_pct:.1f}",
        "not settled" if settling is None else f"{settling:.3f}",
        f"{one.metrics.steady_state_error / one.step:.3f}",
        "" if margins is None else f"{margins.max_sensitivity:.2f}",
        "" if margins is None else f"{margins.gain_up:.1f}",
        "" if margins is None else f"{1e3 * margins.delay_s:.1f}",
    ]


def step_figure(results: Sequence[AxisResult], others: Sequence[AxisResult] = ()) -> Figure:
    """One panel an axis; ``others`` in grey behind, the stock gains say."""
    made, panels = figure(rows=1, columns=len(results), height=3.0, sharey=True)
    for panel, one in zip(panels, results, strict=True):
        time = np.arange(len(one.response)) * SAMPLE_PERIOD_S
        panel.axhspan(0.95, 1.05, color=NEUTRAL, alpha=0.2, linewidth=0)
        for other in others:
            if other.axis == one.axis:
                panel.plot(time[: len(other.response)], other.response, color=NEUTRAL)
        panel.plot(time, one.response, color=IMPROVED if one.stable else BAD)
        panel.set_title(one.axis)
        panel.set_xlabel("s")
    shown = [float(one.response.max()) for one in (*results, *others) if one.stable]
    panels[0].set_ylim(-0.2, max(1.4, 1.05 * max(shown, default=2.0)))
    panels[0].set_ylabel("response / step")
    return made


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
    """The table for a terminal."""
    return [
        *table_lines(FLIGHT_HEAD, flight_rows(flown)),
        _effect(flown),
    ]


def _effect(flown: Flown) -> str:
    if not flown.found:
        return (
            f"no setpoint is seen in the motors (0 of {flown.edges} edges): when they took effect"
            " is not known, the moment of sending is taken for it"
        )
    return (
        f"setpoints took effect {_delay(flown)} (middle half within {1e3 * flown.spread_s:.1f} ms),"
        f" seen in the motors at {flown.found} of {flown.edges} edges"
    )


def _delay(flown: Flown) -> str:
    """Host and device are tied by the promptest packets, so a small delay may come out below 0."""
    if flown.delay_s <= 0.0:
        return "at once, as far as the two clocks tell"
    return f"{1e3 * flown.delay_s:.1f} ms after they were sent"


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
    page.figure(flight_figure(flown), STEPS_TEXT)
    page.text(flight_lines(flown)[-1] + ".")
    return page


STEPS_TEXT = "Averages over all steps of the flight, in the device's time."


def flight_figure(flown: Flown) -> Figure:
    """One panel an axis: the mean step, measured and predicted."""
    made, panels = figure(rows=1, columns=len(flown.axes), height=3.0, sharey=True)
    for panel, one in zip(panels, flown.axes, strict=True):
        time = np.arange(len(one.response)) * SAMPLE_PERIOD_S
        panel.axhspan(0.95, 1.05, color=NEUTRAL, alpha=0.2, linewidth=0)
        panel.plot(time, one.response, color=MEASURED, label=f"measured, {one.edges} steps")
        if one.predicted_response is not None:
            # dashed: the better the prediction, the less of what was measured would be seen
            panel.plot(time, one.predicted_response, "--", color=IMPROVED, label="predicted")
        panel.set_title(one.axis)
        panel.set_xlabel("s")
        panel.legend(loc="lower right")
    panels[0].set_ylabel("response / step")
    return made


def front_figure(
    axis: str,
    design: Design,
    nominal: Any = None,
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
    at = 1e3 * design.judgement[SETTLING], design.judgement[OVERSHOOT]
    panel.plot(*at, "D", color=MODELLED, label="chosen")
    if nominal is not None:
        at = 1e3 * nominal[SETTLING], nominal[OVERSHOOT]
        panel.plot(
            *at, "D", color=MODELLED, fillstyle="none", label="chosen, on the fitted model itself"
        )
    for name, overshoot, settling in printed:
        panel.plot(1e3 * settling, overshoot, "x", color=BAD)
        panel.annotate(f"printed {name}", (1e3 * settling, overshoot), fontsize=8)
    panel.set_xlabel("settling, ms")
    panel.set_ylabel("overshoot, %")
    panel.set_title(axis)
    panel.legend(loc="best", frameon=True)
    return made
