"""Did it help? All crafts before and after a date: a new propeller, firmware, battery."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from groundstation.errors import BadInputError
from groundstation.fleet.findings import FALSE_SHARE, Series
from groundstation.fleet.flight_fit import QUANTITIES, RELATIVE, WORDS
from groundstation.fleet.population import (
    LEAST_CRAFTS,
    MEDIAN_STDERR,
    discoveries,
    excess_variance,
    level,
    scatter_variance,
)

LEAST_FLIGHTS = 2
"""Of a craft on either side."""
LEAST_PAIR = 2
"""The median of so few is their mean."""


@dataclass(frozen=True, slots=True)
class Shift:
    """A quantity after the date less before it, median of the crafts. size, stderr: a share where
    the quantity is one, otherwise in its unit; crafts: that flew on both sides; with_it: how many
    of them moved that way; p: how often chance does as much; believed: beyond the stated rate."""

    quantity: str
    size: float
    stderr: float
    crafts: int
    with_it: int
    p: float
    believed: bool

    @property
    def text(self) -> str:
        """In words."""
        sure = "" if self.believed else ": within what chance does"
        return (
            f"{WORDS[self.quantity]} {100 * self.size:+.1f} +- {100 * self.stderr:.2g} %"
            f" ({self.with_it} of {self.crafts} crafts that way){sure}"
        )


def parse_date(text: str) -> str:
    """An ISO date or time (UTC unless it says otherwise) as catalogues hold it.

    Raises BadInputError.
    """
    try:
        when = datetime.fromisoformat(text)
    except ValueError as error:
        raise BadInputError(
            f"--compare-before {text}: not a date; for example 2026-05-01 or 2026-05-01T12:00"
        ) from error
    when = when.replace(tzinfo=UTC) if when.tzinfo is None else when.astimezone(UTC)
    return when.isoformat(timespec="seconds")


def shifts(series: Sequence[Series], date: str) -> tuple[Shift, ...]:
    """Of each quantity that some craft has flown before ``date`` and since.

    Crafts need not all shift alike: their own spread of shifts counts. A median, for one craft that
    crashed in between says nothing of the change that all were given.
    """
    found = []
    for name in QUANTITIES:
        of = [one for one in series if one.quantity == name]
        extra, freedom = scatter_variance([(one.values, one.errors) for one in of])
        moved, variance = [], []
        for one in of:
            old = np.array([begun < date for begun in one.begun])
            if min(old.sum(), (~old).sum()) < LEAST_FLIGHTS:
                continue
            each = one.errors**2 + extra + 1e-12
            (before, u), (after, v) = (level(one.values[k], each[k]) for k in (old, ~old))
            moved.append(after - before)
            variance.append(u + v)
        if moved:
            found.append(_shift(name, np.array(moved), np.array(variance), freedom))
    believed = discoveries(np.array([one[-1] for one in found]), FALSE_SHARE)
    return tuple(
        Shift(*told, believed=bool(true)) for told, true in zip(found, believed, strict=True)
    )


def _shift(
    name: str, moved: np.ndarray, variance: np.ndarray, freedom: float
) -> tuple[str, float, float, int, int, float]:
    from scipy.stats import t

    between = 0.0
    if len(moved) >= LEAST_CRAFTS:
        between = excess_variance(moved - np.median(moved), variance)
        freedom = min(freedom, len(moved) - 1.0)
    size = float(np.median(moved))
    stderr = math.sqrt(level(moved, variance + between)[1])
    if len(moved) > LEAST_PAIR:
        stderr *= MEDIAN_STDERR
    p = 2.0 * float(t.sf(abs(size) / stderr, freedom))
    with_it = int((np.sign(moved) == np.sign(size)).sum())
    share = math.expm1(size) if name in RELATIVE else size
    return name, share, stderr, len(moved), with_it, p
