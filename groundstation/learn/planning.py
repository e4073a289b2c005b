"""The next flight: every manoeuvre is flown by the present model, and those that tell the most are
put together."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from groundstation.control.programme import HOLDS, MANOEUVRE, REST_S
from groundstation.documents import decode_json, read_document
from groundstation.dynamics.model import Model
from groundstation.errors import BadInputError, GroundStationError
from groundstation.identification.runs import Run, flights_of
from groundstation.learn.information import Choice, Information, choose, information_of
from groundstation.learn.journal import Flown
from groundstation.learn.manoeuvres import FlightPlan, Limits, library
from groundstation.paths import write_whole
from groundstation.recording.formats import open_for_analysis
from groundstation.recording.session import Recording


class Pilot(Protocol):
    """Who flies, a craft or a model: ``cli.learn_flights``."""

    def fly(
        self,
        programme: Any,
        file: Path,
        *,
        seed: int,
        gains: Mapping[str, float] | None = None,
    ) -> Flown: ...

    def write(self, gains: Mapping[str, float]) -> None: ...

    def await_battery(self) -> None: ...


@dataclass(frozen=True, slots=True)
class Planned:
    """A flight with why each manoeuvre is in it, and the standard errors it should leave."""

    plan: FlightPlan
    choices: tuple[Choice, ...]
    expected: dict[str, float]
    seed: int

    def as_dict(self) -> dict[str, Any]:
        rows = [
            {**row, "gain_nats": choice.gain, "tells": list(choice.tells)}
            for row, choice in zip(self.plan.timeline(), self.choices, strict=True)
        ]
        return {
            "seconds": self.plan.seconds,
            "seed": self.seed,
            "timeline": rows,
            "expected_stderr": self.expected,
        }

    def write(self, path: Path) -> None:
        write_whole(path, json.dumps(self.as_dict(), indent=1) + "\n")

    @classmethod
    def read(cls, path: Path, limits: Limits) -> Planned:
        """One that was written. Raises BadInputError."""
        try:
            said = decode_json(read_document(path), dict)
            choices = tuple(
                Choice(row["fly"], row["gain_nats"], tuple(row["tells"]))
                for row in said["timeline"]
            )
            plan = _flight(choices, limits, said["seed"])
            return cls(plan, choices, said["expected_stderr"], said["seed"])
        except (OSError, ValueError, LookupError, TypeError) as error:
            raise BadInputError(f"{path}: is no plan ({error}); remove it") from error


def plan_flight(
    rehearsal: Pilot,
    model: Model,
    limits: Limits,
    budget_s: float,
    seed: int = 0,
    known: Mapping[str, float] | None = None,
    flown: Sequence[str] = (),
) -> Planned:
    """The flight of at most ``budget_s`` that tells the most of what ``model`` leaves open.

    known: standard errors of effects' sizes that flights have given already, by key. flown:
    manoeuvres of flights whose part in them is not known.
    """
    told = rehearsed(rehearsal, model, limits, seed, known)
    seconds = {name: one.held_s for name, one in library(limits).items()}
    choices = tuple(choose(told, seconds, budget_s, flown=flown))
    expected = told.errors([*flown, *(one.name for one in choices)])
    return Planned(_flight(choices, limits, seed), choices, expected, seed)


def rehearsed(
    rehearsal: Pilot,
    model: Model,
    limits: Limits,
    seed: int = 0,
    known: Mapping[str, float] | None = None,
) -> Information:
    """What each manoeuvre would tell."""
    manoeuvres = tuple(library(limits, seed).values())
    whole = FlightPlan(manoeuvres, "every manoeuvre, by the model")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rehearsal.mcap"
        flown = rehearsal.fly(whole, file, seed=seed)
        if flown.aborted:
            raise GroundStationError(f"the model does not fly: {flown.aborted}")
        recording = open_for_analysis(file)
    run = max(flights_of(recording.samples), key=len)
    return information_of(_parts(run, recording), model, known)


def _parts(run: Run, recording: Recording) -> dict[str, Run]:
    """The rows of each manoeuvre, from the rest before it into the stop behind it; of one that was
    interrupted the longest piece."""
    samples = recording.samples
    pieces: dict[str, tuple[float, float]] = {}
    begun_s = 0.0
    for event in recording.events:
        if event.get("text") not in (MANOEUVRE, HOLDS):
            continue
        first = int(np.searchsorted(samples.host_time_ns, event["time_ns"]))
        time_s, name = float(samples.time_s[first]), event["details"]["name"]
        if event["text"] == MANOEUVRE:
            begun_s = time_s
        elif time_s - begun_s >= np.diff(pieces.get(name, (0.0, 0.0)))[0]:
            pieces[name] = begun_s, time_s
    parts = {}
    for name, (begun_s, ended_s) in pieces.items():
        low, high = np.searchsorted(run.time_s, (begun_s - REST_S, ended_s + REST_S))
        parts[name] = run[int(low) : int(high)]
    return parts


def _flight(choices: tuple[Choice, ...], limits: Limits, seed: int) -> FlightPlan:
    """What is flown twice is, where it is random, another the second time."""
    made = [library(limits, seed + number)[one.name] for number, one in enumerate(choices, 1)]
    tells = dict.fromkeys(key.partition(".")[0] for one in choices for key in one.tells)
    return FlightPlan(tuple(made), f"what tells most of {', '.join(tells)}")
