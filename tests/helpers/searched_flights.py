"""Flights of the stand-in as the search for missing effects gets them."""

from functools import cache

import numpy as np
from stand_in_flights import CARRYING_GAINS, recorded

from groundstation.dynamics.model import Model, vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.identification.recordings import flights_of

SPAN_S = 25.0
"""Tried at 25, 40 and 60 s: most show at 25 s what they show at 60 s. Those that do not say so."""
BENCH_ERRORS = np.array([1e-4, 1e-3, 2e-6])


def base_model() -> Model:
    """The true base model of the stand-in's craft, its motor as a good bench would know it."""
    import msgspec

    model = vehicle_model(load_vehicle("crazyflie1"))
    estimates = {
        "names": ["a0", "a1", "a2"],
        "covariance": np.diag(BENCH_ERRORS**2).tolist(),
    }
    return msgspec.structs.replace(model, fit={"motor": {"estimates": estimates}})


@cache
def _samples(seed, effects, span_s, more):
    chosen = {name: dict(values) for name, values in effects}
    settings = {"plant": "reduced", "gains": CARRYING_GAINS, **dict(more)}
    return recorded(span_s, seed=seed, effects=chosen, **settings)[0]


def samples(seed, effects=None, span_s=SPAN_S, **more):
    """Excitation; the same settings give the same samples without flying again."""
    frozen = tuple((name, tuple(values.items())) for name, values in (effects or {}).items())
    return _samples(seed, frozen, span_s, tuple(more.items()))


def flights(seed, effects=None, count=2, **more):
    """Runs of ``count`` flights, and of one more to validate on."""
    runs = [
        run
        for number in range(count + 1)
        for run in flights_of(samples(10 * seed + number, effects, **more), f"flight{number}")
    ]
    return runs[:count], runs[count:]
