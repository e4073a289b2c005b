"""What a finding is proven by: predictions of samples that decided nothing."""

import math
from dataclasses import replace

import numpy as np
import pytest

from groundstation.discrepancy import engine
from groundstation.discrepancy.disturbances import with_disturbance
from groundstation.discrepancy.engine import find_discrepancy
from groundstation.discrepancy.proof import (
    WORSE_T,
    FittedRows,
    Reason,
    Refusal,
    Verdict,
    explained_by,
    verdict_of,
    weight,
    worse_channels,
)
from support.findings import findings
from support.flights import base_model, judged
from support.flights import searched as flights

HIDDEN = {"velocity_moment": {"moment": 12.0}}
MODELS = ("base", "given", "moved", "model")


@pytest.fixture(scope="module")
def proven():
    """What two flights with a hidden moment tell where the proof has it, has nothing of it, or is a
    flight in wind."""
    fitted, again = flights(1, HIDDEN)
    others = (
        again,
        flights(2, {}, count=0)[1],
        flights(3, {"wind": {"moment_x": 9.0}}, count=0)[1],
    )
    return [find_discrepancy([fitted], base_model(), [proof]) for proof in others]


def test_names_and_sizes_are_the_same_whatever_stands_in_the_recordings_of_the_proof(proven):
    first, *rest = (one.findings for one in proven)
    assert [effect.name for effect in first.effects] == list(HIDDEN)
    for other in rest:
        assert other.model == first.model
        assert other.given == first.given
        assert other.base_changes == first.base_changes
        for one, same in zip((*other.effects, *other.possible), first.effects, strict=True):
            assert one.name == same.name
            assert one.parameters == same.parameters
    has_it, has_not, _ = (one.proof for one in proven)
    assert has_it.after.gap < has_it.before.gap
    assert has_not.after.gap > has_not.before.gap


def test_a_name_that_the_proof_contradicts_is_possible_and_the_verdict_says_no_more(proven):
    has_it, has_not, _ = proven
    assert has_it.findings.verdict is Verdict.EFFECTS_FOUND
    found = has_not.findings
    assert found.verdict in (Verdict.UNEXPLAINED, Verdict.NO_DISCREPANCY)
    assert found.effects == ()
    (doubted,) = found.possible
    (tried,) = [one for one in found.candidates if one.name == doubted.name]
    assert tried.reason == "prediction errors of proof samples do not fall by 3 %"
    assert tried.refused_by == doubted.reason == "without_weight"
    assert not tried.accepted
    assert {term.name for term in found.moved.effects} >= {*HIDDEN}
    assert has_not.proof.explained is None


def test_nothing_of_the_recordings_of_the_proof_is_fitted_or_decides(monkeypatch):
    """Everything but the search: what it is given, and what is learnt beside it and behind it."""
    base = base_model()
    _, fitted = flights(4, count=0, span_s=9.0)
    _, proof = flights(3, {"wind": {"force_x": 1.0}}, count=0, span_s=16.0)
    nothing = replace(findings(Verdict.NO_DISCREPANCY), **dict.fromkeys(MODELS, base))
    given = []

    def search(runs, model, *, judged, **more):
        given.extend((list(runs), [one.run for one in judged.before.errors], judged.before))
        return nothing

    monkeypatch.setattr(engine, "find_effects", search)
    found = find_discrepancy([fitted], base, [proof])
    runs, predicted, before = given
    rows = [len(run) for run in fitted]
    assert [len(run) for run in runs] == [len(run) for run in predicted] == rows
    assert with_disturbance(base, found.proof.before).disturbance is not None
    assert found.findings.given == found.findings.model == base
    assert found.proof.before.black_box is before.black_box


GAPS = [
    # names, possible, fitted rows, proof rows: given and found; what is said
    (0, 0, (1.04, 1.04), (1.04, 1.04), Verdict.NO_DISCREPANCY),
    (1, 0, (4.0, 1.02), (5.0, 1.05), Verdict.EFFECTS_FOUND),
    (1, 0, (4.0, 1.02), (5.0, 1.6), Verdict.FOUND_IN_PART),
    (0, 0, (1.3, 1.01), (1.3, 1.02), Verdict.NO_DISCREPANCY),  # constants alone
    (0, 1, (1.3, 1.01), (1.3, 1.02), Verdict.UNEXPLAINED),
    (0, 0, (2.0, 1.9), (1.04, 1.04), Verdict.UNEXPLAINED),  # a gust in one flight
    (1, 0, (4.0, 3.9), (4.0, 3.85), Verdict.UNEXPLAINED),
    (0, 0, (1.05, 1.05), (1.05, 1.6), Verdict.UNEXPLAINED),
    (0, 0, (math.nan, math.nan), (math.nan, math.nan), Verdict.UNEXPLAINED),
    (1, 0, (4.0, 1.02), (math.nan, math.nan), Verdict.UNEXPLAINED),
]


@pytest.mark.parametrize(("names", "possible", "fitted", "proof", "said"), GAPS)
def test_the_verdict_is_what_gaps_on_either_samples_say(names, possible, fitted, proof, said):
    whole = findings(Verdict.EFFECTS_FOUND)
    doubted = whole.effects[0].doubted(Refusal(Reason.NOT_RECURRENT, ""))
    one = replace(whole, effects=whole.effects[:names], possible=(doubted,) * possible)
    assert verdict_of(one, fitted, proof) is said


def test_what_the_given_model_got_wrong_is_one_sum(proven):
    told = proven[0].proof.explained
    assert told.named + told.constants + told.disturbance + told.left == pytest.approx(1.0)
    assert told.named > 0.95
    assert f"named effects explain {100.0 * told.named:.0f} %" in told.words(None)


