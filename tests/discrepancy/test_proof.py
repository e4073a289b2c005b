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
    Verdict,
    explained_by,
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
        fitted = (*other.effects, *other.possible)
        for one, same in zip(fitted, first.effects, strict=True):
            assert one.name == same.name
            assert one.parameters == same.parameters
            assert one.evidence == same.evidence
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
    assert doubted.refused.words == "prediction errors of proof samples do not fall by 3 %"
    assert [one.accepted for one in found.candidates if one.name == doubted.name] == [False]
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


def test_what_the_given_model_got_wrong_is_one_sum(proven):
    told = proven[0].proof.explained
    assert told.named + told.constants + told.disturbance + told.left == pytest.approx(1.0)
    assert told.named > 0.95
    assert f"named effects explain {100.0 * told.named:.0f} %" in told.words(None)


def test_a_model_that_predicts_no_number_is_worse_than_any_other():
    given = judged()
    errors = []
    for one in given.errors:
        horizons = [rows.copy() for rows in one.horizons]
        for rows in horizons:
            rows[:, 0] = np.nan
        errors.append(replace(one, horizons=tuple(horizons)))
    assert worse_channels(given, replace(given, errors=tuple(errors))) == {0: math.inf}
    assert worse_channels(given, given) == {}


@pytest.mark.parametrize(("floor", "worse"), [(1.0, {0: WORSE_T}), (1e3, {})])
def test_a_model_that_is_wrong_in_one_second_alone_is_worse_where_noise_is_less(floor, worse):
    given = judged()
    noise = (tuple(floor * rows for rows in one.horizons) for one in given.floors)
    floors = [replace(one, horizons=rows) for one, rows in zip(given.floors, noise, strict=True)]
    given = replace(given, floors=tuple(floors))
    errors = []
    for one in given.errors:
        horizons = [rows.copy() for rows in one.horizons]
        middle, second = len(horizons[0]) // 2, round(1.0 / one.run.period_s)
        for rows in horizons:
            rows[:, 0] *= 0.99
            rows[middle : middle + second, 0] *= 20.0
            rows[middle : middle + second, 1] *= 1.01
        errors.append(replace(one, horizons=tuple(horizons)))
    found = worse_channels(given, replace(given, errors=tuple(errors)))
    assert found == worse


def test_two_seconds_are_enough_to_see_that_a_model_is_far_worse():
    given = judged()
    parts = {1.0: [], 20.0: []}
    for one in given.errors:
        middle, second = len(one.horizons[0]) // 2, round(1.0 / one.run.period_s)
        for factor, found in parts.items():
            horizons = [np.full_like(rows, np.nan) for rows in one.horizons]
            for rows, all_rows in zip(horizons, one.horizons, strict=True):
                rows[middle : middle + second] = all_rows[middle : middle + second]
                rows[:, 0] *= factor
            found.append(replace(one, horizons=tuple(horizons)))
    before, after = (replace(given, errors=tuple(errors)) for errors in parts.values())
    assert worse_channels(before, after) == {0: WORSE_T}


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
