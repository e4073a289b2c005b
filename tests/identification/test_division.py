"""Which rows are chosen, and held-out rows leave every axis to the fit, and have it themselves."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.dynamics.vehicle import BUILT_IN, THESIS_MOTOR, MotorConstants
from groundstation.errors import BadInputError
from groundstation.identification.flight import (
    HELD,
    IN_PIECES,
    best_way,
    cut,
    divided,
    hold_out,
    stretches_of,
)
from groundstation.identification.runs import (
    CHANNELS,
    EVERYTHING,
    Run,
    Selection,
    parse_selection,
    runs_of,
    selected,
)
from groundstation.telemetry.samples import spans
from support.flights import recorded

MOTOR = MotorConstants(1.33, 0.0052, 8e-5)
PERIOD_S, SECONDS = 0.01, 90.0


def flown_in_turn(name="steps"):
    """A recording of a craft that is steered about roll, then about pitch, then about yaw."""
    rows = round(SECONDS / PERIOD_S)
    time = PERIOD_S * np.arange(rows)
    steered = 0.02 * np.random.default_rng(0).normal(size=(4, rows))
    for axis in range(3):
        steered[axis, (time // 30.0).astype(int) != axis] = 0.0
    roll, pitch, yaw, thrust = steered
    duty = 0.6 + np.column_stack(
        [thrust - pitch - yaw, thrust - roll + yaw, thrust + pitch - yaw, thrust + roll + yaw]
    )
    columns = {channel: np.zeros((rows, 3)) for channel in CHANNELS}
    columns |= {"duty": duty, "rotor_rev_s": np.full((rows, 4), np.nan)}
    columns |= {"supply_v": np.full(rows, 3.9), "debug_s": np.zeros(rows)}
    columns["duty_step"] = np.full((rows, 4), np.nan)
    return Run(name, 0.0, PERIOD_S, **columns)


def moved(run, stretches):
    """Energy of roll, pitch and yaw in the duties of stretches."""
    squares = np.vstack([one.run.duty[one.rows] for one in stretches])
    squares = squares**2 @ np.array([[0, -1, 0, 1], [-1, 0, 1, 0], [-1, 1, -1, 1]]).T
    return (squares**2).sum(axis=0)


def test_axes_flown_one_after_the_other_are_all_fitted_and_all_held_out():
    run = flown_in_turn()
    fit_on, held, way = divided(stretches_of([run], MOTOR), "plus")
    assert way == IN_PIECES
    fitted, judged = moved(run, fit_on), moved(run, held)
    np.testing.assert_allclose(fitted / (fitted + judged), 2 / 3, atol=0.1)


def test_measured_rotor_speeds_tell_it_where_no_duty_is_recorded():
    run = flown_in_turn()
    run = replace(run, duty=np.full_like(run.duty, np.nan), rotor_rev_s=300.0 * run.duty)
    assert divided(stretches_of([run], MOTOR, measured=True), "plus")[2] == IN_PIECES


def test_pieces_too_short_to_say_anything_are_not_cut():
    stretches = stretches_of([flown_in_turn()], MOTOR)
    assert divided(stretches, "plus", least_s=10.1)[2] != IN_PIECES


def test_of_several_recordings_the_last_is_held_out_as_a_whole():
    steady = np.random.default_rng(2).normal(size=(9000, 4))
    runs = [replace(flown_in_turn(str(i)), duty=0.6 + 0.02 * steady) for i in range(3)]
    fit_on, held, _ = divided(stretches_of(runs, MOTOR), "plus")
    assert [one.run.name for one in fit_on] == ["0", "1"]
    assert [one.run.name for one in held] == ["2"]


@given(st.sampled_from(list(HELD)), st.lists(st.integers(1, 500), min_size=1, max_size=6))
def test_every_row_is_fitted_or_held_out_once(way, lengths):
    held_rows = 0
    for length, (fitted, held) in zip(lengths, cut(way, lengths), strict=True):
        covered = sorted((*fitted, *held))
        assert [a for a, _ in covered] + [length] == [0] + [b for _, b in covered]
        assert all(b > a for a, b in covered)
        held_rows += sum(b - a for a, b in held)
    assert held_rows == pytest.approx(sum(lengths) / 3, abs=3)


def test_the_last_third_is_held_out_where_every_axis_is_flown_all_the_time():
    steady = np.random.default_rng(1).normal(size=(3000, 4))
    assert best_way([steady, steady], 1) == "last third"


def test_the_last_third_of_several_runs_cuts_one_of_them():
    flown = flown_in_turn()
    fit, held = hold_out([flown[:900], flown[1500:2100]])
    assert [len(run) for run in fit] == [900, 100]
    assert [len(run) for run in held] == [500]
    assert held[0].start_s == pytest.approx(flown.start_s + 1600 * flown.period_s)


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
