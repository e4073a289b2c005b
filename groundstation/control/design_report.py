"""What a design reports: numbers for programs, a page for people."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from groundstation.control.design import (
    COMPLIANCE,
    OFFSET,
    OVERSHOOT,
    RMS,
    SENSITIVITY,
    SETTLING,
    Design,
    Limits,
    reasons,
)
from groundstation.control.evaluate import AxisResult, evaluate
from groundstation.control.firmware_design import (
    DESIGN_BAND,
    WINDOW_S,
    AxisDesign,
    Robustness,
    gain_meaning,
)
from groundstation.control.firmwares import Release
from groundstation.control.linear_loop import DirectJudge, direct_loop
from groundstation.control.loop_figures import add_loop_figures
from groundstation.control.margins import Margins
from groundstation.control.pid import PidGains, gain_unit
from groundstation.control.report import (
    BROKEN_AT,
    DEFINITIONS,
    LOOP_NAMES,
    METRICS_HEAD,
    front_figure,
    metrics_row,
    step_figure,
)
from groundstation.control.thesis_tables import GAINS, RESULTS
from groundstation.control.uncertainty import estimates_of
from groundstation.dynamics.meanings import WORDS, Use, suitability
from groundstation.dynamics.model import ArxAxis, Model
from groundstation.report.page import Page
from groundstation.telemetry.arrays import Array

Found = Mapping[str, tuple[PidGains, Design, Margins, ArxAxis]]
FRONT_ROWS = 200
"""Points of the front that a report carries."""
DIRECT = ("kp", "ki", "kd")
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
    notes = [limits_line(limits)]
    if release == "2.x" and model.firmware_curve is None:
        notes.insert(0, ASSUMED_CURVE)
    axes, known = {}, suitability(model)
    for one in designs:
        entry = axis_entry(one.nominal, one.margins, one.design, tuple(one.gains))
        entry["gains"] = one.gains
        entry["reasons"] = list(one.reasons)
        stock = one.stock_margins
        entry["notes"] = [
            f"stock gains: maximum sensitivity {stock.max_sensitivity:.1f},"
            f" delay margin {1e3 * stock.delay_s:.1f} ms"
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
            entry["notes"].append(
                f"{tried.stable[one.axis]} of {tried.drawn} models drawn from the fit's covariance"
                " are stable; "
                + (
                    "more than 5 % of them do not settle"
                    if settling is None
                    else f"95 % of them settle within {settling:.3f} s"
                )
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
        entry = axis_entry(design.judgement, margins, design, DIRECT)
        entry["gains"] = dict(zip(DIRECT, gains.as_tuple(), strict=True))
        entry["delay_samples"] = plant.nk
        judge = DirectJudge(plant, 2.0)
        entry["reasons"] = list(reasons(judge, entry["gains"], PURPOSES, limits))
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
        "notes": [limits_line(limits)],
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
    page.verdict(*_verdict(ours, stock))
    page.table(
        BESIDE_HEAD,
        [row for old, new in zip(stock, ours, strict=True) for row in _beside(old, new)],
        f"{DEFINITIONS} Maximum sensitivity: the most that pushes are amplified by. Delay margin:"
        " how much more delay makes the loop unstable.",
    )
    page.figure(step_figure(ours, stock), "Step responses: designed, and stock gains in grey.")
    loops = {one.axis: one.loop for one in ours}
    add_loop_figures(page, loops, BROKEN_AT["firmware"], report["max_sensitivity"])
    page.heading("Gains and reasons")
    page.table(
        GAINS_HEAD,
        [(name, value, *gain_meaning(name)) for name, value in gains.items()],
    )
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
    page.table(DESIGN_HEAD, [design_row(axis, e) for axis, e in report["axes"].items()])
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


DESIGN_HEAD = (
    "axis",
    "RMS of step",
    "overshoot %",
    "settling s",
    "max sensitivity",
    "gain may grow by",
    "gain may fall to",
    "delay margin ms",
)


def design_row(axis: str, entry: dict[str, Any]) -> list[Any]:
    return [
        axis,
        entry["rms"],
        entry["overshoot_pct"],
        entry["settling_s"],
        entry["max_sensitivity"],
        entry["gain_up"],
        entry["gain_down"],
        1e3 * entry["delay_margin_s"],
    ]


def axis_entry(
    judgement: Any, margins: Margins, design: Design, names: tuple[str, ...]
) -> dict[str, Any]:
    """names: of the gains, in the design's order."""
    rows = np.unique(np.linspace(0, len(design.front) - 1, FRONT_ROWS).astype(int))
    told = margins.as_dict()
    return {
        "rms": float(judgement[RMS]),
        "overshoot_pct": float(judgement[OVERSHOOT]),
        "settling_s": float(judgement[SETTLING]),
        "steady_state_error": float(judgement[OFFSET]),
        "max_sensitivity": told["max_sensitivity"],
        "delay_margin_s": told["delay_s"],
        "gain_up": told["gain_up"],
        "gain_down": told["gain_down"],
        "phase_margin_deg": told["phase_deg"],
        "compliance": float(judgement[COMPLIANCE]),
        "fastest_settling_s": design.fastest,
        "smallest_overshoot_pct": design.calmest,
        "front": [
            {
                "overshoot_pct": float(row[OVERSHOOT]),
                "settling_s": float(row[SETTLING]),
                "max_sensitivity": float(row[SENSITIVITY]),
                "gains": dict(zip(names, gains.tolist(), strict=True)),
            }
            for row, gains in zip(design.front[rows], design.front_gains[rows], strict=True)
        ],
    }


def _printed(axis: str) -> list[tuple[str, float, float]]:
    return [(name, RESULTS[name][axis][1], RESULTS[name][axis][2]) for name in GAINS]


def limits_line(limits: Limits) -> str:
    return (
        f"limits: maximum sensitivity {limits.sensitivity:g}, {1e3 * limits.delay_s:g} ms of spare"
        f" delay, steady-state error {100 * limits.offset:g} % of the step"
    )


BESIDE_HEAD = (METRICS_HEAD[0], "gains", *METRICS_HEAD[1:])


def _beside(stock: AxisResult, ours: AxisResult) -> list[list[Any]]:
    """Two rows under ``BESIDE_HEAD``."""
    return [
        [stock.axis, "stock", *metrics_row(stock)[1:]],
        ["", "designed", *metrics_row(ours)[1:]],
    ]


def _verdict(ours: Sequence[AxisResult], stock: Sequence[AxisResult]) -> tuple[str, str]:
    """What the design gains over the stock gains, axis by axis."""
    changes = []
    for one, old in zip(ours, stock, strict=True):
        now, was = one.margins, old.margins
        if now is None:
            return f"{one.axis} is unstable with these gains.", "bad"
        words = [
            f"settles in {_settled(one)} (stock {_settled(old)})",
            f"overshoot {one.metrics.overshoot_pct:.0f} % ({old.metrics.overshoot_pct:.0f} %)",
            f"maximum sensitivity {now.max_sensitivity:.1f}"
            + (" (unstable)" if was is None else f" ({was.max_sensitivity:.1f})"),
        ]
        changes.append(f"{one.axis}: {', '.join(words)}")
    return "; ".join(changes) + ".", "good"


def _settled(one: AxisResult) -> str:
    value = one.metrics.settling_s
    return "not in the window" if value is None else f"{value:.2f} s"


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
