"""What no model should come from: refused by name, or warned of; never a silent bad model."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.errors import BadInputError
from groundstation.identification.arx import identify_arx
from groundstation.identification.body import identify_body
from groundstation.identification.motor.workflow import identify_motor
from groundstation.identification.runs import runs_of
from support.flights import recorded

VEHICLE = BUILT_IN["crazyflie1"]
MODEL = vehicle_model(VEHICLE)
KINDS = {"motor": identify_motor, "body": identify_body, "arx": identify_arx}


@pytest.fixture(scope="module")
def good():
    """kind -> one run that it can be identified on."""
    flight, _ = recorded(45.0, plant="reduced", seed=71)
    bench, _ = recorded(20.0, plant="reduced", seed=72, program="motor_bench", supply_v=3.7)
    (flown,), (turned,) = runs_of(flight, "flight"), runs_of(bench, "bench")
    return {"motor": turned, "body": flown, "arx": flown}


def identify(kind, run, **options):
    return KINDS[kind]([run] if not isinstance(run, list) else run, [], MODEL, VEHICLE, **options)


def with_column(run, name, rows, value):
    column = getattr(run, name).copy()
    column[rows] = value
    return replace(run, **{name: column})


def test_good_data_are_identified_without_a_warning(good):
    found = identify("motor", good["motor"])
    assert found.account["samples"] > 5000
    assert found.account["warnings"] == []


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("motor", "never turn for 2 s"),
        ("body", r"flight: 2\.\d s of uninterrupted flight"),
        ("arx", r"flight: 2\.\d s of uninterrupted flight"),
    ],
)
def test_too_short(good, kind, text):
    run = good[kind]
    short = run[3000:3900] if kind == "motor" else run[3000:4400]
    with pytest.raises(BadInputError, match=text):
        identify(kind, short)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("column", ["duty", "supply_v"])
def test_holes_in_the_inputs(good, kind, column):
    with pytest.raises(BadInputError, match=r"missing in 10 of \d+ samples"):
        identify(kind, with_column(good[kind], column, slice(5000, 5010), np.nan))


@pytest.mark.parametrize("kind", KINDS)
def test_a_battery_that_is_nowhere_is_named_with_what_gives_one(kind, good):
    run = with_column(good[kind], "supply_v", slice(None), np.nan)
    with pytest.raises(BadInputError, match=r"the battery's voltage is nowhere in it.*--supply-v"):
        identify(kind, run)


@pytest.mark.parametrize(
    ("kind", "column", "text"),
    [("body", "gyro", r"missing in 1 of \d+"), ("arx", "attitude", "is not in every row")],
)
def test_holes_in_gyro_and_angles(good, kind, column, text):
    with pytest.raises(BadInputError, match=f"{column} {text}|{column} is {text}"):
        identify(kind, with_column(good[kind], column, 5000, np.nan))


def test_holes_in_the_bench_readings_are_readings_that_are_not_there(good):
    holed = with_column(good["motor"], "debug_s", slice(5000, 5100), np.nan)
    found = identify("motor", holed)
    assert found.model.motor.a0 == pytest.approx(VEHICLE.motor.a0, rel=0.01)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("motor", "voltage is constant; vary the thrust"),
        ("body", "torque or rate about roll is constant"),
        ("arx", "input or output is constant"),
    ],
)
def test_constant_input(good, kind, text):
    run = with_column(good[kind], "duty", slice(None), 0.6)
    run = with_column(run, "supply_v", slice(None), 3.7)
    with pytest.raises(BadInputError, match=text):
        identify(kind, run)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("motor", "voltage is constant"),
        ("body", r"saturated in more than half.*less thrust"),
        ("arx", r"saturated in more than half.*less thrust"),
    ],
)
def test_saturated_throughout(good, kind, text):
    rows = slice(None) if kind == "motor" else (slice(None), 1)
    with pytest.raises(BadInputError, match=text):
        identify(kind, with_column(good[kind], "duty", rows, 1.0))


def test_torque_that_does_not_turn_the_craft(good):
    """A craft held by hand: rates that have nothing to do with the motors."""
    generator = np.random.default_rng(0)
    held = with_column(good["body"], "gyro", slice(None), generator.normal(0, 0.3, (12000, 3))[:1])
    held.gyro[:] = generator.normal(0, 0.3, held.gyro.shape)
    held.attitude[:] = np.cumsum(generator.normal(0, 1e-3, held.attitude.shape), axis=0)
    with pytest.raises(BadInputError, match=r"hardly excited|does not show"):
        identify("body", held)
    with pytest.raises(BadInputError, match="torque does not show in roll"):
        identify("arx", held)


def test_different_rates(good):
    slow = replace(good["body"], period_s=1 / 400, name="slow")
    for kind in ("body", "arx"):
        with pytest.raises(BadInputError, match=r"(?s)slow: 400.* others 500"):
            identify(kind, [good["body"], slow])


def test_rotors_in_a_wrong_order(good):
    swapped = replace(good["body"], duty=good["body"].duty[:, [2, 1, 0, 3]].copy())
    with pytest.raises(BadInputError, match=r"flight: c1 came out negative.*against the torque"):
        identify("body", swapped)


def test_measured_rotors_that_are_not_there(good):
    with pytest.raises(BadInputError, match="rotors' measured speed is nowhere"):
        identify("body", good["body"], measured=True)
    with pytest.raises(BadInputError, match="does not matter what drives the motors"):
        identify("body", good["body"], measured=True, effects=("supply_sag",))


def test_effects_that_a_fit_cannot_know(good):
    with pytest.raises(BadInputError, match=r"--with ground_effect: the motor fit knows"):
        identify("motor", good["motor"], effects=("ground_effect",))
    with pytest.raises(BadInputError, match=r"shows in roll, pitch, yaw.*groundstation discrep"):
        identify("body", good["body"], effects=("gyro_bias",))
    with pytest.raises(BadInputError, match=r"the body fit knows .*dead_time"):
        identify("body", good["body"], effects=("ground_curse",))
