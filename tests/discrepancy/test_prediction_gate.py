"""What was found has to predict fitted samples, or it is taken back; base constants alike."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from groundstation.comparison.channels import CHANNELS
from groundstation.discrepancy.findings import Predicted, Reason
from groundstation.discrepancy.prediction_gate import answer_to_predictions


@dataclass
class Effect:
    """As much of an accepted effect as the gate asks for."""

    label: str
    channels: tuple[int, ...]

    @property
    def variant(self):
        return self

    @property
    def evidence(self):
        return self


@dataclass
class Hunt:
    """A search of two effects and two constants; a point is the set of names that are in it."""

    accepted: list
    groups: tuple = (("c0",), ("c2",))
    held: set = field(default_factory=set)
    refused: dict = field(default_factory=dict)
    progress: object = print
    raises_plainly: object = lambda before, after: True

    def point_with(self, accepted, held=None):
        moved = {group[0] for group in self.groups} - (self.held if held is None else set(held))
        return {one.label for one in accepted} | moved

    def refit(self, accepted, held):
        return SimpleNamespace(point=self.point_with(accepted, held))


def judged(gaps, worse):
    """A judge: gap 2 less what each name brings; worse where a name makes a channel worse."""

    def judge(point):
        bad = {c: t for name, c, t in worse if name in point}
        return Predicted(2.0 - sum(gaps.get(name, 0.0) for name in point), bad)

    return judge


@pytest.fixture
def hunt():
    made = Hunt([Effect("drag", (3,)), Effect("bias", (3, 4))])
    made.now = made.refit(made.accepted, made.held)
    return made


def test_what_predicts_better_stays(hunt):
    assert not answer_to_predictions(hunt, judged({"drag": 0.5, "bias": 0.2}, []))
    assert [one.label for one in hunt.accepted] == ["drag", "bias"]
    assert not hunt.held


def test_an_effect_that_raises_the_gap_is_taken_back(hunt):
    assert answer_to_predictions(hunt, judged({"drag": 0.5, "bias": -0.3}, []))
    assert [one.label for one in hunt.accepted] == ["drag"]
    assert hunt.refused["bias"].reason is Reason.PREDICTS_WORSE
    assert "predicted better without it: the gap of 1.80 falls by 16.7 %" in (
        hunt.refused["bias"].words
    )


def test_one_that_raises_it_only_beside_what_is_slow_stays(hunt):
    hunt.raises_plainly = lambda before, after: False
    assert not answer_to_predictions(hunt, judged({"drag": 0.5, "bias": -0.3}, []))
    assert [one.label for one in hunt.accepted] == ["drag", "bias"]


def test_a_gap_that_falls_by_less_than_seconds_scatter_takes_nothing_out(hunt):
    def judge(point):
        more = 0.05 if "bias" in point else 0.0
        seconds = np.array([1.0, 3.0, 0.5, 2.0])
        scatter = more * np.array([20.0, -18.0, 15.0, -13.0])
        return Predicted(2.0 + more, {}, blocks=tuple(seconds + more + scatter))

    assert not answer_to_predictions(hunt, judge)
    assert [one.label for one in hunt.accepted] == ["drag", "bias"]


def test_a_constant_that_spoils_a_channel_is_given_back_and_no_effect_blamed(hunt):
    yaw = CHANNELS.index("gyro_z")
    assert answer_to_predictions(hunt, judged({"drag": 0.5}, [("c2", yaw, 9.0)]))
    assert hunt.held == {"c2"}
    assert [one.label for one in hunt.accepted] == ["drag", "bias"]


def test_what_spoils_a_channel_that_it_hardly_touches_is_found_and_none_blamed_that_is_right(hunt):
    hunt.accepted = [Effect("inertia_coupling", (0, 1)), Effect("gyro_low_pass", (6, 7))]
    judge = judged({"inertia_coupling": 0.1, "gyro_low_pass": 0.3}, [("gyro_low_pass", 0, 3.0)])
    hunt.now = hunt.refit(hunt.accepted, hunt.held)
    assert answer_to_predictions(hunt, judge)
    assert [one.label for one in hunt.accepted] == ["inertia_coupling"]
    assert not hunt.held


def test_what_leaves_before_a_channel_is_right_again_is_told_as_no_more_than_the_best_way(hunt):
    """Only without both culprits nothing is spoilt."""
    hunt.accepted.append(Effect("lag", (3,)))
    hunt.now = hunt.refit(hunt.accepted, hunt.held)
    spoilt = judged({"drag": 0.5}, [("bias", 3, 4.0), ("lag", 3, 3.0)])

    def judge(point):
        found = spoilt(point)
        both = 4.0 * ("bias" in point) + 3.0 * ("lag" in point)
        return Predicted(found.gap, {3: both} if both else {})

    assert answer_to_predictions(hunt, judge)
    assert [one.label for one in hunt.accepted] == ["drag"]
    assert "costs the least to take out" in hunt.refused["bias"].words
    assert "predicts accelerometer_x on fitted samples worse" in hunt.refused["lag"].words


def test_where_nothing_helps_the_given_model_is_what_remains(hunt):
    everything = [(name, c, 5.0) for c, name in enumerate(["drag", "bias", "c0", "c2"])]
    answer_to_predictions(hunt, judged({}, everything))
    assert "worse than the given model" in hunt.refused["drag"].words
    assert hunt.now.point == set()
    assert not hunt.accepted
    assert hunt.held == {"c0", "c2"}
