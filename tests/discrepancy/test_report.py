"""Reports say what was found, for programs and for people."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from groundstation.comparison.comparison import compare
from groundstation.comparison.gap import CHANNELS
from groundstation.discrepancy.proof import Candidate, Leftover, Verdict
from groundstation.discrepancy.report import (
    compare_page,
    discrepancy_page,
    evidence_bars,
    waterfall,
    where_map,
)
from groundstation.discrepancy.report_json import CompareReport, DiscrepancyReport, gap_of
from groundstation.discrepancy.rerun_overlay import PAUSE_S, overlay_of
from groundstation.errors import BadInputError
from groundstation.viewer.overlay import write_overlay
from support.findings import NAME, findings, proof, report
from support.flights import BASE
from support.flights import compared as flights


@pytest.fixture(scope="module")
def found():
    return findings()


@pytest.fixture(scope="module")
def proven(found):
    return proof(found)


def test_the_report_survives_the_way_through_json(found, proven):
    written = report(found, proven)
    read = msgspec.json.decode(msgspec.json.encode(written), type=DiscrepancyReport)
    assert read == written


def test_the_gap_of_a_channel_is_its_error_over_its_floor_in_any_unit(found, proven):
    gap = report(found, proven).gap
    for name, channel in gap.channels.items():
        own = channel.own_unit
        assert channel.noise_floor == 1.0
        assert channel.before == pytest.approx(own.before / own.noise_floor), name
        assert channel.after == pytest.approx(own.after / own.noise_floor), name
        assert set(own.horizons) == {"20ms", "50ms"}
        squares = [level.before**2 for level in own.horizons.values()]
        assert min(squares) <= own.before**2 <= max(squares)
    ratios = [channel.before for channel in gap.channels.values()]
    assert gap.validation.before == pytest.approx(np.sqrt(np.mean(np.square(ratios))))


def test_a_channel_that_was_not_recorded_is_absent_from_the_report():
    runs = [replace(run, attitude=np.full((len(run), 3), np.nan)) for run in flights(1)]
    judged = compare(runs, BASE)
    gap = gap_of(judged, (judged.further(), None))
    assert set(gap.channels) == set(CHANNELS[:6])
    text = msgspec.json.encode(CompareReport(judged.places, gap, ["a"], "m"))
    assert msgspec.json.decode(text, type=CompareReport).gap == gap
    assert {row.channel for row in judged.places} == set(CHANNELS[:6])


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        (Verdict.NO_DISCREPANCY, "Nothing is missing that these recordings could show"),
        (Verdict.UNEXPLAINED, "Something acts on the craft that no effect in the list describes"),
    ],
)
def test_the_page_opens_with_the_verdict(verdict, words):
    one = findings(verdict)
    shown = proof(one)
    assert words in discrepancy_page(shown, report(one, shown)).html()


def test_the_page_says_what_is_left_what_cannot_be_shown_and_what_it_could_also_be(proven):
    left = Leftover("gyro_x", (1.5, 3.0), "tilt, roll", 4.0)
    one = findings(residual=left)
    page = discrepancy_page(proven, report(one, proven)).html()
    assert "Missing in the model: tipping moment of blade flapping (the craft is tipped" in page
    assert "<strong>Next:</strong>" in page
    assert "structure in gyro x at 1.5, 3 Hz, most like tilt, roll" in page
    assert "take off, land" in page
    assert "tilt leaning with acceleration: not looked for, attitude is not recorded" in page
    assert "could also be damping of roll and pitch (margin 9.0)" in page
    assert "not &lt;significant&gt;" in page
    assert page.count("<svg") == 8


def test_a_channel_that_got_worse_is_a_warning(found, proven):
    swapped = replace(proven, before=proven.after, after=proven.before)
    warnings = report(found, swapped).warnings
    assert warnings[0] == "motor assumed known by 2 %"
    assert any(line.startswith("the improved model is worse on gyro_x") for line in warnings)
    assert report(found, proven).warnings == ["motor assumed known by 2 %"]


def test_a_model_as_good_as_noise_is_told_so():
    (run,) = flights(1)
    good = compare([run], BASE)
    made = CompareReport(good.places, gap_of(good, (good.further(), None)), ["a.mcap"], "base.json")
    told = replace(good, warnings={"flight": "flight: driven by its measured speeds"})
    page = compare_page(told, made).html()
    assert "driven by its measured speeds" in page
    assert "as well as noise allows" in page
    assert "A closer look" not in page


def test_the_map_starts_with_the_whole_flight_and_writes_each_ratio(proven):
    made = where_map([("before", proven.before.places)])
    ticks = [label.get_text() for label in made.axes[0].get_xticklabels()]
    assert ticks[0] == "whole flight"
    place = next(p for p in proven.before.places if p.regime == "whole flight")
    texts = {text.get_text() for text in made.axes[0].texts}
    assert f"{place.rms / place.expected_rms:.2f}" in texts


def test_bars_are_green_where_accepted_and_say_why_where_not(found, proven):
    axis = evidence_bars(report(found, proven).candidates).axes[0]
    notes = [text.get_text() for text in axis.texts]
    assert notes == ["accepted", "not <significant>"]
    first, second = (bar.get_facecolor() for bar in axis.patches)
    assert first != second


def test_what_only_looked_like_the_effect_that_was_found_is_told_so(found, proven):
    weak = "no significant improvement"
    alike = Candidate("yaw_damping", 4000.0, 60.0, 0.0, False, weak, "weak")
    faint = Candidate("dead_time", 3.0, 60.0, 0.0, False, weak, "weak")
    other = Candidate(f"{NAME}.2", 4000.0, 60.0, 0.0, False)
    one = replace(found, candidates=(*found.candidates, faint, alike, other))
    written = report(one, proven).candidates
    said = {c.name: c.reason for c in written}
    assert said["yaw_damping"] == f"nothing is left for it beside {NAME}"
    assert said["dead_time"] == weak
    assert said[other.name] == "another form of it is named"
    assert {c.name: c.refused_by for c in written}["yaw_damping"] == "weak"
    notes = [
        text.get_text() for text in evidence_bars(report(one, proven).candidates).axes[0].texts
    ]
    assert f"nothing is left for it beside {NAME}" in notes


def test_the_waterfall_ends_where_the_last_step_ended(proven):
    axis = waterfall(proven.steps).axes[0]
    given, *_, improved = axis.patches
    assert given.get_width() == pytest.approx(proven.steps[0][1])
    assert improved.get_width() == pytest.approx(proven.steps[-1][1])


# The viewer gets measured and predicted channels of every held-out flight on one time axis.


@pytest.fixture(scope="module")
def overlay(found, proven):
    return overlay_of(proven, report(found, proven)), proven


def test_measured_less_predicted_is_the_error_that_was_judged(overlay):
    made, proven = overlay
    unit, values = made.channels["gyro_x"]
    assert unit == "deg/s"
    error = np.degrees(proven.before.errors[0].horizons[-1][:, 0])
    np.testing.assert_allclose(values[:, 0] - values[:, 1], error, atol=1e-9)
    measured = np.degrees(proven.before.errors[0].run.gyro[:, 0])
    np.testing.assert_allclose(values[:, 0], measured)


def test_flights_follow_each_other_with_a_pause(overlay):
    made, proven = overlay
    assert made.flights == ((0.0, proven.before.errors[0].run.name),)
    assert made.time_s[0] == 0.0
    assert np.diff(made.time_s).max() < PAUSE_S
    assert len(made.time_s) == len(proven.before.errors[0].run)


def test_the_gap_over_time_falls_to_noise(overlay):
    made, _ = overlay
    known = np.isfinite(made.gap).all(axis=1)
    before, after = np.sqrt(np.mean(made.gap[known] ** 2, axis=0))
    assert before > 1.5
    assert after == pytest.approx(1.0, abs=0.1)


def test_the_file_has_every_series_and_is_never_overwritten(overlay, tmp_path):
    from rerun.chunk import RrdReader

    made, _ = overlay
    path = tmp_path / "shown.rrd"
    write_overlay(made, path)
    rows = {}
    for chunk in RrdReader(path).stream():
        entity = chunk.entity_path.replace("\\", "")
        rows[entity] = rows.get(entity, 0) + chunk.to_record_batch().num_rows
    for channel in CHANNELS:
        assert rows[f"/channels/{channel}/measured"] >= len(made.time_s)
    assert rows["/gap/model"] > 10
    with pytest.raises(BadInputError, match="exists already"):
        write_overlay(made, path)
