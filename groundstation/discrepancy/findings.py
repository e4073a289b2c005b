"""What a search for missing effects found: the dataclasses that reports and commands read.

``find_effects(flights, model, validation=None, *, seed=0, progress=None) -> Findings`` in
``engine.py`` makes it; flights and validation are runs as ``recordings.flights_of`` gives them,
progress is called with what is being done and the share done. Everything in it is plain numbers
in the units of the model file, so that a report needs no knowledge of how it was found.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from groundstation.dynamics.model import Estimate, Model

CHANNELS = (
    "gyro_x",
    "gyro_y",
    "gyro_z",
    "accelerometer_x",
    "accelerometer_y",
    "accelerometer_z",
    "roll",
    "pitch",
    "yaw",
)


class Verdict(StrEnum):
    """The outcome in one word, as in the report's JSON."""

    EFFECTS_FOUND = "effects_found"
    """At least one named effect passed every test."""
    NO_DISCREPANCY = "no_discrepancy"
    """Nothing is left to explain that these recordings could show."""
    UNEXPLAINED = "unexplained"
    """Residuals are structured and no known effect fits them."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """Another name that explains nearly as much.

    margin: how much worse its penalised likelihood is (difference of -2 log L; 0 is equal, 10
    is one chance in 150). manoeuvre: what to fly to tell the two apart.
    """

    name: str
    margin: float
    manoeuvre: str


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """An accepted effect.

    order: 1 for the first one accepted. parameters: by name, in the model file's units, from
    the last joint fit. evidence: ``likelihood_ratio`` (drop of -2 log L when it joined), ``t``
    (from scores summed over blocks of time), ``held_out`` (drop of -2 log L on the validation
    rows), ``axes`` and ``recordings`` (standard deviations by which parts disagree).
    gap_before, gap_after: RMS of the whitened one-step residual on held-out rows over the
    channels the effect touches, 1.0 being noise, before and after it joined. model: as it was
    when this effect had joined. adds: its law in words.
    """

    name: str
    order: int
    parameters: dict[str, Estimate]
    evidence: dict[str, float]
    alternatives: tuple[Alternative, ...]
    gap_before: float
    gap_after: float
    channels: tuple[str, ...]
    model: Model
    adds: str = ""


@dataclass(frozen=True, slots=True)
class Candidate:
    """What came of one effect, accepted or not.

    score: drop of -2 log L when it alone joins the base (screening). t: its largest
    parameter over its standard error. held_out: drop of -2 log L on held-out rows in
    the last round it took part in. reason: why it was refused, empty where accepted.
    """

    name: str
    parameters: dict[str, Estimate]
    score: float
    t: float
    held_out: float
    accepted: bool
    reason: str


@dataclass(frozen=True, slots=True)
class NotShown:
    """An effect that these recordings cannot show.

    stderr: that they would give to ``parameter``; plausible: a usual size of it; manoeuvre: what
    to fly, or which channel to record.
    """

    name: str
    parameter: str
    stderr: float
    plausible: float
    unit: str
    manoeuvre: str


@dataclass(frozen=True, slots=True)
class ChannelResidual:
    """One channel's one-step residual on held-out rows.

    before, after: whitened RMS with the re-fitted base and with the improved model; floor: what
    a fit of every candidate at once leaves (near 1).
    """

    before: float
    after: float
    floor: float


@dataclass(frozen=True, slots=True)
class Leftover:
    """What is left after the last accepted effect.

    verdict: ``white`` or ``structured``. channel: the worst one. frequencies_hz: where its
    residual rises above coloured noise. signal: the strongest generic signal in it, in words.
    excess: residual over expected power of that channel where it is worst.
    """

    verdict: str
    channel: str = ""
    frequencies_hz: tuple[float, ...] = ()
    signal: str = ""
    excess: float = 1.0


@dataclass(frozen=True, slots=True)
class Findings:
    """The outcome of ``find_effects``.

    effects: accepted, in order. base: the model as it was given. model: base and effects fitted
    jointly. candidates: every effect, strongest first. not_shown: excitation check. lost: effect
    name -> the channel that is missing to show it. channels: by channel name. warnings: in words.
    """

    verdict: Verdict
    effects: tuple[FoundEffect, ...]
    base: Model
    model: Model
    candidates: tuple[Candidate, ...]
    not_shown: tuple[NotShown, ...]
    lost: dict[str, str]
    channels: dict[str, ChannelResidual]
    residual: Leftover
    warnings: tuple[str, ...] = field(default=())
