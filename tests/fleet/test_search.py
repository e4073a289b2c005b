"""Which of a craft's flights are searched."""

from groundstation.fleet.search import chosen


def flight(name, seconds=60.0):
    """A catalogue's row."""
    return {"address": name, "begun": name, "sha256": name, "airborne_s": seconds}


def fit(*shares):
    """A row of the fits; shares: relative standard errors of c0, c1, c2, None where not told."""
    row = {}
    for name, share in zip(("c0", "c1", "c2"), shares, strict=True):
        row |= {name: None if share is None else 2.0}
        row |= {f"{name}_stderr": None if share is None else 2.0 * share}
    return row


def test_a_search_takes_the_flights_whose_fits_tell_most_of_all_axes():
    rows = [flight("a"), flight("b"), flight("c", seconds=300.0), flight("d")]
    fits = {
        "a": fit(0.001, 0.001, None),
        "b": fit(0.002, 0.002, 0.01),
        "c": fit(0.03, 0.03, 0.03),
        "d": fit(0.003, 0.002, 0.005),
    }
    told = chosen("cf01", rows, fits, "", 2, "")
    assert (told.fitted, told.held_out) == (("b",), ("d",))


def test_where_a_flight_is_not_fitted_the_longest_are_searched():
    rows = [flight("a", 20.0), flight("b", 90.0), flight("c", 30.0)]
    told = chosen("cf01", rows, {"a": fit(0.001, 0.001, 0.001)}, "", 2, "")
    assert (told.fitted, told.held_out) == (("b",), ("c",))


def test_flights_from_before_the_last_change_and_single_flights_are_not_searched():
    rows = [flight("a"), flight("b")]
    assert chosen("cf01", rows, {}, "b", 2, "") is None
