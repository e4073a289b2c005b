"""Compiled: how a disturbance would show in the observer's innovations, scored against them."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from groundstation.compiled import kernel

HOP = 8
"""Rows from one window to the next; a window is twice as long, weighted by a raised cosine."""
WINDOW_ROWS = 0.75 * HOP
"""Sum of the squared weights."""
POLES = 4
SHARE = 0.4
"""Of each row in each of the low-passes that smooth what would be seen: 12 ms late, and 0.004 of a
vibration near half the sample rate left, which the controller feeds into the inputs."""
EVERY = 4
"""Rows between those on which products of what would be seen are taken."""


@partial(kernel, fastmath=True)
def score(
    signals: Any,
    enters: Any,
    seen_at: Any,
    advance: Any,
    shown: Any,
    gain_fresh: Any,
    gain_stale: Any,
    fresh: Any,
    judged: Any,
    innovations: Any,
    error: Any,
    smooth: Any,
    place: int,
    bad: Any,
    felt: Any,
    shared: Any,
    square: Any,
    total: Any,
    energy: Any,
    meant: Any,
    mixed: Any,
) -> Any:
    """Correlate innovations with what each of s disturbances would make of them.

    What would be seen is smoothed first: rotors shake a craft near half the sample rate, and
    nothing that a model of rigid flight could tell is there. The innovations are not: through the
    controller later inputs answer to them, and whatever mixes a row with later ones would take
    the answer for a cause.

    signals: (n, s), row k acts from row k - 1 to k. enters: (e, s), what one unit adds to the
    observer's error over a row; seen_at: (9, s), what it adds to what is measured. advance:
    (e, e) an error over a row, shown: (12, e) what is measured of it; gains (e, 12).
    fresh, judged: (n,). innovations: (n, 9).
    Carried on: error (e, s), smooth (POLES, 9, s), place (returned), and for the two windows that
    are open, the one that ends first in front: bad (2,) rows not judged, felt (2, 9).
    Adds to square (10,): squared innovations, averaged over windows judged throughout, by
    channel, and the number of windows. In judged rows, by channel: total (9, s): innovations
    times what would be seen, smoothed; energy (9, s): squares of that; mixed, meant (9, m, s):
    its products with those of the signals that ``shared`` (m,) names, smoothed and as they are.
    """
    count = signals.shape[1]
    errors = len(advance)
    ahead, new = np.zeros((errors, count)), np.zeros((12, count))
    for k in range(len(signals)):
        ahead[:] = 0.0
        for i in range(errors):
            for m in range(errors):
                a = advance[i, m]
                if a != 0.0:
                    for s in range(count):
                        ahead[i, s] += a * error[m, s]
            for s in range(count):
                ahead[i, s] += enters[i, s] * signals[k, s]
        new[:] = 0.0
        rising = 0.5 - 0.5 * np.cos(np.pi * (place + 0.5) / HOP)
        if not judged[k]:
            bad[0] += 1
            bad[1] += 1
        for i in range(12):
            known = fresh[k] or i < 6 or i >= 9
            if known:
                for m in range(errors):
                    c = shown[i, m]
                    if c != 0.0:
                        for s in range(count):
                            new[i, s] += c * ahead[m, s]
            if i >= 9 or not known:
                continue
            v = innovations[k, i]
            felt[0, i] += (1.0 - rising) * v
            felt[1, i] += rising * v
            share = SHARE if i < 6 else 1.0
            for s in range(count):
                new[i, s] += seen_at[i, s] * signals[k, s]
                smooth[0, i, s] += share * (new[i, s] - smooth[0, i, s])
            for pole in range(1, POLES):
                for s in range(count):
                    smooth[pole, i, s] += share * (smooth[pole - 1, i, s] - smooth[pole, i, s])
            if judged[k]:
                for s in range(count):
                    total[i, s] += v * smooth[POLES - 1, i, s]
                    energy[i, s] += smooth[POLES - 1, i, s] ** 2
        if place % EVERY < 2 and judged[k]:  # a pair: one of them has a new attitude
            half = 0.5 * EVERY
            for i in range(9):
                if not fresh[k] and i >= 6:
                    continue
                weight = half
                for a in range(len(shared)):
                    one, other = (
                        weight * new[i, shared[a]],
                        weight * smooth[POLES - 1, i, shared[a]],
                    )
                    if abs(one) + abs(other) > 1e-12:
                        for s in range(count):
                            meant[i, a, s] += one * smooth[POLES - 1, i, s]
                            mixed[i, a, s] += other * smooth[POLES - 1, i, s]
        for i in range(errors):
            for s in range(count):
                error[i, s] = ahead[i, s]
            for m in range(12):
                g = gain_fresh[i, m] if fresh[k] else gain_stale[i, m]
                if g != 0.0:
                    for s in range(count):
                        error[i, s] -= g * new[m, s]
        place += 1
        if place == HOP:
            place = 0
            if bad[0] == 0:
                square[9] += 1.0
                for i in range(9):
                    square[i] += felt[0, i] ** 2
            bad[0], bad[1] = bad[1], 0
            for i in range(9):
                felt[0, i], felt[1, i] = felt[1, i], 0.0
    return place
