"""The reports as data: what ``discrepancy --json`` and ``compare --json`` write, with the
sentences that stand in it."""

from __future__ import annotations

from typing import Literal

import msgspec
import numpy as np

from groundstation.comparison.comparison import Comparison, Place
from groundstation.comparison.gap import CHANNELS, HORIZONS_S, PER_SI, UNITS, overall
from groundstation.comparison.noise_floor import SOURCE
from groundstation.discrepancy.acceptance import WORTH
from groundstation.discrepancy.engine import Discrepancy
from groundstation.discrepancy.proof import (
    LEFT,
    Candidate,
    Changed,
    Explained,
    Findings,
    Left,
    Leftover,
    NotShown,
    Proof,
    Reason,
    what_is_left,
)
from groundstation.discrepancy.proof import EffectFound as EffectFound
from groundstation.discrepancy.proof import PossibleEffect as PossibleEffect
from groundstation.dynamics.meanings import suitability, verdict
from groundstation.dynamics.model import Disturbance

WORST = 10
UNIT = "RMS prediction error 20 and 50 ms ahead over the noise floor (1.0: nothing left to explain)"


class Level(msgspec.Struct, frozen=True):
    """An error before and after the effects were added (null where none were looked for), and
    what noise alone leaves."""

    before: float
    after: float | None
    noise_floor: float


class Proven(Level, frozen=True, kw_only=True):
    """The level on proof samples; with_disturbance: the same with an observer that follows the slow
    disturbance that each model leaves (null where none was looked for)."""

    with_disturbance: Level | None = None


class OwnUnit(msgspec.Struct, frozen=True):
    """A channel's ``Level`` in its own unit: both horizons together, and each by itself."""

    unit: str
    before: float
    after: float | None
    noise_floor: float
    horizons: dict[str, Level]


class ChannelGap(msgspec.Struct, frozen=True):
    """A channel's gap in units of its noise floor, and in its own."""

    before: float
    after: float | None
    noise_floor: float
    own_unit: OwnUnit


class Gap(msgspec.Struct, frozen=True):
    """How far the models are from the recordings; ``channels`` are those of ``validation``.
    further: the same of ``200ms`` and ``500ms`` ahead, over the noise floor there."""

    unit: str
    floor_source: str
    validation: Proven
    train: Level | None
    channels: dict[str, ChannelGap]
    further: dict[str, Level]

    @property
    def worse(self) -> dict[str, ChannelGap]:
        """Channels that the improved model predicts worse, by more than noise floors are off."""
        return {
            name: one
            for name, one in self.channels.items()
            if one.after is not None and one.after > LEFT * max(one.before, 1.0)
        }


class CompareReport(msgspec.Struct, frozen=True):
    """``compare --json``. good_for: the verdict on the model, empty where no fit of it is known."""

    where: list[Place]
    gap: Gap
    recordings: list[str]
    model: str
    attitude: Literal["body", "arx"] = "body"
    good_for: str = ""


class DiscrepancyReport(msgspec.Struct, frozen=True):
    """``discrepancy --json``. good_for: the verdict on the model that was found."""

    verdict: Literal["effects_found", "found_in_part", "no_discrepancy", "unexplained"]
    effects: list[EffectFound]
    base_changes: list[Changed]
    where: list[Place]
    where_after: list[Place]
    gap: Gap
    residual: Literal["white", "structured"]
    residual_detail: Leftover
    left: list[Left]
    candidates: list[Candidate]
    not_shown: list[NotShown]
    lost: dict[str, str]
    warnings: list[str]
    recordings: list[str]
    validation: list[str] | str
    model: str
    created_by: str
    explained: Explained | None = None
    disturbance: Disturbance | None = None
    possible: list[PossibleEffect] = []
    good_for: str = ""


