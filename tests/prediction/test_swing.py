"""A load that swings when a recording begins: its line is found by what it does to the craft."""

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.model import EffectTerm, Estimate
from groundstation.prediction.prediction import observe_run, predict_observed
from support.flights import BASE, flown

LOAD = {"percent": 8.0, "length_m": 0.4, "damping_per_s": 0.2, "below_m": 0.01}
CARRYING = {"slung_load": LOAD, "mass_change": {"percent": 8.0}}
MODEL = msgspec.structs.replace(
    BASE,
    effects=tuple(
        EffectTerm(name, {key: Estimate(number) for key, number in values.items()})
        for name, values in CARRYING.items()
    ),
)
CUT, LATER = 6000, 5000


@pytest.fixture(scope="module")
def runs():
    """A whole flight, and the same from a row in mid-swing on."""
    run, _ = flown(40.0, 3, effects=CARRYING)
    return run, run[CUT:]


def errors(run):
    """Of predictions 20 ms ahead: row -> (9,)."""
    ahead = predict_observed(run, observe_run(MODEL, run), (10,))
    return dict(zip(ahead.rows.tolist(), ahead.errors(run)[:, 0], strict=True))


def test_it_is_known_some_seconds_later(runs):
    whole, cut = (errors(run) for run in runs)
    rows = [row for row in cut if row > LATER and row + CUT in whole]
    late, full = (
        np.array([one[row + shift] for row in rows]) for one, shift in ((cut, 0), (whole, CUT))
    )
    rms = [np.sqrt(np.nanmean(np.square(one[:, :6]), axis=0)) for one in (late, full)]
    np.testing.assert_array_less(rms[0], 1.4 * rms[1])


def test_whichever_way_the_craft_heads(runs):
    """The line's states are inertial, and corrections come in the body's axes."""
    run, _ = runs
    heading = np.unwrap(run.attitude[:, 2])
    assert np.ptp(heading[CUT:]) > np.radians(90.0)
    seen = observe_run(MODEL, run).states
    assert np.isfinite(seen).all()
    line = seen[-10000:, 19:22]
    np.testing.assert_allclose(np.linalg.norm(line, axis=1), 1.0, atol=0.1)
