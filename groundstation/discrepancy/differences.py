"""What standard errors hold beside noise: what numbers differ by from flight to flight, a random
effect of each, a delay that rows leave open, and what no flight measures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from groundstation.discrepancy.blocks import Blocks
from groundstation.identification.estimate import inverse
from groundstation.identification.likelihood.motion import KEYS, VARIANTS, Point
from groundstation.telemetry.arrays import Array

DELAY = next(one.sizes[0] for one in VARIANTS if one.definition.stage == "delay")

UNWEIGHED = 0.1
"""Of a craft's mass, where nobody weighed it: decks, batteries and repairs are 3 g of 30."""
BY_MASS = ("kg", "N")
"""How units begin of what is reckoned by it."""
UNMEASURED_MOTORS = 0.03
"""Of a torque by its thrust, where neither a bench nor a sensor measured the motors: the slope of
their speed over voltage, which makes one, is the profile's, and crafts of one kind differ."""
INFORMED = 0.05
"""Share of the information on a number from which a flight takes part."""
CHANCE = 0.95
"""Of samples in which blocks of one size scatter less than this."""


def with_differences(errors: Mapping[str, float], blocks: Blocks) -> dict[str, float]:
    """Standard errors by key, with what flights differ by.

    blocks: of the last fit, at its point.
    """
    normal, _ = blocks.together()
    covariance = inverse(normal[: blocks.fitted, : blocks.fitted])
    wider = dict(errors)
    for n, key in enumerate(blocks.keys[: blocks.fitted]):
        if key in wider and covariance[n, n] > 0.0:  # else rows say nothing of it
            # The column without what all others imitate of it, by a unit of the number.
            alone = np.pad(covariance[:, n] / covariance[n, n], (0, len(normal) - blocks.fitted))
            trust = np.einsum("i,bij,j->b", alone, blocks.normal, alone)
            own = min(float(trust.sum()) * errors[key] ** 2, 1.0)  # the rest is the prior's
            more = own * difference(trust, blocks.gradient @ alone, blocks.flight)
            wider[key] = float(np.hypot(errors[key], more))
    return wider


def with_open_delay(errors: Mapping[str, float], blocks: Blocks, open_s: float) -> dict[str, float]:
    """Standard errors by key, with what a delay that the rows leave open moves each number by.

    open_s: the delay is anywhere between none and so much, either way. A delay that is fitted is
    not known better than that, and moves no other number.
    """
    if open_s == 0.0 or DELAY not in blocks.keys:
        return dict(errors)
    normal, _ = blocks.together()
    fitted, at = blocks.keys[: blocks.fitted], blocks.keys.index(DELAY)
    if DELAY in fitted:
        moved = np.eye(len(fitted))[at]
    else:
        moved = inverse(normal[: len(fitted), : len(fitted)]) @ normal[: len(fitted), at]
    spread = dict(zip(fitted, np.abs(moved) * open_s / np.sqrt(3.0), strict=True))
    return {key: float(np.hypot(error, spread.get(key, 0.0))) for key, error in errors.items()}


def with_unmeasured(
    errors: Mapping[str, float],
    point: Point,
    *,
    row_s: float,
    is_weighed: bool,
    motors_known: bool,
) -> dict[str, float]:
    """Standard errors by key, with what no flight tells of a size: the craft's mass, by which what
    is in kg or N is reckoned from accelerations; how its motors turn a voltage into speed, by
    which what moves the rotors is; and when within a row a setting began."""
    wider = dict(errors)
    for key in errors.keys() & point.keys() & KEYS.keys():
        size = abs(point[key] - KEYS[key].absent)
        unit, stage = KEYS[key].parameter.unit, KEYS[key].effect.stage
        more = [0.0]
        if not is_weighed and unit.startswith(BY_MASS):
            more.append(UNWEIGHED * size)
        if not motors_known and stage in ("body", "rotor") and KEYS[key].parameter.kind == "size":
            more.append(UNMEASURED_MOTORS * size)
        if key == DELAY:
            more.append(row_s / np.sqrt(12.0))
        wider[key] = float(np.hypot(errors[key], np.linalg.norm(more)))
    return wider


def difference(trust: Array, score: Array, flight: NDArray[np.int64]) -> float:
    """Standard error of a number that comes from flights being different, beside what noise within
    them makes.

    trust, score: (b,) of blocks of time, each of which tells a number score / trust from the joint
    one with precision trust; flight: that a block belongs to. The variance between flights is by
    moments (DerSimonian and Laird 1986), from what flights tell, or from what blocks tell where
    these differ by more than chance: two flights hardly tell a variance, and they differ at least
    as much as parts of one.
    """
    own = [np.bincount(flight, one) for one in (trust, score)]
    known = own[0] > INFORMED * own[0].sum()
    told = own[0][known]
    if not len(told):
        return 0.0
    variance, _ = _moments(told, own[1][known])
    within, above_chance = _moments(trust, score)
    variance = max(variance, within if above_chance else 0.0, 0.0)
    mean = 1.0 / float((1.0 / (1.0 / told + variance)).sum()) - 1.0 / float(told.sum())
    return float(np.sqrt(max(mean, 0.0)))


def _moments(trust: Array, score: Array) -> tuple[float, bool]:
    """(variance of a number between parts, whether they scatter by more than chance)."""
    trust, score = trust[trust > 0.0], score[trust > 0.0]
    whole, count = float(trust.sum()), len(trust)
    if count < 2:
        return 0.0, False
    scatter = float((score**2 / trust).sum()) - float(score.sum()) ** 2 / whole
    variance = (scatter - (count - 1)) / (whole - float(trust @ trust) / whole)
    return variance, scatter > 2.0 * float(gammaincinv(0.5 * (count - 1), CHANCE))
