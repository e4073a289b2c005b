"""How well flights tell the constants: expected when they are read, known when they are fitted."""

from pathlib import Path

import pytest

from groundstation.errors import BadInputError
from groundstation.fleet.certainty import PERCENT, TOLD, errors_of, expectations
from groundstation.fleet.facts import facts_of
from groundstation.fleet.flight_fit import CONSTANTS, fit_flight
from groundstation.fleet.index import index, recordings_of
from groundstation.fleet.search import chosen

RECORDINGS = Path(__file__).parents[2] / "recordings"


def flight(name, *percents, craft="cf01", seconds=60.0):
    """A catalogue's row; percents: expected of c0, c1, c2, None where nothing is."""
    told = dict(zip(PERCENT.values(), (*percents, None, None), strict=True))
    return (
        {"address": name, "craft": craft, "begun": name, "sha256": name}
        | told
        | {"airborne_s": seconds}
    )


def fit(*shares):
    """A row of the fits; shares: relative standard errors of c0, c1, c2, None where not told."""
    row = {}
    for name, share in zip(("c0", "c1", "c2"), shares, strict=True):
        row |= {name: None if share is None else 2.0}
        row |= {f"{name}_stderr": None if share is None else 2.0 * share}
    return row


def test_what_the_catalogue_expects_of_a_flight_is_what_its_fit_reports():
    address = str(RECORDINGS / "stand_in_flight.mcap")
    row = facts_of(address)
    fitted = fit_flight(address, None, ("dead_time", "rotor_acceleration_torque"))
    for name in CONSTANTS:
        share = 100.0 * fitted[f"{name}_stderr"] / fitted[name]
        assert 0.5 < row[PERCENT[name]] / share < 2.0, name
    assert 0.1 < row["motor_pace_expected_percent"] < 10.0
    assert row["not_expected"] is None


def test_a_recording_of_an_unknown_craft_is_read_and_says_why_nothing_is_expected():
    row = facts_of(str(RECORDINGS / "microsd_log16"))
    assert row["state"] in ("good", "usable")
    assert "say which with --vehicle" in row["not_expected"]
    assert row["c0_expected_percent"] is None


def test_a_catalogue_of_crafts_that_the_user_names_expects_by_their_profile(tmp_path):
    catalogue, flights = tmp_path / "fleet", [str(RECORDINGS / "stand_in_flight.mcap")]

    def read(vehicle):
        counts = index(catalogue, flights, vehicle=vehicle, workers=1)
        (row,) = recordings_of(catalogue)
        return counts.read, row["vehicle"], row["c0_expected_percent"]

    read_first, named, expected = read(None)
    assert (read_first, named) == (1, "crazyflie1")
    again, other, of_other = read("crazyflie21")
    assert (again, other) == (1, "crazyflie21")
    assert of_other != pytest.approx(expected, rel=0.05)
    assert read("crazyflie21") == (0, other, of_other)
    with pytest.raises(BadInputError, match="neither built in"):
        read("crazyfly")


def test_fits_count_in_place_of_what_was_expected_once_all_flights_of_a_craft_have_one():
    rows = [flight("a", 1.0, 1.0, 4.0), flight("b", 2.0, 1.0, None)]
    expected = {"a": (0.01, 0.01, 0.04), "b": (0.02, 0.01, 1.0)}
    assert errors_of(rows, {"a": fit(0.5, 0.5, 0.5)}) == expected
    fits = {"a": fit(0.5, 0.5, None), "b": fit(0.1, 7.0, 0.2)}
    assert errors_of(rows, fits) == {"a": (0.5, 0.5, 1.0), "b": (0.1, 1.0, 0.2)}


def test_flights_of_a_craft_tell_together_what_none_of_them_tells_alone():
    rows = [flight(name, 20.0, 10.0, None) for name in "abcd"] + [flight("e", 5.0, 5.0, 40.0)]
    found = expectations([*rows, flight("x", None, None, None, craft="cf02")])
    assert list(found) == ["cf01", "cf02"]
    assert (found["cf01"].flights, found["cf01"].worth) == (5, 1)
    assert found["cf01"].errors["c0"] == pytest.approx((4 * 0.2**-2 + 0.05**-2) ** -0.5)
    assert found["cf01"].errors["c2"] == pytest.approx(0.4)
    assert found["cf02"].errors == dict.fromkeys(TOLD, 1.0)


def test_a_search_takes_the_flights_that_tell_most_of_all_axes():
    rows = [
        flight("a", 0.1, 0.1, None),
        flight("b", 0.2, 0.2, 1.0),
        flight("c", 3.0, 3.0, 3.0, seconds=300.0),
        flight("d", 0.3, 0.2, 0.5),
    ]
    told = chosen("cf01", rows, {}, "", 2, "")
    assert (told.fitted, told.held_out) == (("b",), ("d",))
