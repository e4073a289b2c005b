"""A settled covariance is where going on, row after row, ends."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from groundstation.prediction.observer import Row, settled

A = np.array([[1.0, 0.02, 0.0], [0.0, 0.95, 0.02], [0.0, 0.0, 1.0]])
PROCESS = np.array([1e-9, 1e-4, 1e-6])
EVERY = Row(A, PROCESS, np.eye(3)[:2], np.array([1e-4, 1e-6]))
RARE = Row(A, PROCESS, np.eye(3)[1:2], np.array([1e-6]))
START = np.eye(3)


def test_with_one_kind_of_row_it_solves_the_riccati_equation():
    _, after = EVERY.corrected(settled([EVERY], START))
    sensor, process = np.diag(EVERY.sensor), np.diag(PROCESS)
    foretold = solve_discrete_are(A.T, EVERY.seen.T, process, sensor)
    gain = foretold @ EVERY.seen.T @ np.linalg.inv(EVERY.seen @ foretold @ EVERY.seen.T + sensor)
    assert after == pytest.approx(foretold - gain @ EVERY.seen @ foretold, rel=1e-6, abs=1e-14)


@pytest.mark.parametrize("rows", [[RARE, EVERY], [EVERY, RARE], [RARE, RARE, EVERY]])
def test_rows_that_take_turns_end_where_many_turns_do(rows):
    p = START
    for _ in range(4000):
        for row in rows:
            _, p = row.corrected(p)
    assert settled(rows, START) == pytest.approx(p, rel=1e-6, abs=1e-14)


def test_it_stays_as_it_is_and_is_one():
    p = after = settled([RARE, EVERY], START)
    for row in (RARE, EVERY):
        _, after = row.corrected(after)
    assert after == pytest.approx(p, rel=1e-9)
    assert np.linalg.eigvalsh(p).min() > 0.0
    np.testing.assert_array_equal(p, p.T)


def test_what_is_never_seen_keeps_what_was_known_of_it():
    still = Row(np.eye(2), np.array([0.0, 1e-4]), np.array([[0.0, 1.0]]), np.array([1e-2]))
    assert settled([still], np.diag([3.0, 1.0]))[0, 0] == pytest.approx(3.0)
