"""Stretches that are looked at first: typed, or told of by the live twin."""

from dataclasses import asdict

import numpy as np
import pytest

from groundstation.comparison.comparison import compare
from groundstation.comparison.stretches import Marked, by_hand, by_twin, within
from groundstation.discrepancy.report_json import stretch_report
from groundstation.errors import BadInputError
from groundstation.links.event import LinkEvent
from groundstation.service.twin import BEGAN, ENDED, SOURCE
from support.findings import NAME
from support.flights import BASE, MEDIUM, hidden, judged
from support.flights import compared as flights


@pytest.fixture(scope="module")
def comparison():
    return judged(effects=hidden(NAME, MEDIUM[NAME]))


def name_of(comparison):
    return comparison.errors[0].run.name


def told(kind, statistic, begin_s, end_s, channel="gyro_x"):
    details = {
        "channel": channel,
        "regime": "translation",
        "statistic": statistic,
        "begin_s": begin_s,
        "end_s": end_s,
    }
    return asdict(LinkEvent(0, SOURCE, kind, f"{channel} disagrees", details))


def test_parts_of_a_flight_together_have_the_errors_of_the_whole(comparison):
    name = name_of(comparison)
    parts = [
        within(comparison, Marked(name, begin, end, "")) for begin, end in ((0, 20.0), (20.0, 1e3))
    ]
    rows = [[np.isfinite(one.horizons[0]).sum(axis=0) for one in part.errors] for part in parts]
    whole = [np.isfinite(one.horizons[0]).sum(axis=0) for one in comparison.errors]
    np.testing.assert_array_equal(np.sum(rows, axis=0), whole)
    assert min(p.gap for p in parts) < comparison.gap < max(p.gap for p in parts)


def test_a_stretch_where_the_effect_acts_is_worse_than_one_where_it_rests(comparison):
    name = name_of(comparison)
    run, motion = comparison.errors[0].run, comparison.errors[0].motion
    seconds = run.time_s - run.recording_start_s
    speed = np.where(motion.flown, np.linalg.norm(motion.velocity[:, :2], axis=1), np.nan)
    windows = [(t, t + 2.0) for t in np.arange(8.0, seconds[-1] - 6.0, 1.0)]
    mean = [np.nanmean(speed[(seconds >= a) & (seconds < b)]) for a, b in windows]
    slow, fast = (
        stretch_report(Marked(name, *windows[k], "by hand"), comparison)
        for k in (int(np.argmin(mean)), int(np.argmax(mean)))
    )
    assert fast.gap.before > 2 * slow.gap.before
    assert fast.channels["gyro_x"].before + fast.channels["gyro_y"].before > 6.0
    assert fast.where[0].channel in ("gyro_x", "gyro_y", "roll", "pitch")
    assert fast.gap.after is None


def test_seconds_in_which_nothing_flew_are_refused(comparison):
    with pytest.raises(BadInputError, match="nothing is flown from 500 to 510 s"):
        within(comparison, Marked(name_of(comparison), 500.0, 510.0, ""))


def test_a_clean_flight_has_no_clear_place_in_a_stretch():
    (run,) = flights(1)
    clean = compare([run], BASE)
    found = stretch_report(Marked(run.name, 10.0, 15.0, "by hand"), clean)
    assert found.gap.before == pytest.approx(1.0, abs=0.1)
    assert all(row.significance < 6.0 for row in found.where)


def test_the_twins_events_are_stretches_the_strongest_first():
    events = [
        told(BEGAN, 4.0, 107.0, None),
        told(ENDED, 5.5, 107.0, 109.5),
        told(BEGAN, 9.0, 112.0, None, channel="yaw"),
        asdict(LinkEvent(0, "usb", "lost", "lost", {})),
    ]
    assert by_twin(events, "a.mcap", 100.0, 130.0) == [
        Marked("a.mcap", 12.0, 30.0, "the live twin: yaw disagrees"),
        Marked("a.mcap", 7.0, 9.5, "the live twin: gyro_x disagrees"),
    ]


def test_what_began_in_the_file_before_begins_with_this_one():
    """A recording that was rotated: the file before told of the first, and closed it."""
    events = [told(ENDED, 4.0, 90.0, 95.0), told(ENDED, 5.0, 98.0, 103.0)]
    assert by_twin(events, "b.mcap", 100.0, 130.0) == [
        Marked("b.mcap", 0.0, 3.0, "the live twin: gyro_x disagrees")
    ]


def test_a_typed_stretch_is_looked_at_in_every_recording():
    found = by_hand([(1.0, 2.0)], ["a", "b"])
    assert [(one.recording, one.begin_s) for one in found] == [("a", 1.0), ("b", 1.0)]
