"""A user's own effect: from a file into the model, the simulation and the stand-in."""

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.craft import craft_of_model, load_effects
from groundstation.dynamics.model import EffectTerm, Estimate, load_model, save_model
from groundstation.dynamics.simulation import accelerations, craft_state, simulate, specific_force
from groundstation.errors import BadInputError
from groundstation.identification.runs import runs_of
from groundstation.prediction.prediction import predict_ahead
from support.flights import BASE, CARRYING_GAINS, recorded, truth_of

FILE = '''
from groundstation.dynamics.effect import Effect, Parameter

def spring(values, craft, body):
    """A loose battery: roll answers its rate cubed, and the mean rotor pushes forward."""
    m1, m2, m3, m4 = body.rotor
    roll = -values[0] * body.rate[0] ** 3
    return (roll, 0.0, 0.0), (values[1] * (m1 + m2 + m3 + m4) / 1000.0, 0.0, 0.0)

def kick(values, craft, body):
    yaw = values[0] * (body.rotor_slope[0] + body.rotor_slope[2])
    return (0.0, 0.0, yaw), (0.0, 0.0, 0.0)

LOOSE = Effect(
    "loose_battery", "body",
    (Parameter("cubic", "s/rad^2", 5.0, 0.1, 50.0), Parameter("push", "m/s^2", 0.5, -5.0, 5.0)),
    "-cubic p^3 on roll", "large rolls stop by themselves", "large roll doublets", ("gyro x",),
    law=spring,
)
KICK = Effect(
    "kick", "body", (Parameter("size", "", 0.001, 0.0, 1.0),),
    "yaw from two rotors", "yaw", "yaw steps", ("gyro z",), law=kick,
)
'''


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(FILE)
    return path


def with_own(source, *terms):
    effects = tuple(
        EffectTerm(name, {k: Estimate(v) for k, v in values.items()}, str(source))
        for name, values in terms
    )
    return msgspec.structs.replace(BASE, effects=effects)


def test_a_file_defines_effects_by_name(source):
    effects = load_effects(source)
    assert set(effects) == {"loose_battery", "kick"}
    assert effects["loose_battery"].values({})["cubic"] == 5.0


def test_a_model_file_finds_the_source_beside_it(source, tmp_path):
    model = with_own("mine.py", ("loose_battery", {"cubic": 4.0}))
    save_model(model, tmp_path / "model.json")
    (term,) = load_model(tmp_path / "model.json").effects
    assert term.source == str(source)


def test_its_law_acts_in_the_simulation(source):
    model = with_own(source, ("loose_battery", {"cubic": 5.0, "push": 0.5}))
    start = craft_state(rates=(3.0, 0.0, 0.0), rotor_rev_s=250.0)
    voltage = np.full((2, 4), BASE.motor.armature_mv(250.0))
    (first, second, _) = simulate(craft_of_model(model), start, voltage, period_s=1e-4)
    assert (second[10] - first[10]) / 1e-4 == pytest.approx(-5.0 * 27.0, rel=0.02)
    assert specific_force(craft_of_model(model), start)[0] == pytest.approx(0.5)


def test_several_laws_act_together_each_on_its_own_values(source):
    model = with_own(
        source, ("loose_battery", {"cubic": 2.0, "push": 0.0}), ("kick", {"size": 0.01})
    )
    start = craft_state(rates=(2.0, 0.0, 0.0), rotor_rev_s=250.0)
    hover = BASE.motor.armature_mv(250.0)
    voltage = np.array([[hover + 100, hover, hover, hover]])
    base = simulate(craft_of_model(BASE), start, voltage, period_s=1e-4)
    own = simulate(craft_of_model(model), start, voltage, period_s=1e-4)
    change = (own[1, 10:13] - base[1, 10:13]) / 1e-4
    assert change[0] == pytest.approx(-2.0 * 8.0, rel=0.02)
    assert change[2] == pytest.approx(0.01 * 100 * BASE.motor.a0, rel=0.02)


def test_its_acceleration_is_at_hand_row_by_row(source):
    states = np.stack([craft_state(rates=(p, 0.0, 0.0)) for p in (1.0, 2.0, -1.0)])
    craft = craft_of_model(with_own(source, ("loose_battery", {"cubic": 2.0, "push": 0.0})))
    np.testing.assert_allclose(accelerations(craft, states)[:, 0], [-2.0, -16.0, 2.0])


def test_two_weak_rotors_act_both():
    weak = tuple(
        EffectTerm("rotor_mismatch", {"rotor": Estimate(i), "excess": Estimate(-0.1)})
        for i in (1.0, 3.0)
    )
    craft, state = craft_of_model(BASE), craft_state(rotor_rev_s=250.0)
    both = craft_of_model(msgspec.structs.replace(BASE, effects=weak))
    expected = 0.95 * specific_force(craft, state)[2]
    assert specific_force(both, state)[2] == pytest.approx(expected)


def test_the_stand_in_flies_it_and_the_model_predicts_the_flight(source, tmp_path):
    model = with_own(source, ("loose_battery", {"cubic": 60.0, "push": 0.4}))
    path = tmp_path / "model.json"
    save_model(model, path)
    settings = {
        "plant": "reduced",
        "gains": CARRYING_GAINS,
        "torque_noise": 0.0,
        "sensor_noise": 0.0,
    }
    samples, truth = recorded(30.0, seed=4, craft=str(path), **settings)
    plain, _ = recorded(30.0, seed=4, **settings)
    assert not np.array_equal(samples.gyro, plain.gyro)
    (run,) = runs_of(samples)
    assert np.abs(truth_of(samples, truth)["rate_rad_s"][:, 0]).max() > 0.5
    with_law = np.abs(predict_ahead(model, run).errors(run)[:, 1])
    without = np.abs(predict_ahead(BASE, run).errors(run)[:, 1])
    assert with_law[:, 0].max() < 0.1 * without[:, 0].max()
    assert with_law[:, 3].mean() < 0.1 * without[:, 3].mean()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("x = 1", "defines no Effect"),
        ("raise RuntimeError('oops')", "RuntimeError: oops"),
        (FILE.replace('"kick", "body"', '"dead_time", "body"'), "dead_time is built in"),
        (FILE.replace("law=kick", "law=None"), "kick has no law"),
        (FILE.replace("values[0] * (body", "unknown * (body"), "cannot be compiled"),
    ],
    ids=["no effect", "it fails", "a listed name", "no law", "does not compile"],
)
def test_a_file_that_cannot_be_used_is_refused_with_the_reason(tmp_path, text, reason):
    path = tmp_path / "bad.py"
    path.write_text(text)
    with pytest.raises(BadInputError, match=reason):
        load_effects(path)


def test_a_file_that_is_not_there_is_refused():
    with pytest.raises(BadInputError, match="no such file"):
        load_effects("nowhere.py")


def test_an_effect_the_file_does_not_define_is_refused(source):
    model = with_own(source, ("tight_battery", {}))
    with pytest.raises(BadInputError, match=r"there are in .*mine\.py loose_battery, kick"):
        craft_of_model(model)


def test_an_unknown_effect_without_a_source_is_refused_on_reading(tmp_path):
    path = tmp_path / "model.json"
    path.write_bytes(msgspec.json.encode(with_own("", ("warp", {}))))
    with pytest.raises(BadInputError, match="needs the file that defines it as 'source'"):
        load_model(path)
