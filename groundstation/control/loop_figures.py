"""Bode, Nyquist and sensitivity of loops; what they show is computed by python-control."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from groundstation.control.margins import LoopResponse
from groundstation.report.page import BAD, NEUTRAL, SERIES, Page, figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
