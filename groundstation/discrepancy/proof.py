"""The proof of a finding: gaps before and after on samples that decided nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from groundstation.comparison.comparison import Comparison
from groundstation.comparison.gap import CHANNELS, FURTHER_EVERY_S, AheadErrors
from groundstation.discrepancy.findings import (
    Findings,
    FoundEffect,
    Predicted,
    Reason,
    Refusal,
    Verdict,
)
from groundstation.dynamics.model import Disturbance, Model
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import filled

GIVEN, BASE = "given model", "base constants"
"""Names of the first steps of a proof."""
BLOCK_S = 1.0
"""Errors of neighbouring rows share their rows; those of seconds apart do not."""
LEAST_SHARE = 0.02
"""Of a prediction error, the least that counts as a change."""
WORSE_T = 1.0
"""A channel is predicted worse where the mean squared error grows by so many standard errors,
from the spread of blocks, and the RMS by ``LEAST_SHARE``: a doubt counts against what was found,
and what does not change a prediction is no doubt."""
LEAST_BLOCKS = 3
KEPT = 4
"""Predictions of a minute take 10 MB, and a search asks for fifty."""
LEFT = 1.1
"""A channel's gap from which something is left in it: what noise floors are off by (docs). One
whose RMS grows so many times beyond what it was and beyond noise is predicted worse whatever its
blocks scatter: errors that all lie in one second (a model that believes it has left the ground)
have no standard error, and whoever flies the model meets them."""
FELL = 0.03
"""Of the gap on proof samples, the least by which it has to fall for anything to be called found:
noise floors of two flights differ by as much."""
BANDS_HZ = (0.0, 0.5, 2.0, 8.0, 30.0, 1000.0)
"""Trim and drift, translation, attitude control, rotors and filters, vibration."""


class Explained(msgspec.Struct, frozen=True):
    """What the given model got wrong on proof samples, as shares (sum 1) of its squared excess over
    noise: by what follows them it is explained, and what is left."""

    named: float
    constants: float
    disturbance: float
    left: float

    def words(self, slow: Disturbance | None) -> str:
        """The sum as a sentence."""

        def percent(share: float) -> str:
            return f"{100.0 * share:.0f} %"

        without = "" if slow is None else f" ({slow})"
        return (
            f"of what the given model got wrong, named effects explain {percent(self.named)},"
            f" changed constants {percent(self.constants)}, a slow disturbance without a name"
            f" follows {percent(self.disturbance)}{without}, {percent(self.left)} is left"
        )


@dataclass(frozen=True, slots=True)
class Proof:
    """The given and the improved model, on the samples they were fitted to and on others.

    before, after: without a disturbance; followed: (given, improved) each with its own; further:
    both without it, 200 and 500 ms ahead. steps:
    (what changed, the gap on proof samples with it): the given model, the constants that moved, if
    any did, then each effect in order. explained: None where the given model leaves no more than
    noise.
    """

    train_before: Comparison
    train_after: Comparison
    before: Comparison
    after: Comparison
    followed: tuple[Comparison, Comparison]
    further: tuple[Comparison, Comparison]
    steps: tuple[tuple[str, float], ...]
    explained: Explained | None


class Left(msgspec.Struct, frozen=True):
    """What the improved model leaves in a channel, 50 ms ahead: gap, the band (Hz) in which most of
    it lies, and that band's share of all that is beyond noise.

    words: ``gyro_x: 1.40 times noise, 80 % of the excess 0.5 to 2 Hz``.
    """

    channel: str
    gap: float
    band_hz: tuple[float, float]
    share: float
    words: str


class Predictions:
    """A given model on some rows, and others beside it; the last few are not predicted again."""

    def __init__(self, before: Comparison, every_s: float = 0.0, kept: int = KEPT) -> None:
        self.before, self._every_s, self._kept = before, every_s, kept
        self._last: dict[bytes, Comparison] = {}

    def of(self, model: Model, near: Comparison | None = None) -> Comparison:
        """Another model on the same rows. near: of one that it hardly differs from, and whose
        observer suits it."""
        key = _numbers(model)
        if key == _numbers(self.before.model):
            return self.before
        found = self._last.pop(key, None)
        if found is None:
            like = self.before if near is None else near
            found = like.with_model(model, self._every_s, near is not None)
        self._last[key] = found
        if len(self._last) > self._kept:
            del self._last[next(iter(self._last))]
        return found


class FittedRows(Predictions):
    """The same, with what decides: the gap, and the channels that are predicted worse.

    every_s: predictions start no more often than that.
    """

    def __init__(self, before: Comparison, every_s: float = 0.0) -> None:
        super().__init__(before.with_model(before.model, every_s) if every_s else before, every_s)
        self._judged: dict[bytes, Predicted] = {}

    def judge(self, model: Model) -> Predicted:
        """The gap of another model, and the channels on which it is worse than the given one."""
        key = _numbers(model)
        if key not in self._judged:
            after = self.of(model)
            gaps = tuple((after.rms / self.before.noise_floor).tolist())
            worse = worse_channels(self.before, after)
            self._judged[key] = Predicted(after.beside(self.before), worse, gaps)
        return self._judged[key]

    def squares(self, model: Model, near: Comparison | None = None) -> Array:
        """What each second adds to a model's squared gap, by channel (s, 9); NaN for a channel that
        is not there."""
        after, there = self.of(model, near), np.isfinite(self.before.rms)
        values = np.concatenate([h for one in after.errors for h in one.horizons])
        blocks = np.concatenate([_squares_by_blocks(one) for one in after.errors])
        scale = self.before.noise_floor**2 * np.isfinite(values).sum(axis=0) * there.sum()
        return np.where(there, np.nan_to_num(blocks), np.nan) / np.where(there, scale, np.nan)


def _numbers(model: Model) -> bytes:
    """All that a prediction depends on."""
    effects = sorted(
        (term.name, sorted((key, one.value) for key, one in term.parameters.items()))
        for term in model.effects
    )
    return msgspec.json.encode((model.motor, model.motors, model.body, effects, model.disturbance))


def prove(findings: Findings, train: Predictions, rows: Predictions) -> tuple[Findings, Proof]:
    """Predict proof samples with each step from the given model to the improved one; the findings
    with these gaps. They choose no name and no size, but take the word back: what they contradict
    is possible, not found (``_upheld``).

    train: the given model on the samples that were fitted; the noise floor is learnt on them, and
    is the same before and after.
    """
    before, plain = rows.before, bare(findings.model)
    after = rows.of(plain)
    findings = _upheld(findings, rows, after)
    steps = [(GIVEN, before.gap)]
    moved = bool(findings.base_changes) or findings.moved.effects != findings.base.effects
    if moved:
        steps.append((BASE, rows.of(findings.moved).beside(before)))
    first, effects = steps[-1][1], []
    for found in findings.effects:
        gap = rows.of(found.model, after).beside(before)
        effects.append(replace(found, gap_before=steps[-1][1], gap_after=gap))
        steps.append((found.name, gap))
    last = after.beside(before)
    whole = first**2 - last**2 if falls(first, last) else math.nan
    weighed = [
        replace(one, weight=(one.gap_before**2 - one.gap_after**2) / whole) for one in effects
    ]
    followed = rows.of(findings.given), rows.of(findings.model)
    alone = rows.of(_only_named(findings)).beside(before) if moved else after.beside(before)
    ends = before.gap, first, alone, after.beside(before), followed[1].beside(before)
    far = before.further(train.before.further().black_box)
    further = far, far.with_model(plain, FURTHER_EVERY_S)
    proof = Proof(
        train.before,
        train.of(plain),
        before,
        after,
        followed,
        further,
        tuple(steps),
        explained_by(*ends) if falls(before.gap, last) else None,
    )
    return replace(findings, effects=tuple(weighed)), proof


def falls(before: float, after: float) -> bool:
    """Whether a gap falls by as much as counts."""
    return after <= (1.0 - FELL) * before


def _upheld(findings: Findings, rows: Predictions, after: Comparison) -> Findings:
    """The findings without the names that proof samples contradict: all, where the gap does not
    fall, or grows where it was within noise before; those with which a channel of their own is
    predicted worse, beside the others, than without. They stay fitted along, as what is possible
    does."""
    before, last = rows.before.gap, after.beside(rows.before)
    refused: dict[str, Refusal] = {}
    if falls(before, last) or (before <= LEFT and last <= (1.0 + FELL) * before):
        refused = _contradicted(findings, after)
    else:
        words = f"prediction errors of proof samples do not fall by {100.0 * FELL:g} %"
        refused = {one.name: Refusal(Reason.WITHOUT_WEIGHT, words) for one in findings.effects}
    if not refused:
        return findings
    doubted = [
        replace(one, order=0, refused=refused[one.name])
        for one in findings.effects
        if one.name in refused
    ]
    terms = {term.name: term for term in findings.model.effects}
    along = (*findings.moved.effects, *(terms[one.name] for one in doubted))
    kept: list[FoundEffect] = []
    for one in findings.effects:
        if one.name not in refused:
            named = (*(terms[other.name] for other in kept), terms[one.name])
            model = msgspec.structs.replace(bare(findings.model), effects=(*along, *named))
            kept.append(replace(one, order=len(kept) + 1, model=model))
    verdict = findings.verdict
    if verdict is Verdict.EFFECTS_FOUND and not kept:
        verdict = Verdict.UNEXPLAINED if rows.before.gap > LEFT else Verdict.NO_DISCREPANCY
    return replace(
        findings,
        verdict=verdict,
        effects=tuple(kept),
        possible=(*findings.possible, *doubted),
        moved=msgspec.structs.replace(findings.moved, effects=along),
        candidates=tuple(
            replace(one, accepted=False, refused=refused[one.name]) if one.name in refused else one
            for one in findings.candidates
        ),
    )


def _contradicted(findings: Findings, after: Comparison) -> dict[str, Refusal]:
    """Effects with which a channel of their own is predicted worse, by name: the one that harms the
    most first, and others only where they do without it as well."""
    refused: dict[str, Refusal] = {}
    now = after.with_model(after.model, FURTHER_EVERY_S)
    while True:
        harm: dict[str, tuple[float, Comparison, str]] = {}
        for one in findings.effects:
            if one.name in refused:
                continue
            others = tuple(term for term in now.model.effects if term.name != one.name)
            model = msgspec.structs.replace(now.model, effects=others)
            without = now.with_model(model, FURTHER_EVERY_S)
            for channel in worse_channels(without, now):
                name, growth = CHANNELS[channel], float(now.rms[channel] / without.rms[channel])
                if name in one.channels and growth > harm.get(one.name, (0.0,))[0]:
                    harm[one.name] = growth, without, name
        if not harm:
            return refused
        worst = max(harm, key=lambda name: harm[name][0])
        _, now, channel_name = harm[worst]
        words = f"with it {channel_name} of proof samples is predicted worse than without"
        refused[worst] = Refusal(Reason.PREDICTS_WORSE, words)


def bare(model: Model) -> Model:
    """A model without its disturbance."""
    return msgspec.structs.replace(model, disturbance=None)


def _only_named(findings: Findings) -> Model:
    """The given model with the named effects and its own constants."""
    names = {one.name for one in findings.effects}
    given = bare(findings.base)
    added = (term for term in findings.model.effects if term.name in names)
    return msgspec.structs.replace(given, effects=(*given.effects, *added))


def explained_by(
    given: float, moved: float, named: float, both: float, followed: float
) -> Explained | None:
    """The shares, from the gaps of the given model, with other constants, with the named effects,
    with both, and with a disturbance beside them; None where nothing is to explain.

    Constants and effects make up for each other, and what comes first would be charged for the
    other's absence: each has the mean over both orders (Shapley 1953), or constants come first
    where the effects alone predict no number.
    """
    excess = given**2 - 1.0
    if given < LEFT:
        return None
    effects = moved**2 - both**2
    if math.isfinite(named):
        effects = 0.5 * (effects + given**2 - named**2)
    return Explained(
        effects / excess,
        (given**2 - both**2 - effects) / excess,
        (both**2 - followed**2) / excess,
        (followed**2 - 1.0) / excess,
    )


def worse_channels(before: Comparison, after: Comparison) -> dict[int, float]:
    """Channels that are predicted worse: number -> by how many standard errors, at least
    ``WORSE_T``; without end where the other model predicts no number at all."""
    growth = after.rms > (1.0 + LEAST_SHARE) * before.rms
    anyhow = after.rms > LEFT * np.maximum(before.rms, before.noise_floor)
    lost = np.isfinite(before.rms) & ~np.isfinite(after.rms)
    blocks = np.concatenate(
        [_block_sums(one, other) for one, other in zip(before.errors, after.errors, strict=True)]
    )
    found = dict.fromkeys(np.flatnonzero(lost).tolist(), math.inf)
    for channel in np.flatnonzero(growth).tolist():
        sums = blocks[np.isfinite(blocks[:, channel]), channel]
        t = 0.0
        if len(sums) >= LEAST_BLOCKS:
            t = float(sums.mean() / max(sums.std(ddof=1) / np.sqrt(len(sums)), 1e-300))
        if t > WORSE_T or anyhow[channel]:
            found[channel] = max(t, WORSE_T)
    return found


def what_is_left(after: Comparison) -> list[Left]:
    """Channels whose errors are clearly beyond noise, the worst first."""
    found = []
    ratio = after.rms / after.noise_floor
    for channel in np.flatnonzero(ratio > LEFT).tolist():
        beyond = np.zeros(len(BANDS_HZ) - 1)
        for error, floor in zip(after.errors, after.floors, strict=True):
            power = (
                _band_power(part.horizons[-1][:, channel], error.run.period_s)
                for part in (error, floor)
            )
            beyond += np.subtract(*power)
        beyond = np.maximum(beyond, 0.0)
        band = int(np.argmax(beyond))
        share = float(beyond[band] / max(beyond.sum(), 1e-300))
        low, high = BANDS_HZ[band : band + 2]
        where = f"above {low:g} Hz" if low == BANDS_HZ[-2] else f"{low:g} to {high:g} Hz"
        name, gap = CHANNELS[channel], float(ratio[channel])
        words = f"{name}: {gap:.2f} times noise, {100.0 * share:.0f} % of the excess {where}"
        found.append(Left(name, gap, (low, high), share, words))
    return sorted(found, key=lambda one: -one.gap)


def _band_power(values: Array, period_s: float) -> Array:
    """Energy of errors (n,) in each of ``BANDS_HZ``; rows that were not judged are bridged."""
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < 2:
        return np.zeros(len(BANDS_HZ) - 1)
    rows = filled(values[known[0] : known[-1] + 1])
    power = np.abs(np.fft.rfft(rows)) ** 2 / len(rows)
    hz = np.fft.rfftfreq(len(rows), period_s)
    place = np.clip(np.searchsorted(BANDS_HZ, hz, side="right") - 1, 0, len(BANDS_HZ) - 2)
    return np.asarray(np.bincount(place, power, len(BANDS_HZ) - 1), np.float64)


def _block_sums(before: AheadErrors, after: AheadErrors) -> Array:
    """Growth of the squared error over both horizons, summed over blocks of time, (blocks, 9); NaN
    where nothing was judged."""
    return _squares_by_blocks(after) - _squares_by_blocks(before)


def _squares_by_blocks(errors: AheadErrors) -> Array:
    """Squared errors over both horizons, summed over blocks of time, (blocks, 9); NaN where nothing
    was judged."""
    squares = np.stack(errors.horizons) ** 2
    known = np.isfinite(squares)
    rows = np.where(known, squares, 0.0).sum(axis=0)
    block = np.arange(len(rows)) * errors.run.period_s // BLOCK_S
    starts = np.flatnonzero(np.diff(block, prepend=-1.0))
    counted = np.add.reduceat(known.any(axis=0), starts, axis=0)
    return np.where(counted > 0, np.add.reduceat(rows, starts, axis=0), np.nan)
