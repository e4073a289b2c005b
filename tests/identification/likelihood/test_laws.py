"""Laws on rows: as arrays where their Python allows it, otherwise compiled, with their states."""

import numpy as np
import pytest
from scipy.signal import lfilter

from groundstation.dynamics.effect import Body, Effect, Parameter, Reading, State
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.likelihood.motion import Acting, Frame, point_of
from groundstation.identification.likelihood.sensing import Moving, Passing, Sensors

ROWS, PERIOD = 400, 0.002
VEHICLE = BUILT_IN["crazyflie1"]
CRAFT = Frame(VEHICLE).craft(point_of(vehicle_model(VEHICLE)))


def rows(seed=0):
    """A body of arrays."""
    draw = np.random.default_rng(seed)

    def some(count, scale, mean=0.0):
        return tuple(mean + scale * draw.normal(size=(count, ROWS)))

    (height,), (thrust,) = some(1, 0.02, 0.1), some(1, 0.02, 0.2)
    quaternion = np.array(some(4, 1.0))
    turned = tuple(quaternion / np.linalg.norm(quaternion, axis=0))
    moving = some(3, 1.0), some(3, 2.0), some(4, 20.0, 250.0), some(4, 500.0)
    return Body(height, turned, *moving, thrust, some(3, 10.0), some(3, 2.0, 5.0))


def row(given, place):
    """One row of nested tuples of arrays."""
    if isinstance(given, tuple):
        parts = [row(part, place) for part in given]
        return type(given)(*parts) if hasattr(given, "_fields") else tuple(parts)
    return float(given[place]) if np.ndim(given) else float(given)


def flat(given):
    return [one for part in given for one in flat(part)] if isinstance(given, tuple) else [given]


@pytest.mark.parametrize(
    "name", [n for n, e in EFFECTS.items() if e.stage in ("rotor", "body") and not e.states]
)
def test_a_law_says_the_same_of_arrays_and_of_numbers(name):
    effect, body = EFFECTS[name], rows()
    one = Acting(effect, tuple(p.default or 0.01 for p in effect.parameters))
    more = ((0.2, 1e-3, -2e-3, 1e-4),) if effect.stage == "rotor" else ()
    found = one.law(CRAFT, body, *more)
    for place in (0, 17, ROWS - 1):
        expected = effect.law(one.values, CRAFT, row(body, place), *more)
        np.testing.assert_allclose(flat(row(found, place)), flat(expected), rtol=1e-12)


def bent(values, craft, body):
    """Branches, which no array can follow."""
    push = values[0] * body.velocity[0] if body.height < 0.1 else 0.0
    return (0.0, push, 0.0), (0.0, 0.0, -push)


def fin(values, craft, body, state):
    yaw, lag = values
    return (0.0, 0.0, yaw * state[0]), (0.0, 0.0, 0.0), ((body.velocity[1] - state[0]) / lag,)


def effect_of(law, **more):
    parameters = (Parameter("a", "", 2.0, 0.1, 9.0), Parameter("b", "s", 0.05, 0.0, 1.0))
    told = law.__name__, "body", parameters, "", "", ""
    return Effect(*told, channels=("gyro z",), law=law, **more)


def test_a_law_that_branches_is_run_row_by_row():
    body = rows()
    angular, force = Acting(effect_of(bent), (2.0, 0.05)).law(CRAFT, body)
    expected = np.where(body.height < 0.1, 2.0 * body.velocity[0], 0.0)
    np.testing.assert_allclose(angular[1], expected)
    np.testing.assert_allclose(force[2], -expected)
    assert not angular[0].any()


