"""Which rows a selection chooses, on flights whose manoeuvres are known."""

import pytest

from groundstation.dynamics.vehicle import BUILT_IN, THESIS_MOTOR
from groundstation.errors import BadInputError
from groundstation.identification.division import stretches_of
from groundstation.identification.runs import (
    EVERYTHING,
    Selection,
    parse_selection,
    runs_of,
    selected,
)
from groundstation.telemetry.samples import spans
from support.flights import recorded

VEHICLE = BUILT_IN["crazyflie1"]


@pytest.fixture(scope="module")
def excited():
    (run,) = runs_of(recorded(40.0, plant="reduced", seed=51)[0], "excited")
    return run


@pytest.fixture(scope="module")
def hovering():
    (run,) = runs_of(recorded(20.0, plant="reduced", seed=52, program="hover")[0], "hovering")
    return run


def test_rows_are_chosen_by_time_since_the_recording_began(excited):
    chosen = selected(excited, Selection(spans_s=((10.0, 12.0), (20.0, 25.0))))
    assert chosen.sum() * excited.period_s == pytest.approx(7.0, abs=0.01)
    first, _ = spans(chosen)
    assert excited.time_s[first[0]] - excited.recording_start_s == pytest.approx(10.0, abs=0.002)
    part = excited[8000:16000]  # a part still counts from the recording's start
    assert selected(part, Selection(spans_s=((10.0, 12.0),))).sum() == 0
    assert selected(part, Selection(spans_s=((20.0, 25.0),))).any()


def test_a_selection_is_parsed_from_what_is_typed():
    selection = parse_selection(("12.5:40", "50:60"))
    assert selection == Selection(((12.5, 40.0), (50.0, 60.0)))
    assert parse_selection() == EVERYTHING
    assert str(selection) == "in 12.5 to 40 s, 50 to 60 s"


@pytest.mark.parametrize("typed", ["40", "a:b", "0:nan", "40:12"])
def test_a_selection_that_means_nothing_is_refused(typed):
    with pytest.raises(BadInputError, match=f"--segment {typed}: give two rising numbers"):
        parse_selection((typed,))


def test_seconds_that_are_not_there_cannot_be_chosen(hovering):
    with pytest.raises(BadInputError, match=r"that is in 100 to 200 s.*choose more of it"):
        stretches_of([hovering], THESIS_MOTOR, selection=parse_selection(("100:200",)))
