"""The folder is the state."""

import pytest

from groundstation.errors import BadInputError
from groundstation.learn.planning import JOURNAL, Journal, Landed, Task, journal_in

TASK = Task(
    link="software:crazyflie21",
    vehicle="crazyflie21",
    height_m=0.5,
    reach_m=1.0,
    seed=1,
    batteries=3,
)


def landed(file, battery=1, **more):
    return Landed(file=file, purpose="", seconds=30.0, battery=battery, timeline=[], **more)


def test_what_was_saved_is_read_back(tmp_path):
    journal = Journal(task=TASK, flights=[landed("flight1.mcap")], said=["hover: it hovers"])
    journal.save(tmp_path)
    assert journal_in(tmp_path) == journal
    assert [path.name for path in tmp_path.iterdir()] == [JOURNAL]


def test_a_flight_that_was_cut_short_is_flown_again_and_counts_for_the_battery():
    journal = Journal(
        task=TASK,
        flights=[
            landed("flight1.mcap"),
            landed("flight2.cut1.mcap", battery=2, aborted="interrupted"),
            landed("flight2.mcap", battery=2),
        ],
    )
    assert journal.good("flight2.cut1.mcap") is None
    assert journal.good("flight2.mcap") == journal.flights[2]
    assert journal.batteries == 2
    assert journal.on_battery_s == 60.0


def test_a_folder_without_one_has_none_and_a_torn_one_is_refused(tmp_path):
    assert journal_in(tmp_path) is None
    (tmp_path / JOURNAL).write_text('{"task":')
    with pytest.raises(BadInputError, match="another folder"):
        journal_in(tmp_path)
