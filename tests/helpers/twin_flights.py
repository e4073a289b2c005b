"""Flights of the stand-in for the twin, and the model that is right about them."""

import functools

from affected_flights import BASE, MEDIUM
from stand_in_flights import CARRYING_GAINS, recorded

from groundstation.twin.twin import episodes_of

__all__ = ["BASE", "MEDIUM", "flight", "told"]


@functools.cache
def flight(seconds, seed, name=None, loss=0.0, program="excite"):
    """Samples of one flight of the reduced stand-in, with an effect at medium size if named."""
    samples, _ = recorded(
        seconds,
        seed=seed,
        plant="reduced",
        gains=CARRYING_GAINS,
        copies=1,
        loss={"good_loss": loss},
        program=program,
        effects={} if name is None else {name: MEDIUM[name]},
    )
    return samples


def told(samples):
    """What the twin says of samples, as places and whether they began."""
    return [
        (each.place.channel, each.place.regime, each.end_s is None)
        for each in episodes_of(BASE, [samples])
    ]
