"""Random numbers that live in the state record: xoroshiro128+ (Blackman and Vigna, 2018).

Kept in the state, a flight is the same however its time is sliced.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_sim.compiled import inner

_24, _37, _11, _16 = (np.uint64(n) for n in (24, 37, 11, 16))
_40, _27 = np.uint64(64 - 24), np.uint64(64 - 37)
_UNIT = 2.0**-53


def seeded(seed: int, streams: int) -> NDArray[np.uint64]:
    """Independent initial states, shape (streams, 2)."""
    words = np.random.SeedSequence(seed).generate_state(2 * streams, np.uint64)
    return words.astype(np.uint64).reshape(streams, 2)


@inner
def uniform(states: Any, stream: int) -> float:
    """The next number of a stream in [0, 1)."""
    first = states[stream, 0]
    second = states[stream, 1]
    word = first + second
    second ^= first
    states[stream, 0] = ((first << _24) | (first >> _40)) ^ second ^ (second << _16)
    states[stream, 1] = (second << _37) | (second >> _27)
    return (word >> _11) * _UNIT


@inner
def normal(states: Any, stream: int) -> float:
    """The next standard normal number of a stream (Box-Muller)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(states, stream)))
    return radius * math.cos(2.0 * math.pi * uniform(states, stream))
