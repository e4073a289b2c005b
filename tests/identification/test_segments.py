"""Which rows a selection chooses, on flights whose manoeuvres are known."""

from dataclasses import replace

import numpy as np
import pytest
from stand_in_flights import recorded

from groundstation.dynamics.vehicle import BUILT_IN, THESIS_MOTOR
from groundstation.errors import BadInputError
from groundstation.identification.airborne import airborne
from groundstation.identification.body.fit import fit_body
from groundstation.identification.runs import runs_of
from groundstation.identification.segments import (
    CRITERIA,
    EVERYTHING,
    Selection,
    parse_selection,
    selected,
)
from groundstation.identification.stretches import stretches_of
from groundstation.spans import spans

VEHICLE = BUILT_IN["crazyflie1"]


@pytest.fixture(scope="module")
def excited():
    (run,) = runs_of(recorded(40.0, plant="reduced", seed=51)[0], "excited")
    return run


@pytest.fixture(scope="module")
def hovering():
    (run,) = runs_of(recorded(20.0, plant="reduced", seed=52, program="hover")[0], "hovering")
    return run


def share(run, *criteria):
    """Of the airborne rows, how many are chosen."""
    return selected(run, Selection(criteria))[airborne(run)].mean()


def test_a_hover_is_told_from_a_flight_that_moves_its_axes(excited, hovering):
    assert share(hovering, "hover") > 0.8
    assert share(excited, "hover") < 0.3
    for run in (excited, hovering):
        assert share(run, "moving") == pytest.approx(1 - share(run, "hover"))


def test_the_altitude_is_not_steady_while_a_climb_begins(hovering):
    takes_off = np.flatnonzero((hovering.duty > 0.1).all(axis=1))[0]
    steady = selected(hovering, Selection(("steady_altitude",)))
    assert not steady[takes_off + 100 : takes_off + 400].all()
    assert share(hovering, "steady_altitude") > 0.8


def test_altitude_is_judged_upright_also_when_the_craft_leans():
    """Held at 30 degrees without climbing, the accelerometer shows more than 1 g along z."""
    (run,) = runs_of(recorded(8.0, plant="reduced", seed=53)[0])
    attitude, force = np.zeros((len(run), 3)), np.zeros((len(run), 3))
    attitude[:, 0], force[:, 2] = np.radians(30), 9.80665 / np.cos(np.radians(30))
    leaning = replace(run, attitude=attitude, accelerometer=force)
    assert selected(leaning, Selection(("steady_altitude",))).all()
    attitude[:] = 0.0
    assert not selected(leaning, Selection(("steady_altitude",))).any()


def test_saturated_rows_are_left_out_with_those_around_them(excited):
    duty = excited.duty.copy()
    duty[9000:9010, 2] = 1.0
    limited = replace(excited, duty=duty)
    good = selected(limited, Selection(("unsaturated",)))
    assert not good[8960:9050].any()
    assert good[9100:12000].all()
    np.testing.assert_array_equal(selected(limited, Selection(("saturated",))), ~good)


def test_rows_are_chosen_by_battery_voltage(excited):
    middle = float(np.median(excited.supply_v[airborne(excited)]))
    low = selected(excited, Selection(battery_v=(0.0, middle)))
    assert excited.supply_v[low].max() <= middle
    assert excited.supply_v[~low].min() > middle


def test_rows_are_chosen_by_time_since_the_recording_began(excited):
    chosen = selected(excited, Selection(spans_s=((10.0, 12.0), (20.0, 25.0))))
    assert chosen.sum() * excited.period_s == pytest.approx(7.0, abs=0.01)
    first, _ = spans(chosen)
    assert excited.time_s[first[0]] - excited.recording_start_s == pytest.approx(10.0, abs=0.002)
    part = excited[8000:16000]  # a part still counts from the recording's start
    assert selected(part, Selection(spans_s=((10.0, 12.0),))).sum() == 0
    assert selected(part, Selection(spans_s=((20.0, 25.0),))).any()


def test_criteria_narrow_each_other(excited):
    both = selected(excited, Selection(("moving", "unsaturated")))
    one, other = (selected(excited, Selection((name,))) for name in ("moving", "unsaturated"))
    np.testing.assert_array_equal(both, one & other)


def test_automatic_choice_keeps_most_of_an_undisturbed_flight_and_no_knock(excited):
    force = excited.accelerometer.copy()
    force[10000:10060] += 40.0
    knocked = replace(excited, accelerometer=force)
    assert share(excited, "auto") > 0.5
    assert not selected(knocked, Selection(("auto",)))[9990:10070].any()


def test_a_body_is_fitted_on_what_was_chosen(excited):
    chosen = stretches_of([excited], THESIS_MOTOR, selection=parse_selection("", ("8:20", "26:34")))
    assert [round(len(s) * s.run.period_s) for s in chosen] == [12, 8]
    fit = fit_body(chosen, VEHICLE)
    found = [fit.body.c0, fit.body.c1, fit.body.c2]
    np.testing.assert_allclose(found, VEHICLE.body_constants, rtol=0.02)


def test_a_selection_is_parsed_from_what_is_typed():
    selection = parse_selection(" moving,battery=3.5:4.1 , unsaturated", ("12.5:40",))
    assert selection == Selection(("moving", "unsaturated"), (3.5, 4.1), ((12.5, 40.0),))
    assert parse_selection("") == EVERYTHING
    assert str(selection) == "moving and unsaturated and at 3.5 to 4.1 V and in 12.5 to 40 s"


@pytest.mark.parametrize(
    ("select", "segments", "text"),
    [
        ("flying", (), f"there are {', '.join(CRITERIA)}"),
        ("battery=4.1:3.5", (), "two rising numbers"),
        ("", ("40",), "--segment 40: give two rising"),
        ("", ("a:b",), "two rising"),
        ("", ("0:nan",), "two rising"),
    ],
)
def test_a_selection_that_means_nothing_is_refused(select, segments, text):
    with pytest.raises(BadInputError, match=text):
        parse_selection(select, segments)


def test_what_is_not_there_cannot_be_chosen(hovering):
    with pytest.raises(BadInputError, match=r"that is in 100 to 200 s.*choose less strictly"):
        stretches_of([hovering], THESIS_MOTOR, selection=parse_selection("", ("100:200",)))
    blind = replace(hovering, accelerometer=np.full_like(hovering.accelerometer, np.nan))
    with pytest.raises(BadInputError, match="no accelerometer to judge the altitude"):
        selected(blind, Selection(("steady_altitude",)))
    dark = replace(hovering, supply_v=np.full_like(hovering.supply_v, np.nan))
    with pytest.raises(BadInputError, match="no battery voltage to choose by"):
        selected(dark, Selection(battery_v=(3.0, 4.0)))
