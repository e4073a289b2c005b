"""The model file."""

from __future__ import annotations

import json

import msgspec
import pytest

from groundstation.dynamics.model import (
    THESIS,
    BodyConstants,
    EffectTerm,
    Estimate,
    Model,
    load_model,
    model_vehicle,
    rotor_motors,
    save_model,
    vehicle_model,
    with_motor,
)
from groundstation.dynamics.vehicle import MotorConstants, load_vehicle, mean_motor, moved_motors
from groundstation.errors import BadInputError


def test_the_built_in_model_has_the_printed_numbers():
    model = load_model("thesis")
    assert (model.motor.a0, model.motor.a1, model.motor.a2) == (0.862446, 6.814507, 0.006149)
    assert model.body is not None
    assert (model.body.c0, model.body.c1, model.body.c2) == (0.0136, 0.0136, 0.0005)
    assert model.arx is not None
    assert model.arx["roll"].a == (-1.959, 0.9567)
    assert model.arx["yaw"].b == (1.382e-9,)
    assert {axis.nk for axis in model.arx.values()} == {8}


def test_a_model_survives_its_file(tmp_path):
    path = tmp_path / "model.json"
    drag = EffectTerm("rotor_drag", {"drag_n_s_m": Estimate(0.01, 0.001, "N s/m")})
    model = msgspec.structs.replace(THESIS, effects=(drag,), fit={"samples": 4000})
    save_model(model, path)
    assert load_model(path) == model


def test_the_file_has_the_layout_others_read(tmp_path):
    path = tmp_path / "model.json"
    save_model(THESIS, path)
    document = json.loads(path.read_text())
    assert document["schema_version"] == 1
    assert document["vehicle"] == "crazyflie1"
    assert set(document["motor"]) == {"a0", "a1", "a2"}
    assert set(document["body"]) == {"c0", "c1", "c2", "thrust_per_mass"}
    assert set(document["arx"]["roll"]) == {"na", "nb", "nk", "a", "b", "ts"}
    assert {"effects", "fit", "created_by"} <= set(document)


def test_a_profile_as_a_model_predicts_hover():
    vehicle = load_vehicle("crazyflie21")
    model = vehicle_model(vehicle)
    assert model_vehicle(model) == vehicle
    assert model.body is not None
    assert model.body.thrust_per_mass * vehicle.mass_kg == pytest.approx(vehicle.thrust_n)


def test_a_model_for_a_built_in_craft_needs_no_embedded_profile():
    assert model_vehicle(THESIS) == load_vehicle("crazyflie1")


ABSURD = {"name": "velocity_moment", "parameters": {"moment": {"value": 1e12}}}
WEIGHTLESS = {**msgspec.to_builtins(load_vehicle("crazyflie1")), "mass_kg": 0.0}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema_version": 7}, "schema_version 7"),
        ({"motor": {"a0": 1.0, "a1": 2.0}}, r"a2.*\$\.motor"),
        ({"motor": {"a0": -1.0, "a1": 2.0, "a2": 0.0}}, "motor.a0 is -1.0"),
        ({"motor": {"a0": 1.0, "a1": 2.0, "a2": -1e-4}}, "motor.a2 is -0.0001"),
        ({"wind": 3}, "wind"),
        ({"vehicle_profile": WEIGHTLESS}, "vehicle_profile: mass_kg is 0.0, must be positive"),
        ({"body": None, "arx": None}, "nothing to simulate"),
        ({"effects": [ABSURD]}, r"velocity_moment: moment is 1e\+12 .* a craft has -80..80"),
    ],
)
def test_a_bad_model_is_refused_with_its_reason(tmp_path, change, message):
    path = tmp_path / "model.json"
    path.write_text(json.dumps({**msgspec.to_builtins(THESIS), **change}))
    with pytest.raises(BadInputError, match=message):
        load_model(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "not a model file"), (b"\xff\xfe", "not a model file"), (None, "no such file")],
)
def test_what_is_no_model_at_all_is_refused(tmp_path, content, message):
    path = tmp_path / "model.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BadInputError, match=message):
        load_model(path)


def test_a_model_that_cannot_be_simulated_is_not_written(tmp_path):
    path = tmp_path / "model.json"
    nan = BodyConstants(float("nan"), 1.0, 1.0, 1.0)
    with pytest.raises(BadInputError, match=r"body\.c0 is nan"):
        save_model(Model(vehicle="crazyflie1", motor=THESIS.motor, body=nan), path)
    assert not path.exists()


def four_motors():
    motors = tuple(MotorConstants(0.8 + 0.1 * i, 6.0 + i, 0.002 * i) for i in range(4))
    return msgspec.structs.replace(THESIS, motor=mean_motor(motors), motors=motors)


def test_a_model_holds_each_rotor_s_motor_or_one_for_all(tmp_path):
    model = four_motors()
    save_model(model, tmp_path / "four.json")
    assert load_model(tmp_path / "four.json") == model
    assert rotor_motors(model) == model.motors
    assert rotor_motors(THESIS) == (THESIS.motor,) * 4


def test_four_motors_follow_their_mean():
    model = four_motors()
    mean = MotorConstants(2 * model.motor.a0, model.motor.a1, model.motor.a2 + 0.001)
    moved = with_motor(model, mean)
    assert moved.motor == mean
    assert mean_motor(moved.motors).a2 == pytest.approx(mean.a2)
    assert moved.motors[3].a0 == pytest.approx(2 * model.motors[3].a0)
    assert with_motor(THESIS, mean).motors is None
    first_order = msgspec.structs.replace(mean, a2=0.0)
    assert {one.a2 for one in moved_motors((first_order,) * 4, mean)} == {mean.a2}


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda d: d["motors"].pop(), "length 4"),
        (lambda d: d["motors"][1].update(a1=-1.0), r"motors\[1\].a1 is -1.0, must be positive"),
        (lambda d: d["motor"].update(a0=0.5), "the mean of motors is 0.95"),
    ],
)
def test_motors_that_cannot_be_are_refused(tmp_path, change, complaint):
    path = tmp_path / "model.json"
    save_model(four_motors(), path)
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    with pytest.raises(BadInputError, match=complaint):
        load_model(path)


def test_a_model_is_a_readable_line_with_its_effects_and_their_errors():
    lag = EffectTerm("dead_time", {"delay_s": Estimate(0.0033, 1e-4, "s")})
    text = repr(msgspec.structs.replace(load_model("thesis"), effects=(lag,)))
    assert text.startswith("Model(crazyflie1: motor a0 0.8624, a1 6.815")
    assert "dead_time delay_s 0.0033 ± 0.0001 s" in text
    assert len(text) < 300
