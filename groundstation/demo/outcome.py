"""What came of it: the seal is opened, and every claim of the story is held against the files."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.gap import PER_SI
from groundstation.demo.story import CRAFT_FILE, FLIGHT_S, PID_FLIGHTS, SEALED, Told, only
from groundstation.discrepancy.report_json import DiscrepancyReport
from groundstation.dynamics.registry import EFFECTS
from groundstation.identification.runs import Run, runs_of
from groundstation.recording.open_recording import open_recording

Array = NDArray[np.float64]
Hidden = dict[str, dict[str, float]]
"""Effect -> parameter -> value."""

IN_THE_AIR_S = (5.0, 35.0)
"""Of the story's flights: between take-off and landing, whose knocks tell nothing of a model."""
READABLE = {"s": (1e3, "ms"), "m": (1e3, "mm")}


@dataclass(frozen=True, slots=True)
class Claim:
    """A sentence of the story, and whether it came true."""

    name: str
    text: str
    true: bool


@dataclass(frozen=True, slots=True)
class Distance:
    """How far two flights are from the hidden craft's, channel by channel.

    old, new: RMS difference (9,) of the first and of the improved model's flight, in the units of
    reports. moved: by how much the hidden craft's channels vary (9,), standard deviation.
    """

    old: Array
    new: Array
    moved: Array

    @property
    def overall(self) -> tuple[float, float]:
        """RMS over the channels of the share of their movement, old and new."""
        return float(_rms(self.old / self.moved)), float(_rms(self.new / self.moved))


@dataclass(frozen=True, slots=True)
class Outcome:
    """seed: of the story. found: the discrepancy report. noticed: the twin's events. flown: what
    ``pid fly`` said, None where it was skipped."""

    folder: Path
    seed: int
    told: Told
    hidden: Hidden
    found: DiscrepancyReport
    distance: Distance
    noticed: list[dict[str, Any]]
    flown: dict[str, Any] | None
    claims: tuple[Claim, ...]

    @property
    def good(self) -> bool:
        return all(claim.true for claim in self.claims)

    def as_dict(self) -> dict[str, Any]:
        """For ``demo --json``."""
        gap = self.found.gap.validation
        return {
            "seed": self.seed,
            "good": self.good,
            "hidden": self.hidden,
            "named": {
                effect.name: msgspec.to_builtins(effect.parameters) for effect in self.found.effects
            },
            "gap": {"before": gap.before, "after": gap.after},
            "controller": None
            if self.flown is None
            else {axis: one["apart"] or "agrees" for axis, one in self.flown["axes"].items()},
            "distance": dict(zip(("before", "after"), self.distance.overall, strict=True)),
            "claims": [
                {"name": one.name, "text": one.text, "true": one.true} for one in self.claims
            ],
            "stages": {
                name: {"seconds": wall, "processor_s": processor}
                for name, (wall, processor) in self.told.cost.items()
            },
            "skipped": self.told.skipped,
        }


def judge(folder: Path, seed: int, told: Told) -> Outcome:
    """Open the seal, and hold what was said against it."""
    found = msgspec.json.decode((folder / "found.json").read_bytes(), type=DiscrepancyReport)
    reports = [folder / f"{name}.json" for name in PID_FLIGHTS]
    flown = next((json.loads(one.read_text()) for one in reports if one.exists()), None)
    hidden, distance, noticed = hidden_in(folder), distance_of(folder), twin_events(folder)
    claims = claims_of(hidden, found, distance, noticed)
    return Outcome(folder, seed, told, hidden, found, distance, noticed, flown, claims)


def hidden_in(folder: Path) -> Hidden:
    """What the sealed craft has and the plain one has not."""
    sealed, plain = (
        tomllib.loads((folder / name).read_text(encoding="utf-8"))["stand_in"]
        for name in (SEALED, CRAFT_FILE)
    )
    effects: Hidden = sealed["effects"]
    return {
        name: values for name, values in effects.items() if name not in plain.get("effects", {})
    }


def distance_of(folder: Path) -> Distance:
    """The three flights of one seed, by hidden craft, first model and improved model."""
    _, true, old, new = flights_apart(folder)
    moved = np.std(true, axis=0)
    return Distance(_rms(old - true), _rms(new - true), moved)


