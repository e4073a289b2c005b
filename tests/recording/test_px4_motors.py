"""A PX4 quadrotor's motors: of the right instance, protocol and order, as duty."""

import numpy as np
import pytest

from groundstation.recording.session import Series
from groundstation.recording.ulog_file import motors_of

ROWS = 500
TIME_NS = np.arange(ROWS) * 4_000_000
QUAD_X = {0: (1, 1, 1), 1: (-1, -1, 1), 2: (1, -1, -1), 3: (-1, 1, -1)}
"""Forward, right and spin of PX4's quadrotor x."""


@pytest.fixture
def duty():
    """(n, 4) in our order."""
    return np.random.default_rng(3).uniform(0.4, 0.7, (ROWS, 4))


def outputs(values, name="actuator_outputs", field="output", width=16, rest=0.0):
    whole = np.full((ROWS, width), rest)
    whole[:, : values.shape[1]] = values
    return Series(name, TIME_NS, {f"{field}[{k}]": whole[:, k] for k in range(width)})


def px4(duty):
    """Columns of ours in PX4's order: front right, rear left, front left, rear right."""
    return duty[:, [0, 2, 3, 1]]


def found(series, **parameters):
    motors = motors_of(series, parameters)
    columns = motors.series.columns
    return np.column_stack([columns[f"m{m}"] for m in range(1, 5)]), motors


def test_pulses_are_duty_between_the_ends_that_the_parameters_say(duty):
    got, motors = found([outputs(1000 + 1000 * px4(duty))])
    assert got == pytest.approx(duty)
    assert motors.open == ""
    got, _ = found([outputs(1100 + 850 * px4(duty))], PWM_MIN=1100, PWM_MAX=1950)
    assert got == pytest.approx(duty)
    ends = {f"PWM_MAIN_{e}{k}": v for k in range(1, 5) for e, v in (("MIN", 1050), ("MAX", 1900))}
    got, _ = found([outputs(1050 + 850 * px4(duty))], **ends)
    assert got == pytest.approx(duty)


def test_dshot_and_one_shot_are_told_by_their_numbers(duty):
    got, motors = found([outputs(1999 * px4(duty))])
    assert got == pytest.approx(duty)
    assert "DShot" in motors.notes[-1]
    got, motors = found([outputs(125 + 125 * px4(duty))])
    assert got == pytest.approx(duty)
    assert "OneShot125" in motors.notes[-1]


def test_the_motors_are_the_instance_that_moves(duty):
    idle = outputs(np.full((ROWS, 4), 900.0))
    moving = outputs(1000 + 1000 * px4(duty), "actuator_outputs.1")
    got, motors = found([idle, moving])
    assert got == pytest.approx(duty)
    assert motors.notes[0] == (
        "the motors are actuator_outputs.1, whose outputs move; not actuator_outputs"
    )


def test_the_functions_of_outputs_say_which_are_motors(duty):
    values = np.full((ROWS, 8), 1500.0)
    values[:, [2, 3, 4, 5]] = 1000 + 1000 * px4(duty)
    values[:, 0] += np.arange(ROWS) % 7
    functions = {f"PWM_MAIN_FUNC{k + 3}": 101 + k for k in range(4)}
    got, _ = found([outputs(values)], MAV_TYPE=2, **functions)
    assert got == pytest.approx(duty)


def test_the_thrust_that_was_asked_for_is_made_duty_by_the_thrust_model(duty):
    factor = 0.4
    thrust = factor * duty**2 + (1 - factor) * duty
    asked = outputs(px4(thrust), "actuator_motors", "control", 12, np.nan)
    got, motors = found([asked, outputs(1000 + 1000 * px4(duty))], THR_MDL_FAC=factor)
    assert got == pytest.approx(duty)
    assert "THR_MDL_FAC 0.4" in motors.notes[0]
    got, motors = found([asked], THR_MDL_FAC=0)
    assert (got == pytest.approx(thrust), motors.notes, motors.open) == (True, (), "")


def test_without_the_thrust_model_the_outputs_are_taken_or_the_duty_is_not_known(duty):
    asked = outputs(0.8 * px4(duty), "actuator_motors", "control", 12, np.nan)
    got, motors = found([asked, outputs(1000 + 1000 * px4(duty))], MAV_TYPE=2)
    assert (got == pytest.approx(duty), motors.open) == (True, "")
    got, motors = found([asked], MAV_TYPE=2)
    assert got == pytest.approx(0.8 * duty)
    assert "the motors' duty is not known" in motors.open


@pytest.mark.parametrize("still", [np.nan, 0.5])
def test_thrust_that_never_moves_is_not_the_motors(duty, still):
    idle = outputs(np.full((ROWS, 4), still), "actuator_motors", "control", 12, np.nan)
    moving = outputs(px4(duty), "actuator_motors.1", "control", 12, np.nan)
    got, motors = found([idle, moving], THR_MDL_FAC=0)
    assert got == pytest.approx(duty)
    assert motors.notes == (
        "the motors are actuator_motors.1, whose controls move; not actuator_motors",
    )
    got, motors = found([idle, outputs(1000 + 1000 * px4(duty))], THR_MDL_FAC=0.3)
    assert got == pytest.approx(duty)
    assert motors.notes[0] == "actuator_motors never moves"


