"""What each release of today's firmware does with thrust, and what lies below its log."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_sim.contents import contents_of
from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.crtp import Conversation
from support.plant import craft_after

HOVER_V = 2.32
"""Motor voltage at the hover of the measured craft."""
LIGHTER = {"mass_change": {"percent": -5.5}}
"""With it a 2.1+ hovers at that voltage."""


def hovering(**settings) -> tuple[np.ndarray, np.ndarray]:
    """What the loops ask motor 1 for, 16-bit, and its voltage by the log, every 4 ms of a hover."""
    given = {"craft": "crazyflie21plus", "plant": "reduced", "program": "hover", **settings}
    craft = StandIn(StandInSettings(seed=5, effects=LIGHTER, **given))
    asked, volts = [], []
    for step in range(12):
        craft.advance(6.0 + step)
        for back in range(4, 800, 4):
            said = craft.logged(craft.uptime_ms - back)
            thrust, roll, pitch, yaw = said.commands
            asked.append(thrust - roll / 2 + pitch / 2 + yaw)
            volts.append(said.motors[0] / 65535 * said.battery_v)
    return np.array(asked), np.array(volts)


def slope_at_hover(asked, volts):
    """V a unit: the curve is bent."""
    return np.polyfit(volts - HOVER_V, asked, 2)[1] ** -1


@pytest.mark.parametrize(
    ("release", "microvolts"),
    [
        ("2023.11", 40.5),
        ("2025.02", 40.5),
        ("2025.09", 29.7),
        ("2025.12", 34.1),
        ("2026.04", 36.4),
        ("2026.08", 36.4),
    ],
)
def test_a_unit_of_the_loops_output_is_as_many_microvolts_as_was_measured(release, microvolts):
    asked, volts = hovering(release=release)
    assert volts.mean() == pytest.approx(HOVER_V, abs=0.02)
    assert 1e6 * slope_at_hover(asked, volts) == pytest.approx(microvolts, rel=0.02)


def test_without_a_release_the_curve_is_the_one_that_gains_are_designed_with():
    own, newest = (slope_at_hover(*hovering(**which)) for which in ({}, {"release": "2026.08"}))
    assert own == pytest.approx(newest, rel=0.01)


def test_a_brushless_gets_its_voltage_compensated_from_december_2025_on():
    for release, compensated in (("2025.09", False), ("2025.12", True)):
        craft = craft_after(
            8.0, craft="brushless", plant="reduced", program="hover", release=release
        )
        said = craft.state()
        assert (said.motors[0] == pytest.approx(said.thrust, rel=0.1)) is not compensated


@pytest.mark.parametrize(
    ("release", "protocol"), [("2023.11", 7), ("2025.12", 10), ("2026.08", 12)]
)
def test_a_release_brings_its_protocol_and_says_its_name(release, protocol):
    craft = StandIn(StandInSettings(craft="crazyflie21", program="wait", release=release))
    assert craft.protocol == protocol
    assert Conversation(craft).answer(b"\xd1\x01") == [b"\xd1\x01" + release.encode()]


def test_a_release_that_never_was_is_refused():
    with pytest.raises(ValueError, match=r"release is 2027.01, must be one of 2023.11"):
        StandInSettings(release="2027.01")


@pytest.mark.parametrize(
    ("craft", "plant", "steps"),
    [
        ("crazyflie21", "faithful", 256),
        ("crazyflie21", "reduced", None),
        ("brushless", "faithful", None),
    ],
)
def test_a_brushed_motor_gets_eight_bits_of_the_sixteen_that_are_logged(craft, plant, steps):
    stand_in = craft_after(6.0, craft=craft, plant=plant, program="hover", truth=True)
    duty = stand_in.truth()["duty"][-1000:]
    told = stand_in._history["pwm"]
    assert len(set(told[:, 0] % 256)) > 50
    if steps is None:
        assert (np.abs(duty * 256 - np.round(duty * 256)) > 1e-6).mean() > 0.9
    else:
        assert duty * steps == pytest.approx(np.round(duty * steps))
        assert duty[1:] * steps == pytest.approx(told[:-1] >> 8)


def test_the_log_names_where_it_is_how_fast_and_how_sure_its_filter_is():
    craft = craft_after(
        4.0, craft="crazyflie21", program="wait", flow_deck=True, protocol=12, seed=2
    )
    table = contents_of(craft)
    values = {name: value(craft.state()) for name, _, value in table.variables}
    kinds = {name: kind for name, kind, _ in table.variables}
    for axis in ("x", "y", "z", "vx", "vy", "vz"):
        assert kinds[f"stateEstimate.{axis}"] == 7
        assert kinds[f"stateEstimateZ.{axis}"] == 5
        millimetres = 1000.0 * values[f"stateEstimate.{axis}"]
        assert values[f"stateEstimateZ.{axis}"] == pytest.approx(millimetres)
    assert values["kalman.varX"] > 50.0
    assert values["kalman.varZ"] < 1e-4
    assert values["kalman.varPX"] == pytest.approx(values["kalman.varPY"], rel=0.1)
    assert values["kalman.varPZ"] < 1e-3 < values["kalman.varPX"]
    assert {"range.zrange", "controller.cmd_roll"} <= set(values)
    assert craft.get_parameter("deck.bcFlow2") == craft.get_parameter("deck.bcZRanger2") == 1.0
    assert craft.get_parameter("stabilizer.estimator") == 2.0


def test_drag_can_be_told_to_the_filter_from_2026_on():
    for protocol, listed in ((10, False), (12, True)):
        craft = StandIn(StandInSettings(craft="crazyflie21", program="wait", protocol=protocol))
        assert ("kalman.dragB_x" in dict(contents_of(craft).parameters)) is listed


def number_of(client: Conversation) -> bytes:
    """The craft's own number as a client reads it."""
    names = [name for name, _ in client.contents.parameters]
    said = b""
    for name in ("cpu.id0", "cpu.id1", "cpu.id2"):
        place = names.index(name).to_bytes(2, "little")
        (answer,) = client.answer(b"\x2d" + place)
        said += answer[4:]
        assert client.answer(b"\x2e" + place + b"\x01\x00\x00\x00") == []
    return said


def test_each_craft_has_a_number_of_its_own():
    numbers = [
        number_of(Conversation(StandIn(StandInSettings(program="wait", **which))))
        for which in (
            {"craft": "crazyflie21", "seed": 1},
            {"craft": "crazyflie21", "seed": 2},
            {"craft": "brushless", "seed": 1},
            {"craft": "crazyflie21", "seed": 1},
            {"craft": "crazyflie21", "cpu_id": 0x0102030405060708090A0B0C},
        )
    ]
    assert [len(number) for number in numbers] == [12] * 5
    assert len(set(numbers)) == 4
    assert numbers[0] == numbers[3]
    assert numbers[4] == bytes(range(12, 0, -1))
