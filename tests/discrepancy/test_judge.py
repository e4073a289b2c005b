"""Effects are judged beside what is slow, which is followed in every model alike."""

import msgspec
import pytest
from searched_flights import base_model, flights

from groundstation.comparison.comparison import compare
from groundstation.discrepancy.judge import Judge
from groundstation.discrepancy.proof import HeldOut, Predictions

BLOWN = {f"moment_{axis}": 3.0 for axis in "xyz"} | {f"force_{axis}": 0.3 for axis in "xyz"}


def model_at(point):
    """The base model, its yaw gain times a number."""
    body = msgspec.structs.replace(base_model().body, c2=base_model().body.c2 * point["c2"])
    return msgspec.structs.replace(base_model(), body=body)


def judges(seed, effects):
    """(one that follows what is slow, one that does not) of the same stand-in flights."""
    runs, held = flights(seed, effects)
    train = Predictions(compare(runs, base_model()))
    judged = HeldOut(compare(held, base_model(), train.before.black_box))
    found = Judge(judged, model_at, train), Judge(judged, model_at, None)
    for one in found:
        one.follow({"c2": 1.0})
    return found


@pytest.fixture(scope="module")
def blown():
    return judges(8, {"wind": BLOWN | {"time_s": 2.0}})


def test_what_is_slow_is_followed(blown):
    following, plain = (judge({"c2": 1.0}) for judge in blown)
    assert following.gap < 0.8 * plain.gap
    assert not following.worse


def test_a_wrong_constant_is_worse_beside_it_too(blown):
    following, _ = blown
    assert 2 in following({"c2": 1.5}).worse
    assert following.raises_plainly({"c2": 1.0}, {"c2": 1.5})
    assert not following.raises_plainly({"c2": 1.5}, {"c2": 1.0})
    assert following({"c2": 1.5}).gap > following({"c2": 1.0}).gap


def test_in_still_air_nothing_is():
    following, plain = (judge({"c2": 1.0}) for judge in judges(9, {}))
    assert following.gap == plain.gap