def with_errors(given, change):
    """A comparison whose errors (n, 9) of each horizon are changed in place; ``change`` is told the
    rows of one second in the middle as well."""
    errors = []
    for one in given.errors:
        horizons = [rows.copy() for rows in one.horizons]
        middle = len(horizons[0]) // 2
        for rows in horizons:
            change(rows, slice(middle, middle + round(1.0 / one.run.period_s)))
        errors.append(replace(one, horizons=tuple(horizons)))
    return replace(given, errors=tuple(errors))


def test_a_model_that_predicts_no_number_is_worse_than_any_other():
    def lost(rows, second):
        rows[:, 0] = np.nan

    assert worse_channels(judged(), with_errors(judged(), lost)) == {0: math.inf}
    assert worse_channels(judged(), judged()) == {}


@pytest.mark.parametrize(("floor", "worse"), [(1.0, {0: WORSE_T}), (1e3, {})])
def test_a_model_that_is_wrong_in_one_second_alone_is_worse_where_noise_is_less(floor, worse):
    def wrong(rows, second):
        rows[:, 0] *= 0.99
        rows[second, 0] *= 20.0
        rows[second, 1] *= 1.01

    given = judged()
    noise = (tuple(floor * rows for rows in one.horizons) for one in given.floors)
    floors = [replace(one, horizons=rows) for one, rows in zip(given.floors, noise, strict=True)]
    given = replace(given, floors=tuple(floors))
    assert worse_channels(given, with_errors(given, wrong)) == worse


def test_two_seconds_are_enough_to_see_that_a_model_is_far_worse():
    def alone(rows, second):
        kept = rows[second].copy()
        rows[:] = np.nan
        rows[second] = kept

    def far(rows, second):
        rows[:, 0] *= 20.0

    before = with_errors(judged(), alone)
    assert worse_channels(before, with_errors(before, far)) == {0: WORSE_T}


def test_what_the_seconds_add_is_the_squared_gap():
    given = judged()
    rows = FittedRows(given)
    assert np.nansum(rows.squares(given.model)) == pytest.approx(rows.judge(given.model).gap ** 2)


def test_constants_and_names_that_make_up_for_each_other_share_what_they_explain_together():
    told = explained_by(given=2.6, moved=5.0, named=5.0, both=1.0, followed=1.0)
    assert told.named == pytest.approx(0.5)
    assert told.constants == pytest.approx(0.5)
    assert told.named + told.constants + told.disturbance + told.left == pytest.approx(1.0)


def test_without_changed_constants_names_explain_all_that_went():
    told = explained_by(given=3.0, moved=3.0, named=1.5, both=1.5, followed=1.2)
    assert told.constants == 0.0
    assert told.named == pytest.approx((3.0**2 - 1.5**2) / 8.0)


def test_effects_that_predict_no_number_alone_are_weighed_behind_the_constants():
    told = explained_by(given=3.0, moved=2.0, named=np.inf, both=1.0, followed=1.0)
    assert (told.named, told.constants) == pytest.approx((3.0 / 8.0, 5.0 / 8.0))


# What a name carries in predictions, where something is left to explain.

GIVEN_GAP = 3.0
SECONDS = 50


def rows(*squares):
    """Squared errors over noise by second of three channels whose mean squares these are; the
    other six are not there."""
    scatter = 1.0 + 0.1 * np.random.default_rng(1).standard_normal((SECONDS, 3))
    scatter /= scatter.mean(axis=0)
    found = np.full((SECONDS, 9), np.nan)
    found[:, :3] = scatter * np.array(squares) / (3.0 * SECONDS)
    return found


def test_a_name_that_a_channel_needs_carries_that_share_of_it():
    found = weight(GIVEN_GAP, rows(1.0, 1.0, 1.0), rows(5.0, 1.0, 1.0), (0, 1))
    assert found.most == pytest.approx(1.0)
    assert found.share == pytest.approx((4.0 / 3.0) / (GIVEN_GAP**2 - 1.0))
    assert found.is_carried
    assert not found.raises


def test_one_that_takes_less_than_a_fiftieth_of_what_its_channels_are_left_with_is_not_carried():
    assert not weight(GIVEN_GAP, rows(5.0, 1.0, 1.0), rows(5.05, 1.0, 1.0), (0, 1)).is_carried
    assert weight(GIVEN_GAP, rows(5.0, 1.0, 1.0), rows(5.2, 1.0, 1.0), (0, 1)).is_carried


def test_one_without_which_all_channels_together_are_predicted_better_raises_the_gap():
    found = weight(GIVEN_GAP, rows(2.0, 4.0, 1.0), rows(3.0, 1.0, 1.0), (0, 1))
    assert found.most > 0.4
    assert not found.is_carried
    assert found.raises


def test_where_its_channels_are_within_noise_it_is_not_asked():
    """Another channel is far beyond noise, which is none of its business."""
    assert weight(GIVEN_GAP, rows(1.0, 9.0, 1.0), rows(1.1, 9.0, 1.0), (0, 2)) is None
    assert weight(GIVEN_GAP, rows(1.0, 9.0, 1.0), rows(1.1, 9.0, 1.0), (0, 1)) is not None


def test_a_doubt_within_what_seconds_scatter_raises_nothing():
    noisy = rows(2.0, 2.0, 2.0)
    noisy[:, 0] *= np.where(np.arange(SECONDS) % 2, 1.9, 0.11)
    found = weight(GIVEN_GAP, noisy, rows(2.0, 2.0, 2.0), (0,))
    assert found.share < 0.0
    assert not found.raises
