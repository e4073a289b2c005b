"""Effects are judged beside what is slow, which is followed in every model alike."""

from types import SimpleNamespace

import msgspec
import pytest

from groundstation.comparison.comparison import compare
from groundstation.discrepancy.proof import FittedRows
from groundstation.discrepancy.search import Judge, to_follow
from support.flights import base_model
from support.flights import searched as flights

BLOWN = {f"moment_{axis}": 3.0 for axis in "xyz"} | {f"force_{axis}": 0.3 for axis in "xyz"}


def model_at(point):
    """The base model, its yaw gain times a number."""
    body = msgspec.structs.replace(
        base_model().body, c2=base_model().body.c2 * point.get("c2", 1.0)
    )
    return msgspec.structs.replace(base_model(), body=body)


def looked_at(seed, effects):
    """(what is slow in stand-in flights, held-out rows of theirs)."""
    runs, held = flights(seed, effects, span_s=40.0)
    fitted = compare(runs, base_model())
    return to_follow(fitted), FittedRows(compare(held, base_model(), fitted.black_box))


@pytest.fixture(scope="module")
def blown():
    return looked_at(8, {"wind": BLOWN | {"time_s": 2.0}})


@pytest.fixture
def following(blown):
    slow, held = blown
    return Judge(held, model_at, slow)


def test_what_is_slow_is_followed(blown, following):
    found, plain = (judge({"c2": 1.0}) for judge in (following, Judge(blown[1], model_at)))
    assert found.gap < 0.8 * plain.gap
    assert not found.worse


def test_a_wrong_constant_is_worse_beside_it_too(following):
    assert 2 in following({"c2": 1.5}).worse
    assert following({"c2": 1.5}).gap > following({"c2": 1.0}).gap


def test_a_channel_within_noise_that_hardly_changes_is_no_witness(following):
    # a follower makes up for some of a wrong gain, and leaves less than what noise is taken to be
    assert following({"c2": 1.05}).gaps[2] < 1.0
    assert not following({"c2": 1.05}).worse
    assert 2 in following({"c2": 1.1}).worse


def test_what_a_name_carries_is_asked_beside_what_is_slow(following):
    """Left out, the yaw gain is the right one here, or twice it."""
    gain = SimpleNamespace(label="gain", keys=("c2",))
    name = SimpleNamespace(variant=gain, channels=(2, 8))
    assert following.weights({"c2": 1.5}, [name])["gain"].raises
    roll = SimpleNamespace(variant=gain, channels=(0,))
    assert not following.weights({"c2": 1.5}, [roll])


def test_a_doubt_beside_what_is_followed_is_none(following):
    found = [following({"c2": c2}).worse for c2 in (0.8, 0.9, 0.95, 1.05, 1.1, 1.2)]
    assert any(found)
    assert all(t >= 2.0 for worse in found for t in worse.values())


def test_a_channel_without_any_prediction_is_worse(following):
    assert following({"c2": 1e200}).worse


def test_in_still_air_nothing_is():
    slow, _ = looked_at(9, {})
    assert slow is None
