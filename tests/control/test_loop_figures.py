"""Frequency responses as they are drawn, against loops whose answer is known."""

import numpy as np
import pytest

from groundstation.control.metrics import LoopResponse
from groundstation.control.report import bode_figure, nyquist_figure, sensitivity_figure

OMEGA = np.geomspace(0.01, 100.0, 4000)
GAIN = 4.0


@pytest.fixture(scope="module")
def loops():
    """4 / (s (s + 1)), which closes to a resonance at 2 rad/s with a damping of a quarter."""
    s = 1j * OMEGA
    return {"roll": LoopResponse(OMEGA, GAIN / (s * (s + 1.0)))}


def drawn(panel):
    """The first line of a panel that has as many points as there are frequencies."""
    return next(line for line in panel.lines if len(line.get_xdata()) == len(OMEGA))


def test_sensitivities_are_those_of_the_closed_loop(loops):
    left, through = loops["roll"].sensitivities
    s = 1j * OMEGA
    closed = s * s + s + GAIN
    np.testing.assert_allclose(left, np.abs((s * s + s) / closed), rtol=1e-9)
    np.testing.assert_allclose(through, np.abs(GAIN / closed), rtol=1e-9)
    assert left.max() == pytest.approx(loops["roll"].margins.max_sensitivity, rel=1e-9)


def test_bode_crosses_where_the_gain_is_one_and_marks_it(loops):
    gain, phase = bode_figure(loops).axes
    crossover = np.sqrt((np.sqrt(1 + 4 * GAIN**2) - 1) / 2)
    (dot,) = (line for line in gain.lines if line.get_marker() == "o")
    assert dot.get_xdata()[0] == pytest.approx(crossover, rel=0.01)
    angle = np.interp(crossover, OMEGA, drawn(phase).get_ydata())
    assert angle == pytest.approx(-90 - np.degrees(np.arctan(crossover)), abs=0.1)


def test_nyquist_marks_the_point_nearest_to_minus_one_and_what_a_design_keeps_out_of(loops):
    (panel,) = nyquist_figure(loops, most=2.0).axes
    (dot,) = (line for line in panel.lines if line.get_marker() == "o")
    nearest = complex(dot.get_xdata()[0], dot.get_ydata()[0])
    assert 1 / abs(nearest + 1) == pytest.approx(loops["roll"].margins.max_sensitivity, rel=1e-9)
    circle = panel.patches[0].get_xy()
    np.testing.assert_allclose(np.hypot(circle[:, 0] + 1, circle[:, 1]), 0.5, atol=1e-12)


def test_the_largest_sensitivity_is_marked(loops):
    (panel,) = sensitivity_figure(loops).axes
    (dot,) = (line for line in panel.lines if line.get_marker() == "o")
    assert dot.get_ydata()[0] == pytest.approx(loops["roll"].margins.max_sensitivity)
    assert drawn(panel).get_ydata().max() == dot.get_ydata()[0]