def test_states_run_along_the_rows():
    """A lag of an input that is held over each period, which has an exact answer."""
    body, lag = rows(), 0.05
    effect = effect_of(fin, states=(State("air"),), fastest=lambda values: 1.0 / values["b"])
    one = Acting(effect, (2.0, lag))
    keep = np.exp(-PERIOD / lag)
    left = np.concatenate([[0.0], body.velocity[1][1:]])
    ends = 2.0 * lfilter([1.0 - keep], [1.0, -keep], left)
    (_, _, at_row), _ = one.body_law(CRAFT, body, PERIOD, mean=False)
    np.testing.assert_allclose(at_row, ends, atol=1e-6)
    (_, _, mean), _ = one.body_law(CRAFT, body, PERIOD, mean=True)
    np.testing.assert_allclose(mean[1:], 0.5 * (ends[1:] + ends[:-1]), atol=1e-6)


def heavier(values, craft, body):
    """As ``mass_change``, with a branch that no array can follow."""
    share = values[0] if body.height > 0.0 else 0.0
    x, y, z = body.force
    return (0.0, 0.0, 0.0), (-share * x, -share * y, -share * z)


def sloshing(values, craft, body, state):
    """A load that follows the force on the craft, and holds back a share of it."""
    share, lag = values
    _, _, z = body.force
    return (0.0, 0.0, 0.0), (0.0, 0.0, -share * state[0]), ((z - state[0]) / lag,)


def test_a_law_that_acts_late_reads_what_the_others_made_of_the_craft():
    body = rows()
    angular, force = Acting(effect_of(heavier, order=9), (0.1, 0.05)).law(CRAFT, body)
    np.testing.assert_allclose(force, -0.1 * np.array(body.force) * (body.height > 0.0), atol=1e-12)
    assert not np.abs(angular).any()


def test_so_do_its_states():
    body, lag = rows(), 0.05
    states = {"states": (State("load"),), "fastest": lambda values: 1.0 / values["b"]}
    one = Acting(effect_of(sloshing, order=9, **states), (0.1, lag))
    keep = np.exp(-PERIOD / lag)
    pulled = np.concatenate([[0.0], body.force[2][1:]])
    expected = -0.1 * lfilter([1.0 - keep], [1.0, -keep], pulled)
    _, (_, _, found) = one.body_law(CRAFT, body, PERIOD, mean=False)
    np.testing.assert_allclose(found, expected, atol=1e-6)


SENSORS = {
    "gyro_low_pass": (30.0,),
    "imu_misalignment": (3.0, -5.0, 8.0),
    "accelerometer_bias": (0.02, -0.01, 0.03),
    "gyro_bias": (1.0, -2.0, 0.5),
}


def test_sensors_are_undone():
    """What steady sensors show of a turning craft is brought back to the body's axes."""
    sensors = Sensors(tuple(Acting(EFFECTS[n], v) for n, v in SENSORS.items()), CRAFT)
    rate, force = np.array([0.4, -0.7, 1.1]), np.array([0.3, -0.2, 9.0])
    reading = Reading(tuple(rate), tuple(force), (0.0,) * 4)
    body = row(rows(), 0)
    for name, values in SENSORS.items():
        if not EFFECTS[name].states:
            reading = EFFECTS[name].law(values, CRAFT, body, reading)
    shown = np.array([reading.gyro]), np.array([reading.accelerometer])
    np.testing.assert_allclose(sensors.true(*shown), [[rate], [force]], atol=1e-9)
    np.testing.assert_allclose(sensors.gyro_lag, np.eye(3) / (2 * np.pi * 30.0), atol=1e-9)


def test_a_lagging_sensor_shows_means_of_a_held_slope_exactly():
    lag = 1.0 / (2 * np.pi * 30.0)
    sensors = Sensors((Acting(EFFECTS["gyro_low_pass"], (30.0,)),), CRAFT)
    body = rows()
    moving = Moving(body, PERIOD, 0)
    still = (0.0, 0.0, 0.0)
    shown = sensors.shown(Passing(still, body.angular, still), moving)[-1]
    keep = np.exp(-PERIOD / lag)
    share, state, expected = lag / PERIOD * (1 - keep), body.angular[0][0], []
    for value in body.angular[0]:
        expected.append(value + (state - value) * share)
        state = value + (state - value) * keep
    np.testing.assert_allclose(shown.angular[0], expected, rtol=1e-9)
