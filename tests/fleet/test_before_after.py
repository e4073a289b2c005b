"""Shifts of all crafts since a date, on made series whose truth is known."""

import numpy as np
import pytest

from groundstation.errors import BadInputError
from groundstation.fleet.findings import Series, parse_date, shifts

DATE = "2026-03-01T00:00:00+00:00"
CRAFTS, FLIGHTS, SCATTER, ERROR = 8, 12, 0.004, 0.002


def series(random, shift=0.0, spread=0.0, quantity="thrust_per_mass"):
    """Crafts around their own levels, shifted since the date, in logarithms."""
    dates = [f"2026-0{1 if k < FLIGHTS // 2 else 4}-{k + 1:02d}T09:00:00" for k in range(FLIGHTS)]
    since = np.array([one >= DATE for one in dates])
    found = []
    for craft in range(CRAFTS):
        own = random.normal(-10.0, 0.02) + since * (shift + spread * random.normal())
        noise = np.hypot(SCATTER, ERROR) * random.normal(size=FLIGHTS)
        errors = np.full(FLIGHTS, ERROR)
        found.append(Series(f"cf{craft}", quantity, tuple(dates), own + noise, errors))
    return found


def test_a_better_propeller_is_believed_and_measured():
    (found,) = shifts(series(np.random.default_rng(1), shift=0.03), DATE)
    assert found.believed
    assert found.size == pytest.approx(0.03, abs=3.0 * found.stderr)
    assert found.stderr < 0.003
    assert (found.crafts, found.with_it) == (CRAFTS, CRAFTS)


@pytest.mark.parametrize("spread", [0.0, 0.02])
def test_where_nothing_shifted_for_all_few_are_believed(spread):
    wrong = sum(
        one.believed
        for seed in range(200)
        for one in shifts(series(np.random.default_rng(seed), spread=spread), DATE)
    )
    assert wrong <= 20


def test_the_stated_error_contains_the_truth_when_crafts_shift_unlike():
    inside = 0
    for seed in range(200):
        (found,) = shifts(series(np.random.default_rng(seed), shift=0.03, spread=0.01), DATE)
        inside += abs(np.log1p(found.size) - 0.03) < 2.4 * found.stderr
    assert inside >= 180


def test_one_craft_that_crashed_in_between_is_no_shift_of_all():
    made = series(np.random.default_rng(3))
    hurt = made[0]
    since = np.array([one >= DATE for one in hurt.begun])
    made[0] = Series(hurt.craft, hurt.quantity, hurt.begun, hurt.values - 0.07 * since, hurt.errors)
    (found,) = shifts(made, DATE)
    assert not found.believed
    assert abs(found.size) < 3.0 * found.stderr


def test_crafts_that_flew_on_one_side_only_say_nothing():
    alone = [
        Series(one.craft, one.quantity, one.begun[:6], one.values[:6], one.errors[:6])
        for one in series(np.random.default_rng(2))
    ]
    assert shifts(alone, DATE) == ()


def test_a_date_is_understood_with_and_without_a_zone():
    assert parse_date("2026-03-01") == DATE
    assert parse_date("2026-03-01T02:00+02:00") == DATE
    with pytest.raises(BadInputError, match="not a date"):
        parse_date("soon")
