"""The first lines of a discrepancy report: plain, ordered by weight, and with what to fly."""

from dataclasses import replace

import msgspec
import pytest

from groundstation.discrepancy.proof import EffectFound, NotShown, PossibleEffect, Step, Verdict
from groundstation.discrepancy.report import (
    advice_of,
    by_weight,
    flight_plan,
    found_in_short,
    found_in_words,
    is_zero,
    next_in_words,
    possible_in_words,
)
from groundstation.dynamics.model import Estimate
from support.findings import NAME, findings, proof, report


@pytest.fixture(scope="module")
def told():
    one = findings()
    return report(one, proof(one))


def not_shown(name, manoeuvre):
    return NotShown(name, "size", 1.0, 0.1, "", manoeuvre)


def test_what_was_found_is_told_by_its_name_with_what_it_does_and_how_sure_it_is(told):
    said = found_in_words(told)
    assert said.startswith(
        "Missing in the model: tipping moment of blade flapping (the craft is tipped back by"
        " 15 rad/s² for each m/s that it moves)."
    )
    assert "that no fit has seen: prediction errors fall from" in said
    assert "what was found explains 90 % of what was wrong" in said


def test_what_was_found_in_part_says_so_and_how_much_is_left():
    one = findings(Verdict.FOUND_IN_PART)
    told = report(one, proof(one))
    assert found_in_words(told).startswith("Missing in the model, and more than that: tipping")
    after = told.gap.validation.after
    assert (
        found_in_short(told)[0] == f"1 effect found, and errors are still {after:.2f} times noise"
    )


def test_where_nothing_is_missing_it_says_what_that_rests_on():
    one = findings(Verdict.NO_DISCREPANCY)
    told = report(one, proof(one))
    said = found_in_words(told)
    assert "Checked on recordings that no fit has seen: prediction errors are" in said
    level = msgspec.structs.replace(told.gap.validation, before=1.04)
    near = msgspec.structs.replace(told, gap=msgspec.structs.replace(told.gap, validation=level))
    assert found_in_words(near).endswith(
        "prediction errors are 1.04 times noise, within the 1.1 that noise levels are known to."
    )


def test_what_is_possible_is_told_apart_with_what_stands_in_its_place():
    one = findings()
    (named,) = one.effects
    other = replace(named.alternatives[0], share=0.3)
    doubtful = PossibleEffect(NAME, named.parameters, 0.45, (other,))
    told = report(replace(one, possible=(doubtful,)), proof(one))
    (line,) = possible_in_words(told)
    assert line.startswith("possible: tipping moment of blade flapping, chosen in 45 %")
    assert "damping of roll and pitch in 30 %" in line
    alone = replace(one, effects=(), possible=(doubtful,), verdict=Verdict.UNEXPLAINED)
    said = found_in_words(report(alone, proof(alone)))
    assert "no name is sure" in said
    assert said.endswith("possible: tipping moment of blade flapping.")
    (possible,) = msgspec.to_builtins(told)["possible"]
    assert (possible["name"], possible["recurrence"]) == (NAME, 0.45)


def test_the_next_step_is_the_model_and_what_to_fly(told):
    assert next_in_words(told, written=True).startswith("use the improved model in place")
    assert "write the improved model with -o" in next_in_words(told)
    assert "begin and end at rest, take off, land" in next_in_words(told)


def test_a_model_that_got_worse_is_not_recommended():
    one = findings()
    made = proof(one)
    worse = report(one, replace(made, before=made.after, after=made.before))
    assert "none the better for it" in found_in_words(worse)
    assert next_in_words(worse).startswith("keep the given model")
    assert advice_of(worse)[0].what.startswith("The improved model predicts")


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        (Verdict.NO_DISCREPANCY, "use the model as it is"),
        (Verdict.UNEXPLAINED, "look at the map below"),
    ],
)
def test_where_nothing_is_named_it_says_what_to_do(verdict, words):
    one = findings(verdict)
    assert next_in_words(report(one, proof(one))).startswith(words)


def test_effects_stand_in_the_order_of_what_they_explain():
    def effect(name, weight):
        return EffectFound(name, 1, "", {}, {}, (), Step(2.0, 1.0), (), weight)

    found = [effect("a", None), effect("b", 0.1), effect("c", 0.7)]
    assert [one.name for one in by_weight(found)] == ["c", "b", "a"]


def test_a_parameter_is_zero_where_its_interval_holds_zero():
    assert is_zero(Estimate(0.001, 0.05, ""))
    assert not is_zero(Estimate(0.2, 0.05, ""))
    assert not is_zero(Estimate(0.0, None, ""))


def test_fourteen_manoeuvres_become_one_flight():
    plan = flight_plan(
        [
            not_shown("rate_damping", "fast roll and pitch doublets on the spot"),
            not_shown("quadratic_rate_damping", "large roll and pitch doublets, 3 rad/s and more"),
            not_shown("yaw_damping", "yaw steps both ways, then a steady turn at 3 rad/s"),
            not_shown("supply_sag", "steps of collective thrust over 60..140 % of hover"),
            not_shown("gyro_bias", "nothing special; attitude must be recorded"),
            not_shown("own", "knock at the left arm"),
        ]
    )
    assert len(plan) == 5
    doublets, names = plan[0]
    assert doublets.startswith("sharp roll and pitch doublets")
    assert names == ["rate_damping", "quadratic_rate_damping"]
    assert ("knock at the left arm", ["own"]) in plan
    assert "nothing special" not in dict(plan)


def test_the_words_need_no_more_than_what_is_written(told):
    again = msgspec.json.decode(msgspec.json.encode(told), type=type(told))
    assert found_in_words(again) == found_in_words(told)
    assert NAME in {one.name for one in again.effects}
