"""The seal is opened: what counts as named, and what is said when it was not."""

import numpy as np
import pytest
from made_findings import NAME, findings, proof, report

from firmware_sim.hide import main as hide
from groundstation.demo.outcome import Distance, claims_of, described, hidden_in
from groundstation.demo.story import CRAFT_FILE, SEALED, inputs
from groundstation.discrepancy.findings import Verdict

TRUTH = {NAME: {"moment": 15.1}}
CLOSER = Distance(np.full(9, 2.0), np.full(9, 0.1), np.ones(9))
NOTICED = [{"kind": "disagrees", "text": "roll disagrees while translating"}]


@pytest.fixture(scope="module")
def found():
    some = findings()
    return report(some, proof(some))


def claims(hidden, found, distance=CLOSER, noticed=NOTICED):
    return {one.name: one for one in claims_of(hidden, found, distance, noticed)}


def test_all_came_true_where_the_hidden_name_and_no_other_is_found(found):
    made = claims(TRUTH, found)
    assert all(claim.true for claim in made.values())
    assert "hidden: velocity_moment 15.1 rad/s^2 per m/s" in made["named"].text
    assert "named: velocity_moment 15 ± 0.2 rad/s^2 per m/s" in made["named"].text


@pytest.mark.parametrize(
    "hidden", [{"rotor_drag": {"drag_n_s_m": 0.01}}, {**TRUTH, "yaw_damping": {}}]
)
def test_another_name_or_one_that_is_missing_is_not_named(found, hidden):
    if "yaw_damping" in hidden:
        hidden["yaw_damping"] = {"damping_n_m_s": 4e-6}
    assert not claims(hidden, found)["named"].true


def test_nothing_found_is_said_and_neither_named_nor_closer():
    none = findings(Verdict.UNEXPLAINED)
    made = claims(TRUTH, report(none, proof(none)))
    assert not made["named"].true
    assert made["named"].text.endswith("named: nothing")
    assert not made["gap"].true


def test_a_twin_that_saw_nothing_and_a_model_that_strays_more_are_told(found):
    further = Distance(np.full(9, 1.0), np.full(9, 1.1), np.ones(9))
    made = claims(TRUTH, found, further, [])
    assert [name for name, claim in made.items() if not claim.true] == ["noticed", "flown"]


def test_small_quantities_are_told_in_the_unit_one_thinks_in():
    said = described("dead_time", {"delay_s": 0.0041}, {"delay_s": 0.0001})
    assert said == "dead_time 4.1 ± 0.1 ms"
    said = described("centre_of_gravity_offset", {"x_m": 1e-3, "y_m": -5e-4}, {})
    assert said == "centre_of_gravity_offset x 1 mm, y -0.5 mm"


def test_the_seal_holds_what_was_hidden_and_the_story_s_own_files_do_not(tmp_path):
    for name, text in inputs(3).items():
        (tmp_path / name).write_text(text)
    craft, sealed = tmp_path / CRAFT_FILE, tmp_path / SEALED
    assert hide(["--settings", str(craft), "--seed", "3", "-o", str(sealed)]) == 0
    ((name, values),) = hidden_in(tmp_path).items()
    assert values
    assert name not in inputs(3)[CRAFT_FILE]
