"""The report of an identification: what was found, how sure it is, and what is left over."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from groundstation.dynamics.meanings import arx_meaning, meaning_of
from groundstation.dynamics.model import Model
from groundstation.identification.advice import advice_of, good_for, next_of
from groundstation.identification.arx.residual_tests import CorrelationTest
from groundstation.identification.estimate import Estimates
from groundstation.identification.fit_record import Evidence, ResidualTest, Step, Trace
from groundstation.identification.segments import EVERYTHING
from groundstation.report.page import (
    BAD,
    BAND,
    GOOD,
    MEASURED,
    MODELLED,
    NEUTRAL,
    ON_BRIGHT,
    ON_DARK,
    SERIES,
    Cell,
    Page,
    figure,
    legend_above,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_PERCENT = 1e4
Meaning = Callable[[str], tuple[str, str]]
TITLES = {"motor": "Motor", "body": "Body", "arx": "ARX models"}


def report(model: Model, account: dict[str, Any], evidence: Evidence) -> Page:
    """The whole page. account: as the model file keeps it, with its recordings."""
    names = ", ".join(one["file"] for one in account["recordings"])
    chosen = "" if account["selection"] == str(EVERYTHING) else f", {account['selection']}"
    page = Page(
        f"{TITLES[account['what']]} of {model.vehicle}",
        f"{account['method']}, {account['samples']} samples of {names}{chosen}; made by"
        f" {model.created_by}",
    )
    page.verdict(*good_for(model, account))
    page.next_step(next_of(account))
    failed = [one.channel for one in evidence.residuals if not one.cross.passes]
    page.advice(advice_of(account, failed), account["warnings"])
    if account.get("findings"):
        page.heading("Rotors")
        page.bullets(account["findings"])
    for title, estimates in evidence.estimates.items():
        page.heading("Parameters" if len(evidence.estimates) == 1 else f"Parameters: {title}")
        meaning = (
            _arx_meaning(model, title, account["channel"])
            if account["what"] == "arx"
            else meaning_of
        )
        _parameters(page, estimates, account, meaning)
    page.heading("Measured and modelled")
    page.text("Rows that no fit has seen, where the channel moves most.")
    for one in evidence.traces:
        page.figure(trace(one), f"{one.channel}: {one.note}.")
    _held_out(page, account)
    if evidence.preparation is not None:
        page.heading("Before the fit")
        for drawn, words in evidence.preparation.figures():
            page.figure(drawn, words)
    if evidence.steps:
        page.heading("Step responses")
        page.figure(
            steps(evidence.steps),
            "Answer to a lasting unit torque. A free body must keep turning the way it is pushed:"
            " broken lines do not. The chosen model is drawn thick.",
        )
    if account["what"] == "arx":
        _tables(page, account)
    page.heading("Residuals")
    page.text(
        "Correlation of what the model leaves with itself and with earlier inputs; 99 of 100"
        " values lie inside the grey band where nothing is left to explain. In closed loop only"
        " inputs from before count: later ones follow from the residual, through the controller."
        " With a slow input neighbouring values leave the band together; the verdict allows for it."
    )
    for test in evidence.residuals:
        page.figure(residual(test), residual_text(test))
    _recordings(page, account)
    return page


def _recordings(page: Page, account: dict[str, Any]) -> None:
    held = account["held_out"] if isinstance(account["held_out"], list) else []
    page.heading("Recordings")
    page.table(
        ["file", "sha256", "used"],
        [
            *([one["file"], one["sha256"], "fitted"] for one in account["recordings"]),
            *([one["file"], one["sha256"], "held out"] for one in held),
        ],
        "" if held else f"Held out: the {account['held_out']} of all rows.",
    )


def _arx_meaning(model: Model, title: str, channel: str) -> Meaning:
    """Of the coefficients of the axis that a title begins with."""
    polynomial = (model.arx or {})[title.partition(" ")[0]]
    return lambda name: arx_meaning(name, polynomial, rates=channel == "gyro")


def _parameters(
    page: Page, estimates: Estimates, account: dict[str, Any], meaning_in_words: Meaning
) -> None:
    """meaning_in_words: (unit, meaning) of a name."""
    interval = estimates.interval()
    rows: list[list[Cell]] = []
    for i, name in enumerate(estimates.names):
        value, error = float(estimates.values[i]), float(estimates.stderr[i])
        unit, meaning = meaning_in_words(name)
        unknown = name in account.get("not_identified", {})
        if "." in name and abs(value) < 1.96 * error:
            meaning += "; not distinguishable from zero"
        elif unknown:
            meaning += "; not identified: the file has the profile's"
        rows.append(
            [
                name,
                value,
                error,
                unit,
                100 * error / abs(value) if value and not unknown else None,
                float(interval[i, 0]),
                float(interval[i, 1]),
                meaning,
            ]
        )
    page.table(
        [
            "parameter",
            "value",
            "standard error",
            "unit",
            "%",
            "95 % from",
            "to",
            "meaning",
        ],
        rows,
    )
    if len(estimates.names) > 1:
        page.figure(
            certainty(estimates),
            "Left: correlation of the estimates; near +1 or -1, the data tell the two only"
            " together. Right: standard error as a share of the value.",
        )


def _held_out(page: Page, account: dict[str, Any]) -> None:
    held, fitted = account.get("validation"), account.get("identification")
    if isinstance(held, dict) and isinstance(fitted, dict):
        rows = [[name.replace("_", " "), fitted.get(name), value] for name, value in held.items()]
        page.table(
            ["figure", "on the fitted rows", "held out"],
            rows,
            "Rates in rad/s, specific force in m/s^2. Fit %: 100 is perfect, 0 no better than"
            " the mean.",
        )
    elif isinstance(held, list):
        page.table(
            ["held-out run", "fit %", "RMS, rev/s"],
            [[one["recording"], one["rotor_fit_percent"], one["rotor_rms_rev_s"]] for one in held],
        )


def _tables(page: Page, account: dict[str, Any]) -> None:
    for axis, one in account["axes"].items():
        page.heading(f"Structures: {axis}")
        head = list(one["table"][0])
        rows = [
            [("yes" if cell else "no") if isinstance(cell, bool) else cell for cell in row.values()]
            for row in one["table"]
        ]
        page.table(
            [name.replace("_", " ").replace("rad s", "rad/s") for name in head],
            rows,
            f"All, the best by free run on held-out data first; chosen: {one['chosen']}.",
        )
    other = account["other_axis"]
    page.text(
        f"Roll's model on pitch data, free run: RMS {other['roll_model_on_pitch']:.4g}; pitch's on"
        f" roll data: {other['pitch_model_on_roll']:.4g}."
    )


def trace(shown: Trace) -> Figure:
    """Measured and modelled, and what lies between."""
    made, (above, below) = figure(height=3.6, rows=2, sharex=True, height_ratios=[3, 1])
    above.plot(shown.time_s, shown.measured, color=MEASURED, label="measured")
    above.plot(shown.time_s, shown.modelled, color=MODELLED, label="modelled")
    above.set_ylabel(f"{shown.channel}\n{shown.unit}")
    legend_above(above)
    below.plot(shown.time_s, shown.measured - shown.modelled, color=NEUTRAL)
    below.set_ylabel(f"error\n{shown.unit}")
    below.set_xlabel("time, s")
    return made


def residual(test: ResidualTest) -> Figure:
    """Correlations of what is left with itself and with the input."""
    made, (left, right) = figure(height=2.6, columns=2)
    _stems(left, test.whiteness, "with itself, rows earlier")
    _stems(right, test.cross, f"with {test.against}, rows earlier")
    left.set_ylabel("correlation")
    left.set_title(test.channel)
    return made


def _stems(axes: Axes, test: CorrelationTest, label: str) -> None:
    axes.axhspan(-test.bound, test.bound, color=BAND, zorder=0)
    outside = np.abs(test.values) > test.bound
    for mask, color in ((~outside, GOOD), (outside, BAD)):
        axes.vlines(test.lags[mask], 0, test.values[mask], color=color, linewidth=2.2)
    axes.axhline(0, color=MEASURED, linewidth=0.7)
    reach = 1.15 * max(2.0 * test.bound, float(np.abs(test.values).max()))
    axes.set_ylim(-reach, reach)
    axes.set_xlabel(label)


def residual_text(test: ResidualTest) -> str:
    """What the correlations say."""
    white = "white" if test.whiteness.passes else "not white"
    input_ = "nothing of the input is left" if test.cross.passes else "the input still shows"
    return f"{test.channel}: {white}, {input_}."


def certainty(estimates: Estimates) -> Figure:
    """Correlation of estimates, and their errors as shares of their values."""
    labels = [name.replace(".", "\n") for name in estimates.names]
    made, (left, right) = figure(
        height=max(2.8, 0.5 * len(labels) + 1.0), columns=2, width_ratios=[1.0, 1.1]
    )
    left.imshow(estimates.correlation, cmap="coolwarm", vmin=-1, vmax=1, aspect="auto")
    ticks = range(len(labels))
    left.set_xticks(ticks, labels, rotation=60, ha="right", fontsize=7)
    left.set_yticks(ticks, labels, fontsize=7)
    left.grid(visible=False)
    left.set_title("correlation")
    for i in ticks:
        for j in ticks:
            value = estimates.correlation[i, j]
            color = ON_DARK if abs(value) > 0.7 else ON_BRIGHT
            left.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=7, color=color)
    shares = 100 * estimates.stderr / np.maximum(np.abs(estimates.values), 1e-300)
    shares = np.minimum(shares, MOST_PERCENT)  # an effect that is not there is 0
    right.barh(ticks, shares, color=SERIES[0], height=0.6)
    right.set_xscale("log")
    right.set_xlim(
        10.0 ** np.floor(np.log10(shares.min())), 10.0 ** np.ceil(np.log10(shares.max()))
    )
    right.xaxis.set_major_formatter("{x:g}")
    right.xaxis.set_minor_formatter("")
    right.invert_yaxis()
    right.set_yticks(ticks, labels, fontsize=7)
    right.set_xlabel("standard error, % of the value")
    right.set_title("uncertainty")
    right.set_axisbelow(True)
    return made


def steps(shown: Sequence[Step]) -> Figure:
    """Responses of ARX models to a unit step, axis by axis."""
    axes_names = list(dict.fromkeys(step.axis for step in shown))
    made, every = figure(height=3.0, columns=len(axes_names))
    for axes, name in zip(every, axes_names, strict=True):
        here = [step for step in shown if step.axis == name]
        reach = max(float(np.abs(here[0].output).max()), 1e-300)
        for color, step in zip(SERIES, here, strict=False):
            axes.plot(
                step.time_s,
                step.output / reach,
                color=color,
                linewidth=2.6 if step.chosen else 1.2,
                linestyle="-" if step.plausible else "--",
                label=step.label,
            )
        lowest = min(float(step.output.min()) / reach for step in here)
        axes.set_ylim(max(1.2 * lowest, -1.3) - 0.6, 1.6)
        axes.set_title(name)
        axes.set_xlabel("time, s")
        axes.legend(loc="lower right")
    every[0].set_ylabel("output over the chosen one's end")
    return made
