"""What was found has to predict fitted samples, or it is taken back; base constants alike."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest

from groundstation.comparison.gap import CHANNELS
from groundstation.discrepancy.proof import Predicted, Reason, Weight
from groundstation.discrepancy.search import answer_to_predictions


@dataclass
class Effect:
    """As much of an accepted effect as the gate asks for."""

    label: str
    channels: tuple[int, ...]

    @property
    def variant(self):
        return self


@dataclass
class Hunt:
    """A search of two effects and two constants; a point is the set of names that are in it."""

    accepted: list
    groups: tuple = (("c0",), ("c2",))
    held: set = field(default_factory=set)
    refused: dict = field(default_factory=dict)
    progress: object = print
    weights: dict = field(default_factory=dict)

    def point_with(self, accepted, held=None):
        moved = {group[0] for group in self.groups} - (self.held if held is None else set(held))
        return {one.label for one in accepted} | moved

    def refit(self, accepted, held, rough=False):
        return SimpleNamespace(point=self.point_with(accepted, held))


class Judge:
    """Gap 2 less what each name brings, by how much that scatters with seconds; worse where a name
    makes a channel worse."""

    def __init__(self, gaps, worse, scatter=0.0):
        self.gaps, self.worse, self.scatter = gaps, worse, scatter

    def __call__(self, point):
        bad = {c: t for name, c, t in self.worse if name in point}
        return Predicted(2.0 - sum(self.gaps.get(name, 0.0) for name in point), bad)

    def weights(self, point, accepted):
        return {
            one.label: Weight(self.gaps.get(one.label, 0.0), self.scatter, 1.0) for one in accepted
        }


@pytest.fixture
def hunt():
    made = Hunt([Effect("drag", (3,)), Effect("bias", (3, 4))])
    made.now = made.refit(made.accepted, made.held)
    return made


def test_what_predicts_better_stays(hunt):
    assert not answer_to_predictions(hunt, Judge({"drag": 0.5, "bias": 0.2}, []))
    assert [one.label for one in hunt.accepted] == ["drag", "bias"]
    assert not hunt.held
    assert hunt.weights["drag"].share == 0.5


def test_an_effect_that_raises_the_gap_is_taken_back(hunt):
    assert answer_to_predictions(hunt, Judge({"drag": 0.5, "bias": -0.3}, []))
    assert [one.label for one in hunt.accepted] == ["drag"]
    assert hunt.refused["bias"].reason is Reason.PREDICTS_WORSE
    assert "predicted better without it: the gap of 1.80 falls by 16.7 %" in (
        hunt.refused["bias"].words
    )


def test_one_that_raises_it_by_less_than_seconds_scatter_stays(hunt):
    assert not answer_to_predictions(hunt, Judge({"drag": 0.5, "bias": -0.3}, [], scatter=0.4))
    assert [one.label for one in hunt.accepted] == ["drag", "bias"]


def test_one_that_raises_it_stays_where_a_channel_is_worse_without_it(hunt):
    class Needed(Judge):
        def __call__(self, point):
            found = super().__call__(point)
            return found if "bias" in point else Predicted(found.gap, {3: 2.0})

    assert not answer_to_predictions(hunt, Needed({"drag": 0.5, "bias": -0.3}, []))
    assert [one.label for one in hunt.accepted] == ["drag", "bias"]


def test_a_constant_that_spoils_a_channel_is_given_back_and_no_effect_blamed(hunt):
    yaw = CHANNELS.index("gyro_z")
    assert answer_to_predictions(hunt, Judge({"drag": 0.5}, [("c2", yaw, 9.0)]))
    assert hunt.held == {"c2"}
    assert [one.label for one in hunt.accepted] == ["drag", "bias"]


def test_what_spoils_a_channel_that_it_hardly_touches_is_found_and_none_blamed_that_is_right(hunt):
    hunt.accepted = [Effect("inertia_coupling", (0, 1)), Effect("gyro_low_pass", (6, 7))]
    judge = Judge({"inertia_coupling": 0.1, "gyro_low_pass": 0.3}, [("gyro_low_pass", 0, 3.0)])
    hunt.now = hunt.refit(hunt.accepted, hunt.held)
    assert answer_to_predictions(hunt, judge)
    assert [one.label for one in hunt.accepted] == ["inertia_coupling"]
    assert not hunt.held


def test_what_leaves_before_a_channel_is_right_again_is_told_as_no_more_than_the_best_way(hunt):
    """Only without both culprits nothing is spoilt."""
    hunt.accepted.append(Effect("lag", (3,)))
    hunt.now = hunt.refit(hunt.accepted, hunt.held)

    class Spoilt(Judge):
        def __call__(self, point):
            both = 4.0 * ("bias" in point) + 3.0 * ("lag" in point)
            return Predicted(super().__call__(point).gap, {3: both} if both else {})

    assert answer_to_predictions(hunt, Spoilt({"drag": 0.5}, []))
    assert [one.label for one in hunt.accepted] == ["drag"]
    assert "costs the least to take out" in hunt.refused["bias"].words
    assert "predicts accelerometer_x on fitted samples worse" in hunt.refused["lag"].words


def test_where_nothing_helps_the_given_model_is_what_remains(hunt):
    everything = [(name, c, 5.0) for c, name in enumerate(["drag", "bias", "c0", "c2"])]
    answer_to_predictions(hunt, Judge({}, everything))
    assert "worse than the given model" in hunt.refused["drag"].words
    assert hunt.now.point == set()
    assert not hunt.accepted
    assert hunt.held == {"c0", "c2"}
