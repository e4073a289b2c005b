"""The seal is opened: what counts as named, and what is said when it was not."""

import msgspec
import numpy as np

from firmware_sim.hide import main as hide
from groundstation.demo.outcome import Distance, claims_of, described, hidden_in
from groundstation.demo.story import CRAFT_FILE, SEALED, inputs
from groundstation.discrepancy.report_json import DiscrepancyReport

NAME = "velocity_moment"
TRUTH = {NAME: {"moment": 15.1}}
CLOSER = Distance(np.full(9, 2.0), np.full(9, 0.1), np.ones(9))
NOTICED = [
    {"kind": "gap", "text": "roll rate disagrees", "details": {"channel": "gyro_x"}},
]


LISTS = ("base_changes", "where", "where_after", "left", "candidates", "not_shown", "warnings")


def found_report(*effects, after=1.0):
    """A report of a search that named these effects."""
    level = {"before": 4.0, "after": after, "noise_floor": 1.0}
    plain = {
        "verdict": "effects_found" if effects else "unexplained",
        "effects": effects,
        "gap": {"unit": "", "floor_source": "", "validation": level, "train": None, "channels": {}},
        "residual": "white",
        "residual_detail": {"channel": "", "frequencies_hz": [], "signal": "", "excess": 1.0},
        **{key: [] for key in LISTS},
        **{"lost": {}, "recordings": [], "validation": [], "model": "", "seed": 0},
        "created_by": "test",
    }
    return msgspec.convert(plain, DiscrepancyReport)


def named(name, **parameters):
    return {
        "name": name,
        "order": 1,
        "adds": "",
        "parameters": {
            key: {"value": value, "stderr": error, "unit": unit}
            for key, (value, error, unit) in parameters.items()
        },
        "evidence": {},
        "alternatives": [],
        "gap": {"before": 4.0, "after": 1.0},
        "channels": [],
    }


RIGHT = named(NAME, moment=(15.0, 0.2, "rad/s^2 per m/s"))


def claims(hidden, found, distance=CLOSER, noticed=NOTICED):
    return {one.name: one for one in claims_of(hidden, found, distance, noticed)}


def test_all_came_true_where_the_hidden_name_and_no_other_is_found():
    made = claims(TRUTH, found_report(RIGHT))
    assert all(claim.true for claim in made.values())
    assert "hidden: velocity_moment 15.1 rad/s^2 per m/s" in made["named"].text
    assert "named: velocity_moment 15 ± 0.2 rad/s^2 per m/s" in made["named"].text


def test_another_name_one_too_many_or_one_too_few_is_not_named():
    other = {"yaw_damping": {"damping_n_m_s": 4e-6}}
    extra = named("yaw_damping", damping_n_m_s=(4e-6, 1e-7, "N m s"))
    assert not claims(other, found_report(RIGHT))["named"].true
    assert not claims(TRUTH, found_report(RIGHT, extra))["named"].true
    assert not claims(TRUTH | other, found_report(RIGHT))["named"].true
    assert claims(TRUTH | other, found_report(RIGHT, extra))["named"].true


def test_nothing_found_is_said_and_neither_named_nor_closer():
    made = claims(TRUTH, found_report(after=4.0))
    assert not made["named"].true
    assert made["named"].text.endswith("named: nothing")
    assert not made["gap"].true


def test_a_twin_that_saw_nothing_and_a_model_that_strays_more_are_told():
    further = Distance(np.full(9, 1.0), np.full(9, 1.1), np.ones(9))
    made = claims(TRUTH, found_report(RIGHT), further, [])
    assert [name for name, claim in made.items() if not claim.true] == ["noticed", "flown"]


def test_a_false_alarm_on_another_channel_is_no_notice():
    elsewhere = {"text": "yaw rate disagrees", "details": {"channel": "gyro_z"}}
    assert not claims(TRUTH, found_report(RIGHT), noticed=[elsewhere])["noticed"].true
    both = claims(TRUTH, found_report(RIGHT), noticed=[elsewhere, *NOTICED])["noticed"]
    assert both.true
    assert both.text.endswith("roll rate disagrees")


def test_small_quantities_are_told_in_the_unit_one_thinks_in():
    said = described("dead_time", {"delay_s": 0.0041}, {"delay_s": 0.0001})
    assert said == "dead_time 4.1 ± 0.1 ms"
    said = described("centre_of_gravity_offset", {"x_m": 1e-3, "y_m": -5e-4}, {})
    assert said == "centre_of_gravity_offset x 1 mm, y -0.5 mm"


def test_the_seal_holds_what_was_hidden_and_the_story_s_own_files_do_not(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in inputs(3).items():
        (tmp_path / name).write_text(text)
    craft, sealed = tmp_path / CRAFT_FILE, tmp_path / SEALED
    assert hide(["--settings", str(craft), "--seed", "3", "-o", str(sealed)]) == 0
    ((name, values),) = hidden_in(tmp_path).items()
    assert values
    assert name not in inputs(3)[CRAFT_FILE]
