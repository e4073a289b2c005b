"""A new effect is one file: a yaw moment from sideways velocity that lags behind it."""

import os
import sys

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.craft import craft_of_model, load_effects
from groundstation.dynamics.model import EffectTerm, Estimate, load_model, save_model
from groundstation.dynamics.simulation import RATE, accelerations, craft_state, simulate
from support.flights import BASE
from support.programs import run_program

FILE = '''"""Yaw turns towards where the air comes from, a little late: T v' = v_left - v."""

from groundstation.dynamics.effect import TRANSLATE, TRANSLATION, Effect, Parameter, State


def law(values, craft, body, state):
    turn, lag_s = values
    (felt,) = state
    return (0.0, 0.0, turn * felt), (0.0, 0.0, 0.0), ((body.velocity[1] - felt) / lag_s,)


EFFECT = Effect(
    name="yaw_weather_vane",
    stage="body",
    parameters=(
        Parameter("turn", "rad/s^2 per m/s", default=4.0, low=0.1, high=50.0),
        Parameter("lag_s", "s", default=0.1, low=0.01, high=1.0, absent=0.1, kind="shape"),
    ),
    states=(State("sideways velocity felt, m/s"),),
    adds="yaw turns towards where the air comes from",
    signature="flying sideways yaws the craft",
    excited_by=TRANSLATE,
    channels=("gyro z",),
    regimes=TRANSLATION,
    needs=("accelerometer", "attitude"),
    unmeasured=("velocity",),
    law=law,
)
'''
TURN, LAG_S = 5.0, 0.08


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A model file that has the effect, beside the file that defines it."""
    folder = tmp_path_factory.mktemp("vane")
    (folder / "yaw_weather_vane.py").write_text(FILE)
    term = EffectTerm(
        "yaw_weather_vane",
        {"turn": Estimate(TURN), "lag_s": Estimate(LAG_S)},
        "yaw_weather_vane.py",
    )
    save_model(msgspec.structs.replace(BASE, effects=(term,)), folder / "model.json")
    return load_model(folder / "model.json")


def test_it_simulates_with_its_lag(model):
    """At a steady sideways velocity v the yaw rate is turn v (t - T (1 - exp(-t/T)))."""
    craft = craft_of_model(model)
    craft["gravity"], craft["thrust"], craft["drag"] = 0.0, 0.0, 0.0
    start = craft_state(velocity_m_s=(0.0, 1.5, 0.0))
    states = simulate(craft, start, np.zeros((50, 4)))
    time = 0.002 * np.arange(51)
    expected = TURN * 1.5 * (time - LAG_S * (1.0 - np.exp(-time / LAG_S)))
    np.testing.assert_allclose(states[:, RATE][:, 2], expected, rtol=0.03, atol=1e-3)


def test_its_accelerations_follow_the_rows(model):
    craft = craft_of_model(model)
    rows = np.tile(craft_state(velocity_m_s=(0.0, 1.5, 0.0)), (200, 1))
    found = accelerations(craft, rows)[:, 2]
    time = 0.002 * np.arange(200)
    expected = TURN * 1.5 * (1.0 - np.exp(-time / LAG_S))
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_its_file_says_what_a_listed_one_says(model):
    (effect,) = load_effects(model.effects[0].source).values()
    assert [p.name for p in effect.sizes] == ["turn"]
    assert effect.absent({"turn": 0.0})
    assert not effect.absent({})


LISTED = """
import numpy as np
from groundstation.dynamics import effects
effects.__path__.append({folder!r})
from groundstation.dynamics.craft import craft_of_model
from groundstation.dynamics.model import EffectTerm, Estimate, load_model
from groundstation.dynamics.simulation import accelerations, simulate
from groundstation.dynamics.simulation import craft_state
from msgspec.structs import replace

own = load_model({model!r})
(vane,) = own.effects
start = craft_state(velocity_m_s=(0.0, 1.5, 0.0))
for term in (replace(vane, source=""), EffectTerm("rate_damping", {{}})):
    craft = craft_of_model(replace(own, effects=(term,))).view(np.recarray)
    turned = accelerations(craft, np.tile(start, (100, 1)))[-1, 2]
    flown = simulate(craft, start, np.zeros((3, 4)))
    print(craft["body_states"][0], round(turned, 2), flown.shape[1])
"""
"""Kernels as Python, which minds the ends of arrays."""


def test_among_the_listed_ones_it_acts_and_leaves_crafts_without_it_alone(model, tmp_path):
    (tmp_path / "yaw_weather_vane.py").write_text(FILE)
    path = tmp_path / "model.json"
    save_model(model, path)
    code = LISTED.format(folder=str(tmp_path), model=str(path))
    slow = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    said = run_program([sys.executable, "-c", code], env=slow, check=True).stdout.splitlines()
    with_it, without = (line.split() for line in said)
    expected = TURN * 1.5 * (1.0 - np.exp(-0.198 / LAG_S))
    assert float(with_it[1]) == pytest.approx(expected, abs=0.01)
    assert without == ["0", "0.0", "17"]


OF_OTHER_STAGES = """
from groundstation.dynamics import effects
effects.__path__.append({folder!r})
from groundstation.dynamics.registry import DELAY, EFFECTS
from groundstation.identification.body_setup import FIT_WITH
from groundstation.identification.motor.fit import EFFECTS as FITTED
assert {{"another_delay", "another_loss"}} <= set(EFFECTS)
print(DELAY, *FITTED)
"""


def test_a_listed_one_of_the_delay_or_the_motors_changes_no_other_fit(tmp_path):
    for name, stage in (("another_delay", "delay"), ("another_loss", "motor")):
        text = FILE.replace("yaw_weather_vane", name).replace('stage="body"', f'stage="{stage}"')
        (tmp_path / f"{name}.py").write_text(text.replace("    states=", "    # "))
    code = OF_OTHER_STAGES.format(folder=str(tmp_path))
    said = run_program([sys.executable, "-c", code], check=True).stdout.split()
    names = ("motor_dead_voltage", "motor_coasting", "motor_braking_asymmetry")
    assert said == ["dead_time.delay_s", *names]