def test_only_instances_that_rest_are_named_as_not_the_motors(duty):
    busy = outputs(1000 + 1000 * px4(duty), "actuator_outputs.2")
    slower = outputs(np.repeat(1000 + 1000 * duty[::2], 2, axis=0))
    idle = outputs(np.full((ROWS, 4), 900.0), "actuator_outputs.1")
    _, motors = found([slower, idle, busy])
    assert motors.notes[0].endswith("whose outputs move; not actuator_outputs.1")
    _, motors = found([slower, busy])
    assert motors.notes[0].endswith("actuator_outputs.2, whose outputs move most often")


@pytest.mark.parametrize(
    ("prefix", "low", "high"),
    [
        ("PWM_AUX", 1100, 1900),
        ("PWM_MAIN", 1050, 1950),
        ("SIM_GZ_EC", 150, 900),
        ("UAVCAN_EC", 100, 8000),
    ],
)
def test_the_ends_of_the_drivers_own_parameters_are_the_range(duty, prefix, low, high):
    parameters = {}
    for k in range(1, 5):
        parameters |= {
            f"{prefix}_FUNC{k}": 100 + k,
            f"{prefix}_MIN{k}": low,
            f"{prefix}_MAX{k}": high,
        }
    got, motors = found([outputs(low + (high - low) * px4(duty))], MAV_TYPE=2, **parameters)
    assert (got == pytest.approx(duty), motors.open) == (True, "")


@pytest.mark.parametrize(
    ("full", "parameters"), [(1, {}), (8191, {}), (1999, {"PWM_MAIN_TIM0": -3})]
)
def test_without_a_range_among_the_parameters_the_numbers_say_it(duty, full, parameters):
    got, motors = found([outputs(full * px4(duty))], MAV_TYPE=2, **parameters)
    assert (got == pytest.approx(duty), motors.open) == (True, "")


def test_where_two_ranges_fit_it_is_said_that_the_range_is_not_known(duty):
    _, motors = found([outputs(1000 * px4(duty))], MAV_TYPE=2)
    assert motors.open.startswith("the range of the motors' outputs is not known")
    assert motors_of([outputs(20_000 * duty)], {}).series is None


def test_the_four_outputs_that_move_are_the_motors_where_the_first_rest(duty):
    values = np.column_stack([np.full((ROWS, 2), 1500.0), 1000 + 1000 * px4(duty)])
    got, motors = found([outputs(values)], MAV_TYPE=2)
    assert got == pytest.approx(duty)
    assert motors.notes[0] == "the motors are outputs 2, 3, 4, 5, the four that move"


def test_disarmed_motors_are_off(duty):
    values = px4(duty)
    values[:100] = np.nan
    got, _ = found([outputs(values, "actuator_motors", "control", 12, np.nan)])
    assert (got[:100] == 0.0).all()


def test_the_places_of_the_rotors_decide_their_order(duty):
    shuffled = {0: QUAD_X[2], 1: QUAD_X[3], 2: QUAD_X[1], 3: QUAD_X[0]}
    parameters = {}
    for rotor, (ahead, right, spin) in shuffled.items():
        parameters |= {
            f"CA_ROTOR{rotor}_PX": 0.15 * ahead,
            f"CA_ROTOR{rotor}_PY": 0.2 * right,
            f"CA_ROTOR{rotor}_KM": 0.05 * spin,
        }
    asked = px4(duty)[:, [2, 3, 1, 0]]
    series = [outputs(asked, "actuator_motors", "control", 12, np.nan)]
    got, motors = found(series, CA_ROTOR_COUNT=4, THR_MDL_FAC=0, **parameters)
    assert (got == pytest.approx(duty), motors.open) == (True, "")
    turned = {k: -v if k.endswith("KM") else v for k, v in parameters.items()}
    assert "turn the other way round" in motors_of(series, turned).open
    plus = {k: 0.0 if k.endswith("0_PX") else v for k, v in parameters.items()}
    assert motors_of(series, plus).series is None


def test_the_order_of_betaflight_is_taken_where_it_was_set(duty):
    values = duty[:, [1, 0, 2, 3]]
    got, _ = found([outputs(1000 + 1000 * values)], MOT_ORDERING=1)
    assert got == pytest.approx(duty)


@pytest.mark.parametrize(
    ("parameters", "why"),
    [
        ({"MAV_TYPE": 13}, "MAV_TYPE 13, a hexarotor"),
        ({"CA_ROTOR_COUNT": 8}, "CA_ROTOR_COUNT 8"),
        ({}, "6 motors move"),
        ({"MAV_TYPE": 2, "CA_ROTOR_COUNT": 4}, "6 motors move"),
    ],
)
def test_another_crafts_motors_are_left_out_with_the_reason(duty, parameters, why):
    values = np.column_stack([duty, duty[:, :2]])
    for series in (
        outputs(values, "actuator_motors", "control", 12, np.nan),
        outputs(1000 + 1000 * values),
    ):
        motors = motors_of([series], parameters)
        assert motors.series is None
        assert why in motors.open
