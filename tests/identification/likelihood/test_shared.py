"""A number of the craft that two effects have in common has one value."""

import pytest

from groundstation.discrepancy.screening import settle, started
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import VARIANTS, point_of
from groundstation.identification.likelihood.problem import Problem
from groundstation.identification.runs import flights_of
from support.flights import CARRYING_GAINS, recorded

INERTIA = 6e-8
MODEL = vehicle_model(BUILT_IN["crazyflie1"])
YAW, TILT = (
    f"{name}.rotor_inertia_kg_m2"
    for name in ("rotor_acceleration_torque", "rotor_gyroscopic_torque")
)


def test_the_torques_of_accelerating_and_of_tilting_rotors_have_one_inertia():
    effects = {"rotor_inertia": {"rotor_inertia_kg_m2": INERTIA}}
    samples, _ = recorded(30.0, seed=5, plant="reduced", gains=CARRYING_GAINS, effects=effects)
    problem = Problem(prepare(flights_of(samples, "flight")), MODEL, point_of(MODEL))
    problem.settle_filters()
    plain = settle(problem).without_effects(problem.base_keys)
    point = dict(plain.point)
    torques = [one for one in VARIANTS if one.keys[0] in (YAW, TILT)]
    for one in plain.scores(problem.base_keys, torques):
        point = started(point, one)
    both = problem.fit(point, (*problem.base_keys, YAW, TILT))
    assert both.point[YAW] == pytest.approx(both.point[TILT], rel=0.01)
    assert abs(both.point[YAW] - INERTIA) < 4.0 * both.stderr()[YAW] < 0.2 * INERTIA
