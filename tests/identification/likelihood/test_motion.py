"""Rotor speeds as late as the measurements are."""

import numpy as np
import pytest

from groundstation.identification.likelihood.motion import Inputs, Rotors

PERIOD_S, HZ = 2e-3, 9.0


def speeds(late_s, rows=400):
    """Of four rotors at rows that come ``late_s`` later: speed, mean square over the period before,
    mean speed and its slope, by the calculus of a sine."""
    t = PERIOD_S * np.arange(rows)[:, None] - late_s
    w, turn = 2.0 * np.pi * HZ, np.array([0.0, 0.7, 1.9, 3.1])
    end = 210.0 + 30.0 * np.sin(w * t + turn)

    def integral(t):
        angle = w * t + turn
        square = 0.5 * 900.0 * (t - np.sin(2.0 * angle) / (2.0 * w))
        return 210.0**2 * t - 2.0 * 210.0 * 30.0 * np.cos(angle) / w + square

    square = (integral(t) - integral(t - PERIOD_S)) / PERIOD_S
    before = 210.0 + 30.0 * np.sin(w * (t - PERIOD_S) + turn)
    return end, square, 0.5 * (end + before), (end - before) / PERIOD_S


@pytest.mark.parametrize("delay_s", [0.0, 0.4e-3, 2e-3, 5.7e-3, -1.3e-3])
def test_speeds_are_those_of_so_long_before(delay_s):
    end, square, _, _ = speeds(0.0)
    late = Inputs.of(Rotors(end, square), delay_s, PERIOD_S)
    whole = slice(6, -3)
    for found, true, error in zip(
        (late.last, np.square(late.mean), late.rotor, late.slope),
        speeds(delay_s),
        (2e-3, 1.0, 2e-3, 1.5),
        strict=True,
    ):
        assert np.allclose(np.transpose(found)[whole], true[whole], rtol=0.0, atol=error)


@pytest.mark.parametrize("delay_s", [0.0, 5.7e-3, -1.3e-3])
def test_speeds_that_do_not_change_are_the_same_from_the_first_row_to_the_last(delay_s):
    still = np.full((30, 4), 180.0)
    late = Inputs.of(Rotors(still, still**2), delay_s, PERIOD_S)
    for rows in (late.mean, late.last, late.rotor):
        assert np.allclose(rows, 180.0, rtol=1e-12)
    assert np.allclose(late.slope, 0.0, atol=1e-9)
