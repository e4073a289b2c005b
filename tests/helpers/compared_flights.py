"""Flights of the stand-in as the discrepancy search reads them, and models that know the effect."""

import functools

from affected_flights import BASE
from stand_in_flights import CARRYING_GAINS, recorded

from groundstation.comparison.comparison import compare
from groundstation.identification.recordings import flights_of

SECONDS = 40.0


@functools.cache
def flights(seed, plant="reduced", effects=(), seconds=SECONDS, loss=0.0, **settings):
    """Runs of one flight. effects: ((name, ((parameter, value), ...)), ...)."""
    samples, _ = recorded(
        seconds,
        seed=seed,
        plant=plant,
        gains=CARRYING_GAINS,
        copies=1,
        loss={"good_loss": loss},
        effects={name: dict(values) for name, values in effects},
        **settings,
    )
    return tuple(flights_of(samples, f"flight{seed}"))


def hidden(name, values):
    """The ``effects`` of ``flights`` for one effect."""
    return ((name, tuple(sorted(values.items()))),)


@functools.cache
def judged(**settings):
    """The base model on a flight that the noise floor was not learnt on."""
    learnt = compare(flights(1, **settings), BASE)
    return compare(flights(2, **settings), BASE, learnt.black_box)
