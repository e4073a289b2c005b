"""Constants that went far are searched once more as they were given, and predictions choose."""

from dataclasses import replace

import msgspec
import pytest
from compared_flights import flights, judged

from groundstation.comparison.comparison import compare
from groundstation.discrepancy.engine import find_effects
from groundstation.discrepancy.findings import BaseChange
from groundstation.discrepancy.proof import FittedRows
from groundstation.discrepancy.second_way import ROTATION, better, or_with_given_constants


@pytest.fixture(scope="module")
def nothing_missing():
    return find_effects(flights(1), judged().model)


def with_c0(findings, share):
    """The findings of a search that took c0 to so much of what it was."""
    given = findings.model.body.c0
    body = msgspec.structs.replace(findings.model.body, c0=share * given)
    change = BaseChange("c0", given, share * given, None, 100.0 * (share - 1.0))
    model = msgspec.structs.replace(findings.model, body=body)
    return replace(findings, model=model, base_changes=(change,))


def searched(free, steady):
    """(what a search of these two ends with, the constants that stayed in each)"""
    asked = []

    def found(held):
        asked.append(tuple(held))
        return steady if held else free

    end = or_with_given_constants(found, FittedRows(judged()), lambda what, share: None)
    return end, asked


def test_half_of_a_gain_is_not_kept_where_the_one_given_predicts_better(nothing_missing):
    end, asked = searched(with_c0(nothing_missing, 0.5), nothing_missing)
    assert end is nothing_missing
    assert asked == [(), tuple(ROTATION)]


def test_a_gain_that_was_given_wrong_is_found_all_the_same(nothing_missing):
    """Half of it was given: what keeps that predicts worse."""
    true = nothing_missing.model.body.c0
    change = BaseChange("c0", 0.5 * true, true, None, 100.0)
    right = replace(nothing_missing, base_changes=(change,))
    end, asked = searched(right, with_c0(nothing_missing, 0.5))
    assert end is right
    assert len(asked) == 2


def test_small_changes_are_not_searched_again(nothing_missing):
    free = with_c0(nothing_missing, 0.9)
    end, asked = searched(free, nothing_missing)
    assert end is free
    assert asked == [()]


def test_what_is_only_as_good_does_not_take_the_place_of_what_was_free(nothing_missing):
    held = FittedRows(judged())
    free = with_c0(nothing_missing, 1.0001)
    assert better(free, nothing_missing, held) is free


def test_a_whole_search_beside_half_of_a_gain_ends_with_the_true_one(nothing_missing):
    """It is searched both ways, and in the second what stays is in no fit."""
    right = judged().model
    body = msgspec.structs.replace(right.body, c0=0.5 * right.body.c0)
    wrong = msgspec.structs.replace(right, body=body)
    fitted = FittedRows(compare(flights(1), wrong))
    told = []
    found = find_effects(
        flights(1), wrong, judged=fitted, progress=lambda what, share: told.append(what)
    )
    assert any("as given" in what for what in told)
    assert found.effects == ()
    assert found.model.body.c0 == pytest.approx(right.body.c0, rel=0.01)
