"""How often each name is chosen where other stretches and flights count, and what then stands in
its place.

A resample gives each block of time and each flight a weight of its own (the Bayesian bootstrap,
Rubin 1981); the subset of names with the least penalised -2 log L is then a matter of small
matrices (stability selection, Meinshausen and Buehlmann 2010).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.discrepancy.blocks import Blocks
from groundstation.discrepancy.findings import Reason, Refusal
from groundstation.discrepancy.subsets import Subsets
from groundstation.identification.likelihood.motion import Point, Variant, absent
from groundstation.telemetry.arrays import Array

RESAMPLES = 100
RIVAL = 12.0
"""What explains so little less, in -2 log L, is an alternative: odds of one in 400."""
LEFT_OUT = (Reason.WEAK, Reason.INSIGNIFICANT, Reason.SUPERFLUOUS)
"""Refusals that other rows may lift."""
INSTEAD, OFTENER = 0.1, 2.0
"""Share of resamples from which what stood in a name's place is an alternative, and how much
oftener it stood there than beside the name."""


@dataclass(frozen=True, slots=True)
class Instead:
    """Another name. margin: how much less it explains in a name's place, in penalised -2 log L;
    share: of resamples in which it was chosen and the name was not."""

    name: str
    margin: float
    share: float


@dataclass(frozen=True, slots=True)
class Recurrence:
    """share: of resamples in which a name was chosen; instead: what stands for it, likely first."""

    share: float
    instead: tuple[Instead, ...] = ()


def asked_again(
    candidates: Sequence[Variant], refused: Mapping[str, Refusal], found: Sequence[Variant]
) -> list[Variant]:
    """Candidates that were not found, and that nothing else than other rows has to let in."""
    out = {one.label for one in found}
    out |= {label for label, why in refused.items() if why.reason not in LEFT_OUT}
    return [one for one in candidates if one.label not in out]


def recurrences(
    blocks: Blocks, point: Point, found: Sequence[Variant], others: Sequence[Variant]
) -> dict[str, Recurrence]:
    """How often each of ``found`` is chosen beside all ``others``, by label.

    blocks: at ``point``, with columns of the constants, of what was found and of the others.
    """
    variants = [*found, *others]
    mine = {key for one in found for key in one.keys}  # shapes stay as they were fitted
    base = [key for key in blocks.keys[: blocks.fitted] if key not in mine]
    blocks = blocks.of([*base, *(key for one in variants for key in one.sizes)])
    absences = [absent(key) - point.get(key, absent(key)) for one in variants for key in one.sizes]
    blocks = blocks.seen_from(np.pad(absences, (len(blocks.keys) - len(absences), 0)))
    start, flights = frozenset(range(len(found))), len(np.unique(blocks.flight))
    chosen = np.zeros((RESAMPLES, len(variants)), np.bool_)
    random = np.random.default_rng(0)
    for row in chosen:
        weights = random.exponential(size=len(blocks.flight))
        if flights > 1:
            weights *= random.exponential(size=flights)[blocks.flight]
        resampled = blocks.weighed(weights / weights.mean())
        row[list(Subsets(variants, point, *resampled).best(start))] = True
    as_it_is = Subsets(variants, point, *blocks.together())
    beside = np.maximum(as_it_is.beside(start), 0.0)
    found_again = {}
    for number, one in enumerate(found):
        alone = as_it_is.beside(start - {number})
        with np.errstate(invalid="ignore"):  # neither possible alone nor beside: no margin
            margins = alone[number] - (alone - beside)
        share = float(chosen[:, number].mean())
        instead = _alternatives(variants, number, margins, chosen)
        found_again[one.label] = Recurrence(share, instead)
    return found_again


def _alternatives(
    variants: Sequence[Variant], number: int, margins: Array, chosen: NDArray[np.bool_]
) -> tuple[Instead, ...]:
    """By name, the likely first; none of the name itself, of another rotor say.

    margins: (v,) by which each variant is worth less in the name's place, beyond what it is worth
    beside it. chosen: (resamples, v).
    """
    there = chosen[:, number]
    stood = chosen[~there].sum(axis=0)
    rate, usual = stood / max(np.sum(~there), 1), chosen[there].sum(axis=0) / max(there.sum(), 1)
    found: dict[str, Instead] = {}
    for other, one in enumerate(variants):
        share, margin, name = float(stood[other]) / len(chosen), float(margins[other]), one.effect
        if not np.isfinite(margin) or name == variants[number].effect:
            continue
        if margin < RIVAL or (share >= INSTEAD and rate[other] > OFTENER * usual[other]):
            before = found.get(name)
            if before is None or (share, -margin) > (before.share, -before.margin):
                found[name] = Instead(name, margin, share)
    return tuple(sorted(found.values(), key=lambda one: (-one.share, one.margin)))