def gap_of(
    before: Comparison,
    further: tuple[Comparison, Comparison | None],
    after: Comparison | None = None,
    train: tuple[Comparison, Comparison] | None = None,
    followed: tuple[Comparison, Comparison] | None = None,
) -> Gap:
    """The ``gap`` part: before and after on proof samples, the same with the disturbance
    ``followed``, ``further`` ahead, and on the samples that were fitted."""
    channels = {}
    for number, name in enumerate(CHANNELS):
        floor, error = before.noise_floor[number], before.rms[number]
        if not (np.isfinite(floor) and np.isfinite(error) and floor > 0):
            continue
        later = None if after is None else float(after.rms[number])
        unit = float(PER_SI[number])
        own = OwnUnit(
            UNITS[name],
            float(error) * unit,
            None if later is None else later * unit,
            float(floor) * unit,
            {
                f"{horizon * 1e3:.0f}ms": _at(before, after, k, number)
                for k, horizon in enumerate(HORIZONS_S)
            },
        )
        channels[name] = ChannelGap(
            float(error / floor), None if later is None else later / float(floor), 1.0, own
        )
    plain = level(before, after)
    return Gap(
        UNIT,
        SOURCE,
        Proven(
            plain.before,
            plain.after,
            1.0,
            with_disturbance=None
            if followed is None
            else Level(followed[0].beside(before), followed[1].beside(before), 1.0),
        ),
        None if train is None else level(*train),
        channels,
        {
            f"{horizon * 1e3:.0f}ms": _gap_at(*further, number)
            for number, horizon in enumerate(further[0].horizons_s)
        },
    )


def _gap_at(before: Comparison, after: Comparison | None, number: int) -> Level:
    error, floor = before.at_horizon(number)
    later = None if after is None else overall(after.at_horizon(number)[0], floor)
    return Level(overall(error, floor), later, 1.0)


def level(before: Comparison, after: Comparison | None) -> Level:
    """All channels in one number; the floor is 1 by definition."""
    later = None if after is None else after.beside(before)
    return Level(before.gap, later, 1.0)


def _at(before: Comparison, after: Comparison | None, horizon: int, channel: int) -> Level:
    unit = float(PER_SI[channel])
    error, floor = before.at_horizon(horizon)
    later = None if after is None else float(after.at_horizon(horizon)[0][channel]) * unit
    return Level(float(error[channel]) * unit, later, float(floor[channel]) * unit)


def discrepancy_report(
    found: Discrepancy,
    *,
    recordings: list[str],
    validation: list[str] | str,
    model: str,
    created_by: str,
) -> DiscrepancyReport:
    """The whole report on a search. validation: files, or how rows were held out."""
    findings, proof = found.findings, found.proof
    gap = gap_of(
        proof.before,
        proof.further,
        proof.after,
        (proof.train_before, proof.train_after),
        proof.followed,
    )
    account = {**findings.model.fit, "discrepancy": {"verdict": findings.verdict.value}}
    return DiscrepancyReport(
        verdict=findings.verdict.value,
        good_for=verdict(suitability(msgspec.structs.replace(findings.model, fit=account))),
        explained=proof.explained,
        disturbance=findings.model.disturbance,
        effects=list(findings.effects),
        possible=list(findings.possible),
        base_changes=list(findings.base_changes),
        where=proof.before.places,
        where_after=proof.after.places[:WORST],
        gap=gap,
        residual=findings.residual.verdict,
        residual_detail=findings.residual,
        left=what_is_left(proof.after),
        candidates=[
            msgspec.structs.replace(one, reason=_reason(one, findings))
            for one in sorted(findings.candidates, key=lambda one: -one.score)
        ],
        not_shown=list(findings.not_shown),
        lost=dict(findings.lost),
        warnings=[*findings.warnings, *_worse(gap), *_driven(proof)],
        recordings=recordings,
        validation=validation,
        model=model,
        created_by=created_by,
    )


def _reason(candidate: Candidate, findings: Findings) -> str:
    """Why it was refused. What alone explains much may only have looked like what was found."""
    if not candidate.refused_by:
        return "" if candidate.accepted else "another form of it is named"
    taken = ", ".join(effect.name for effect in findings.effects[:2])
    more = " and others" if len(findings.effects) > 2 else ""
    shared = candidate.refused_by == Reason.WEAK and candidate.score > WORTH and taken
    return f"nothing is left for it beside {taken}{more}" if shared else candidate.reason


def why_lost(reason: str) -> str:
    """A value of ``lost`` in words: a channel that is missing, or why it is not needed."""
    return f"{reason} is not recorded" if reason in ("accelerometer", "attitude") else reason


def _worse(gap: Gap) -> list[str]:
    """Channels on which the improved model is no improvement."""
    return [
        f"the improved model is worse on {name} on proof samples: gap {channel.before:.2f} before,"
        f" {channel.after:.2f} after"
        for name, channel in gap.worse.items()
    ]


def _driven(proof: Proof) -> list[str]:
    """What differs between search and proof where rotor speeds were measured."""
    if not all(np.isfinite(one.run.rotor_rev_s).all() for one in proof.before.errors):
        return []
    return [
        "rotor speeds are measured: the search uses them, the gaps are of models that are driven"
        " by PWM and battery voltage, unless it is said otherwise of a flight"
    ]