def flights_apart(folder: Path) -> tuple[Array, Array, Array, Array]:
    """Time (n,) and channels (n, 9) in the air: the hidden craft, the first model, the improved."""
    names = ("hidden2.csv", "as_body.csv", "as_improved.csv")
    runs = [flight(folder / name) for name in names]
    period_s = runs[0].period_s
    first, last = (round(time_s / period_s) for time_s in IN_THE_AIR_S)
    last = min(last, *map(len, runs))
    true, old, new = (channels(run[first:last]) for run in runs)
    return np.arange(first, last) * np.float64(period_s), true, old, new


def flight(path: Path) -> Run:
    """The longest unbroken part of a recording."""
    return max(runs_of(open_recording(path).samples, path.name), key=len)


def channels(run: Run) -> Array:
    """The nine channels of ``CHANNELS``, (n, 9), in the units that reports use."""
    return np.hstack([run.gyro, run.accelerometer, run.attitude]) * PER_SI


def watched(folder: Path) -> Path:
    """The recording of the flight that the twin watched."""
    return only(folder, "watched/*.mcap")


def twin_events(folder: Path) -> list[dict[str, Any]]:
    """What the twin said while it watched, in order: disagreements that began."""
    events = open_recording(watched(folder)).events
    return [one for one in events if one.get("link") == "twin" and one.get("kind") == "gap"]


def described(name: str, parameters: dict[str, float], errors: dict[str, float | None]) -> str:
    """An effect with its numbers, in words: 'dead_time 4.1 +- 0.1 ms'."""
    parts = []
    for key, value in parameters.items():
        unit = EFFECTS[name].parameter(key).unit
        scale, unit = READABLE.get(unit, (1.0, unit))
        error = errors.get(key)
        spread = "" if error is None else f" ± {scale * error:.2g}"
        label = f"{key.rsplit('_', 1)[0]} " if len(parameters) > 1 else ""
        parts.append(f"{label}{scale * value:.4g}{spread} {unit}".rstrip())
    return f"{name} {', '.join(parts)}"


def said_hidden(hidden: Hidden) -> str:
    """What was hidden, in words."""
    return "; ".join(described(name, values, {}) for name, values in hidden.items())


def said_found(found: DiscrepancyReport) -> str:
    """What was named, in words."""
    said = [
        described(
            effect.name,
            {key: one.value for key, one in effect.parameters.items()},
            {key: one.stderr for key, one in effect.parameters.items()},
        )
        for effect in found.effects
    ]
    return "; ".join(said) or "nothing"


def claims_of(
    hidden: Hidden, found: DiscrepancyReport, distance: Distance, noticed: list[dict[str, Any]]
) -> tuple[Claim, ...]:
    """The story's claims. Named means: every hidden effect, and nothing else."""
    gap = found.gap.validation
    after = gap.before if gap.after is None else gap.after
    old, new = distance.overall
    return (
        _twin_claim(hidden, noticed),
        Claim(
            "named",
            f"hidden: {said_hidden(hidden)}; named: {said_found(found)}",
            {effect.name for effect in found.effects} == set(hidden),
        ),
        Claim(
            "gap",
            f"on a flight that no fit has seen the prediction error falls from {gap.before:.2f} to"
            f" {after:.2f} times what noise alone leaves",
            after < gap.before,
        ),
        Claim(
            "flown",
            f"the stand-in that flies the improved model strays {100 * new:.2g} % from the hidden"
            f" craft's flight, {100 * old:.2g} % with the first model",
            new < old,
        ),
    )


def _twin_claim(hidden: Hidden, noticed: list[dict[str, Any]]) -> Claim:
    """True where a channel was told in which what is hidden shows."""
    shows = {channel.replace(" ", "_") for name in hidden for channel in EFFECTS[name].channels}
    right = [one for one in noticed if one["details"]["channel"] in shows]
    if right:
        return Claim("noticed", f"the twin noticed: {right[0]['text']}", True)
    if noticed:
        text = f"the twin spoke of a channel that has nothing to do with it: {noticed[0]['text']}"
        return Claim("noticed", text, False)
    return Claim("noticed", f"the twin saw nothing in a flight of {FLIGHT_S} s", False)


def _rms(values: Array) -> Array:
    """Over the rows."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))
