"""Manoeuvres are chosen by what they add to what is known."""

import numpy as np
import pytest

from groundstation.learn.planning import Information, choose

SECONDS = {"roll": 6.0, "yaw": 6.0, "both": 12.0}


@pytest.fixture
def told():
    """Of two numbers: roll tells the first, yaw the second, both half of each and longer."""
    parts = {"roll": np.diag([8.0, 0.0]), "yaw": np.diag([0.0, 2.0]), "both": np.diag([4.0, 1.0])}
    return Information(("a", "b"), np.eye(2), parts)


def test_the_first_is_what_tells_most_and_the_next_what_is_then_open(told):
    chosen = choose(told, SECONDS, budget_s=12.0)
    assert [one.name for one in chosen] == ["roll", "yaw"]
    assert chosen[0].tells[0] == "a"
    assert chosen[1].tells[0] == "b"
    assert chosen[0].gain == pytest.approx(0.5 * np.log(9.0))


def test_what_was_flown_before_is_not_flown_for_again(told):
    chosen = choose(told, SECONDS, budget_s=6.0, flown=["roll", "roll"])
    assert [one.name for one in chosen] == ["yaw"]


def test_what_is_flown_again_tells_less_each_time(told):
    gains = [told.gain(["roll"] * times, "roll") for times in range(4)]
    assert gains == sorted(gains, reverse=True)


def test_nothing_is_planned_that_gains_less_than_what_is_asked_for(told):
    assert choose(told, SECONDS, budget_s=1e9, least=10.0) == []
    longest = choose(told, SECONDS, budget_s=1e9)
    assert 2 < len(longest) < 100


def test_errors_are_those_of_everything_fitted_together(told):
    assert told.errors([]) == pytest.approx({"a": 1.0, "b": 1.0})
    assert told.errors(["roll", "both"]) == pytest.approx({"a": 13.0**-0.5, "b": 2.0**-0.5})
