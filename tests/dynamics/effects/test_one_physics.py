"""Simulation, prediction and PID fly one craft: the same accelerations, whatever effect it has."""

from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from groundstation.control.firmware_loop import plant_of_model, run_cascade
from groundstation.dynamics.craft import craft_of_model
from groundstation.dynamics.model import EffectTerm, Estimate
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.rotations import quaternion_of_attitude
from groundstation.dynamics.simulation import (
    POSITION,
    QUATERNION,
    RATE,
    ROTOR,
    VELOCITY,
    accelerations,
    simulate,
)
from groundstation.prediction.drive import drive_run
from groundstation.prediction.prediction import fly_ahead, observe_run
from support.flights import BASE

CRAFT = [name for name, one in EFFECTS.items() if one.stage in ("supply", "motor", "rotor", "body")]
SHORT_S, SUPPLY_MV = 1e-5, 3700.0
GAINS = {"pid_rate.roll_kp": 20.0, "pid_rate.pitch_kp": 20.0}


def drawn(name, seed):
    """A model with an effect: its defaults, its limits, or something plausible."""
    effect, generator = EFFECTS[name], np.random.default_rng([seed, len(name)])
    values = {}
    for p in effect.parameters:
        if seed == 0:
            continue
        value = (p.low, p.high)[seed - 1] if seed < 3 else generator.uniform(p.low, p.high)
        values[p.name] = float(round(value) if p.kind == "choice" else value)
    terms = {key: Estimate(value) for key, value in values.items()}
    return msgspec.structs.replace(BASE, effects=(EffectTerm(name, terms),))


def states(count):
    generator = np.random.default_rng(3)
    found = np.zeros((count, 17))
    found[:, POSITION] = generator.uniform(0.0, 0.3, (count, 3))
    found[:, VELOCITY] = generator.normal(0.0, 1.0, (count, 3))
    found[:, QUATERNION] = quaternion_of_attitude(generator.normal(0.0, 0.3, (count, 3)))
    found[:, RATE] = generator.normal(0.0, 2.0, (count, 3))
    found[:, ROTOR] = generator.uniform(200.0, 280.0, (count, 4))
    return found


@pytest.mark.parametrize("seed", range(4), ids=["default", "low", "high", "random"])
@pytest.mark.parametrize("name", CRAFT)
def test_a_simulated_step_is_what_the_accelerations_say(name, seed):
    craft = craft_of_model(drawn(name, seed))
    voltage = np.array([[2300.0, 2100.0, 2500.0, 2400.0]])
    for state in states(2):
        supply = np.full(1, SUPPLY_MV)
        after = simulate(craft, state, voltage, period_s=SHORT_S, supply_mv=supply)[1]
        slope = (after[ROTOR] - state[ROTOR]) / SHORT_S
        expected = accelerations(craft, state, slope)
        gained = (after[RATE] - state[RATE]) / SHORT_S
        np.testing.assert_allclose(gained, expected[:3], rtol=2e-3, atol=2e-3)
        fall = (after[VELOCITY] - state[VELOCITY]) / SHORT_S + [0.0, 0.0, 9.80665]
        assert np.linalg.norm(fall) == pytest.approx(np.linalg.norm(expected[3:]), rel=2e-3)


@pytest.mark.parametrize("seed", [0, 3], ids=["default", "random"])
@pytest.mark.parametrize("name", CRAFT)
def test_the_predictor_flies_the_same_accelerations(name, seed):
    model = drawn(name, seed)
    rows = 4
    duty = np.tile([0.6, 0.62, 0.58, 0.61], (rows, 1))
    duty[1:] += [0.03, -0.02, 0.01, 0.02]
    zeros = np.zeros((rows, 3))
    felt = dict.fromkeys(("gyro", "accelerometer", "attitude"), zeros)
    volts = np.full(rows, 3.7)
    run = SimpleNamespace(period_s=2e-4, duty=duty, settings=duty, supply_v=volts, **felt)
    seen = observe_run(model, run, height_m=np.full(rows, np.nan))
    drive = drive_run(model, run)
    (state,) = states(1)
    state[ROTOR] = drive.speed[0]
    start = seen.states.copy()
    start[:, :17] = state
    ahead = fly_ahead(run, replace(seen, states=start), [0], [1])
    slope = (drive.speed[2] - drive.speed[0]) / run.period_s
    middle = state.copy()
    middle[ROTOR] = drive.speed[1]
    expected = accelerations(drive.craft, middle, slope)
    gained = (ahead.states[0, RATE] - state[RATE]) / run.period_s
    np.testing.assert_allclose(gained, expected[:3], rtol=0.02, atol=0.1)
    np.testing.assert_allclose(ahead.accelerometer[0, 0], expected[3:], rtol=0.02, atol=0.02)


@pytest.mark.parametrize("seed", [0, 3], ids=["default", "random"])
@pytest.mark.parametrize("name", CRAFT)
def test_the_plant_of_pid_flies_the_same_craft(name, seed):
    model = drawn(name, seed)
    plant = plant_of_model(model)
    wanted = np.zeros((60, 3))
    wanted[5:, 0], wanted[20:, 1], wanted[30:, 2] = 0.1, -0.1, 0.5
    response = run_cascade(plant, GAINS, wanted, supply_mv=SUPPLY_MV)
    voltage = response.pwm / 512.0 * SUPPLY_MV
    flown = simulate(craft_of_model(model), plant.start, voltage, supply_mv=np.full(60, SUPPLY_MV))
    assert np.abs(flown[:60, RATE]).max() > 0.05
    np.testing.assert_allclose(response.gyro, flown[:60, RATE], rtol=1e-9, atol=1e-9)
