"""The numbers that are estimated of an effect, and the way back to its parameters."""

import math

import pytest

from groundstation.dynamics.effect import to_point, to_stderr, to_values, variants
from groundstation.dynamics.registry import EFFECTS

EVERY = pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda effect: effect.name)


@EVERY
def test_parameters_come_back_from_the_point_they_make(effect):
    given = effect.values({p.name: p.low for p in effect.parameters})
    point = to_point(effect, given)
    keys = next(keys for keys in variants(effect) if keys[0].key in point)
    assert to_values(keys, point) == pytest.approx(given, rel=1e-12)


@EVERY
def test_every_unknown_is_absent_within_its_bounds_and_has_a_size_worth_finding(effect):
    for keys in variants(effect):
        for one in keys:
            low, high = one.bounds
            assert low <= one.absent <= high
            assert one.worth > 0.0
            assert one.step > 0.0
            assert one.plausible[0] < one.plausible[1]
        assert effect.absent(to_values(keys, {}))


def test_a_low_pass_is_estimated_as_a_time_constant_and_its_error_goes_along():
    (keys,) = variants(EFFECTS["gyro_low_pass"])
    assert to_point(EFFECTS["gyro_low_pass"], {"bandwidth_hz": 0.0}) == {keys[0].key: 0.0}
    point = {keys[0].key: 0.005}
    hertz = to_values(keys, point)["bandwidth_hz"]
    assert hertz == pytest.approx(1.0 / (2.0 * math.pi * 0.005))
    error = to_stderr(keys, point, {keys[0].key: 0.0005})["bandwidth_hz"]
    assert error == pytest.approx(0.1 * hertz, rel=1e-2)


def test_a_mismatched_rotor_is_four_unknowns_of_which_a_model_names_one():
    effect = EFFECTS["rotor_mismatch"]
    assert [keys[0].key for keys in variants(effect)] == [
        f"rotor_mismatch.{i}" for i in range(1, 5)
    ]
    assert to_values(variants(effect)[2], {"rotor_mismatch.3": 0.1}) == {
        "rotor": 3.0,
        "excess": 0.1,
    }


def test_the_error_of_a_ground_effect_holds_the_heights_too():
    (keys,) = variants(EFFECTS["ground_effect"])
    point = {"ground_effect.gain": 0.3, "ground_effect.height_m": 0.1}
    found = to_stderr(keys, point, dict.fromkeys(point, 0.0))
    assert found == pytest.approx({"gain": 0.3 * 0.03 / 0.1, "height_m": 0.02})
