"""Gains from one loop's form to another's: the same loop, told in other units."""

from pathlib import Path

import numpy as np
import pytest

from groundstation.control.firmware_loop import loop_response, plant_of_model
from groundstation.control.firmwares import RELEASE_2014, PidGains, gain_unit
from groundstation.control.linear_loop import axis_plant, convert_gains, direct_loop, whole_loop
from groundstation.dynamics.model import load_model
from groundstation.errors import BadInputError

MODEL = load_model(Path(__file__).parent / "data" / "body.json")
STOCK = dict(RELEASE_2014.stock)
OMEGA = np.geomspace(1.0, 40.0, 40)


def at(loop, omega=OMEGA):
    """The loop at some frequencies."""
    real, imaginary = (
        np.interp(omega, loop.omega, part) for part in (loop.loop.real, loop.loop.imag)
    )
    return real + 1j * imaginary


@pytest.mark.parametrize(
    ("loop", "units"),
    [
        ("direct", ["(rev/s)² per rad", "(rev/s)² per rad s", "(rev/s)² per rad/s"]),
        ("whole", ["PWM counts per rad", "PWM counts per rad s", "PWM counts per rad/s"]),
    ],
)
def test_a_gain_has_the_unit_of_its_loops_output(loop, units):
    assert [gain_unit(name, loop) for name in ("kp", "ki", "kd")] == units


@pytest.mark.parametrize("axis", ["roll", "pitch", "yaw"])
def test_the_stock_cascade_and_its_pid_are_the_same_loop(axis):
    """But for the delays of the firmware's two loops and of whole samples."""
    whole = convert_gains(STOCK, "firmware", "whole", MODEL)
    ours = at(whole_loop(MODEL, whole[axis], axis))
    plant = plant_of_model(MODEL, fusion=False)
    flown = loop_response(plant, STOCK, axis, OMEGA)
    apart = flown / ours
    assert np.abs(np.abs(apart) - 1.0).max() < 0.05
    assert np.abs(np.degrees(np.angle(apart))).max() < 8.0


@pytest.mark.parametrize("supply_mv", [3300.0, 4100.0])
def test_there_and_back_are_the_same_gains(supply_mv):
    whole = convert_gains(STOCK, "firmware", "whole", MODEL, supply_mv)
    direct = convert_gains(whole, "whole", "direct", MODEL, supply_mv)
    back = convert_gains(direct, "direct", "firmware", MODEL, supply_mv)
    assert back == pytest.approx({name: STOCK[name] for name in back})
    assert len(back) == 8


def test_on_settled_motors_counts_are_the_control_they_make():
    """At frequencies far below the motors' lag the direct loop is the whole one."""
    gains = {"roll": PidGains(2e5, 0.0, 1e5)}
    whole = convert_gains(gains, "direct", "whole", MODEL)["roll"]
    body_only = MODEL.__class__(vehicle=MODEL.vehicle, motor=MODEL.motor, body=MODEL.body)
    slow = np.geomspace(0.1, 0.3, 5)
    one = at(whole_loop(body_only, whole, "roll"), slow)
    other = at(direct_loop(axis_plant(body_only, "roll"), gains["roll"]), slow)
    np.testing.assert_allclose(np.abs(one / other), 1.0, rtol=0.01)


@pytest.mark.parametrize(
    ("gains", "source", "target", "said"),
    [
        ({"roll": PidGains(100.0)}, "whole", "firmware", "rate loop needs one above 0"),
        ({"yaw": PidGains(9.0, 5.0, 9.0)}, "whole", "firmware", "yaw has no loop for it"),
        ({"roll": PidGains(1e5, 0.0, 1e5)}, "whole", "firmware", "must be 0..1000"),
        ({"pid_rate.roll_ki": 3.0}, "firmware", "whole", "over a rate integral is no PID"),
    ],
)
def test_what_the_other_form_does_not_have_is_refused(gains, source, target, said):
    with pytest.raises(BadInputError, match=said):
        convert_gains(gains, source, target, MODEL)
