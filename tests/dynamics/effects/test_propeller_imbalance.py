"""A propeller out of balance: as mechanics has it, and as the stand-in, written apart, has it."""

import math

import numpy as np
import pytest

from firmware_sim.layout import PHASE
from groundstation.dynamics.effect import FAR_M, Body
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.vehicle import load_vehicle, rotor_positions_m
from groundstation.prediction.prediction import fly_reference, load_reference
from support.flights import affected
from support.plant import plant, slopes

VALUES = {"rotor": 2.0, "imbalance_g_mm": 0.05, "couple_g_mm2": 0.4}
VEHICLE = load_vehicle("crazyflie1")
STILL, SPEEDS = (0.0, 0.0, 0.0), (250.0, 262.0, 241.0, 248.0)


class Craft:
    """What the law reads of one."""

    mass, inertia = VEHICLE.mass_kg, VEHICLE.inertia_kg_m2
    rotor_x, rotor_y = zip(*rotor_positions_m(VEHICLE), strict=True)


def shaken(turns, known=1.0, **values):
    """Angular acceleration and specific force that the law adds, and the states' slopes."""
    still = (0.0, 0.0, 0.0, 0.0)
    body = Body(FAR_M, (1.0, 0.0, 0.0, 0.0), STILL, STILL, SPEEDS, still, 0.0, STILL, STILL)
    law = EFFECTS["propeller_imbalance"].law
    turn, push, change = law(tuple({**VALUES, **values}.values()), Craft, body, (turns, known))
    return np.array(turn), np.array(push), change


def test_the_force_is_that_of_a_mass_on_a_circle():
    _, push, change = shaken(0.3)
    force = 0.05e-6 * (2.0 * math.pi * SPEEDS[1]) ** 2
    assert np.linalg.norm(push) * Craft.mass == pytest.approx(force)
    assert change == (SPEEDS[1], 0.0)


@pytest.mark.parametrize(("rotor", "turns"), [(1, 1.0), (2, -1.0), (3, 1.0), (4, -1.0)])
def test_it_turns_as_its_rotor_does(rotor, turns):
    """M1 and M3 counter-clockwise, seen from above."""
    directions = [shaken(turned, rotor=rotor)[1] for turned in (0.0, 0.01)]
    assert np.sign(np.cross(*directions)[2]) == turns


@pytest.mark.parametrize("phase", [0.0, 0.13, 0.61, 7.4])
@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_the_stand_in_has_the_same_imbalance(rotor, phase):
    found = []
    for values in ({**VALUES, "imbalance_g_mm": 0.0, "couple_g_mm2": 0.0}, VALUES):
        p, s = plant(effects={"propeller_imbalance": {**values, "rotor": float(rotor)}})
        s["y"][0, 13:17] = SPEEDS
        s["y"][0, PHASE + rotor - 1] = phase
        found.append(slopes(p, s))
    turn, push, _ = shaken(phase, rotor=rotor)
    np.testing.assert_allclose(found[1][3:6] - found[0][3:6], push, atol=1e-9)
    np.testing.assert_allclose(found[1][10:13] - found[0][10:13], turn, rtol=1e-9, atol=1e-9)


def test_what_nobody_can_foresee_is_expected_to_be_nothing():
    turn, push, _ = shaken(0.2, known=0.0)
    assert not turn.any()
    assert not push.any()


def test_a_made_flight_shakes_at_the_rotors_own_frequency():
    """Each row at the rotor's angle: what is left of the accelerometer goes with it."""
    made = fly_reference(affected("propeller_imbalance", VALUES), load_reference("hover"))
    shown = made.accelerometer[500:1500, :2] @ [1.0, 1j]
    turned = 2.0 * math.pi * np.cumsum(made.rotor_rev_s[500:1500, 1]) * made.period_s
    shown, spin = shown - shown.mean(), np.exp(-1j * turned)  # M2 turns clockwise
    _, push, _ = shaken(0.0)
    ratio = (made.rotor_rev_s[500:1500, 1].mean() / SPEEDS[1]) ** 2
    assert abs((shown * spin.conj()).mean()) == pytest.approx(ratio * push[0], rel=0.1)
