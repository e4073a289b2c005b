"""What is flown next: the journal of what was, manoeuvres, and what they would tell."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np

from groundstation.control.programme import (
    AHEAD_S,
    HELD_S,
    HOLDS,
    LOW_BATTERY,
    MANOEUVRE,
    NEAR_M,
    RATE_HZ,
    REST_S,
    SPEED_M_S,
    carried_m,
    heading_rad,
)
from groundstation.documents import decode_json, read_document
from groundstation.dynamics.model import Model
from groundstation.errors import BadInputError, GroundStationError
from groundstation.identification.estimate import inverse
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import BODY_KEYS, KEYS, point_of
from groundstation.identification.likelihood.problem import Problem, quadratic
from groundstation.identification.runs import Run, flights_of
from groundstation.paths import write_whole, writing
from groundstation.recording.formats import open_for_analysis
from groundstation.recording.session import Recording
from groundstation.telemetry.arrays import Array

# What has been flown and said: a file in the folder, from which ``learn`` goes on.


JOURNAL = "learn.json"


class Flown(msgspec.Struct, frozen=True):
    """What a pilot says after a landing. aborted: why, or empty. seconds: in the air. gains: those
    that flew."""

    aborted: str
    seconds: float
    gains: dict[str, float]


class Landed(msgspec.Struct, frozen=True, kw_only=True):
    """One flight. seconds: from switching on. battery: which one, from 1. timeline: as
    ``FlightPlan.timeline``. aborted: why, or empty. gains: that flew."""

    file: str
    purpose: str
    seconds: float
    battery: int
    timeline: list[dict[str, Any]]
    aborted: str = ""
    gains: dict[str, float] = {}


class Craft(msgspec.Struct, frozen=True, kw_only=True):
    """What a craft behind the daemon says of itself. firmware: whose loops it flies. id: its own
    number; empty where it does not say."""

    uri: str
    vehicle: str
    firmware: str
    id: str

    def is_same(self, other: Craft) -> bool:
        """By number, vehicle and firmware; by its address where none says a number."""
        if self.id and other.id:
            where = self.id == other.id
        else:
            where = not (self.id or other.id) and self.uri == other.uri
        return where and (self.vehicle, self.firmware) == (other.vehicle, other.firmware)

    def __str__(self) -> str:
        number = f", number {self.id}" if self.id else ""
        return f"{self.vehicle or 'a craft'} at {self.uri}, firmware {self.firmware}{number}"


class Task(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What was asked for, and stays so when it goes on. hide: a seed, or None. craft: the daemon's
    that is learnt, None before it was there and for a software craft."""

    link: str
    vehicle: str
    height_m: float
    reach_m: float
    seed: int
    batteries: int
    hide: int | None = None
    craft: Craft | None = None


BEING_WRITTEN = "being written"
"""``Journal.gains`` from before gains are written until they are, or the program ends."""


class Journal(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """flights: in order, those cut short too. said: after each landing. gains: what became of the
    new ones: ``BEING_WRITTEN``, ``written``, ``put back`` or why there are none; former: those
    before."""

    task: Task
    flights: list[Landed] = []
    said: list[str] = []
    gains: str = ""
    former: dict[str, float] = {}
    seconds: float = 0.0

    def good(self, file: str) -> Landed | None:
        """A flight that was flown to its end."""
        return next((one for one in self.flights if one.file == file and not one.aborted), None)

    @property
    def batteries(self) -> int:
        return max((one.battery for one in self.flights), default=1)

    @property
    def is_empty(self) -> bool:
        """Whether the present one ended the last flight."""
        return bool(self.flights) and self.flights[-1].aborted.startswith(LOW_BATTERY)

    @property
    def on_battery_s(self) -> float:
        """Flown on the present one."""
        return sum(one.seconds for one in self.flights if one.battery == self.batteries)

    def save(self, folder: Path) -> None:
        """Whole or not at all. Raises BadInputError."""
        text = msgspec.json.format(msgspec.json.encode(self), indent=1)
        with writing(folder / JOURNAL, BadInputError):
            write_whole(folder / JOURNAL, text, durable=True)


def journal_in(folder: Path) -> Journal | None:
    """That of a folder in which something was learnt; None where nothing was.

    Raises BadInputError where it cannot be read.
    """
    path = folder / JOURNAL
    try:
        return decode_json(read_document(path), Journal)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise BadInputError(
            f"{path}: cannot be read ({why}); learn in another folder with -o"
        ) from error


# The manoeuvres that flights are put together of, within limits of tilt and space.
#
# Signs are those of the telemetry: roll left side up, pitch nose down, yaw rate counter-clockwise.


TAKE_OFF_S, LANDING_S = 4.0, 3.0
"""Until its hover is known, and down from 0.5 m."""
PREFLIGHT_S = 4.0
"""What a flight takes beside its programme: on the ground."""


@dataclass(frozen=True, slots=True)
class Limits:
    """tilt_deg: the most that is commanded. reach_m: to either side of where it took off. height_m:
    above the ground."""

    tilt_deg: float = 12.0
    reach_m: float = 1.0
    height_m: float = 0.5

    @property
    def step_m(self) -> float:
        """The largest step of height: up and down by it leaves half the height below."""
        return min(0.2, 0.4 * self.height_m)

    def within(self, table: Array) -> float:
        """What leans are multiplied with, 1 at most, so that a craft that begins near its place can
        brake within its space at any time."""
        most = (self.reach_m - NEAR_M) / max(carried_m(table, AHEAD_S), 1e-9)
        return min(1.0, self.tilt_deg / max(np.abs(table[:, :2]).max(), 1e-9), most)

    def lean(self, wanted_deg: float, hold_s: float) -> float:
        """An angle that a doublet may have whose levels are held for so long."""
        held = np.ones((round(hold_s * RATE_HZ), 1))
        return wanted_deg * self.within(np.vstack([held, -held]) * [wanted_deg, 0.0, 0.0])


def require_limits(limits: Limits) -> None:
    """Raises BadInputError for limits in which nothing can be learnt."""
    if not 0.3 <= limits.height_m <= 2.0:
        raise BadInputError(f"--height {limits.height_m:g}: must be 0.3..2 m")
    if not 0.5 <= limits.reach_m <= 20.0:
        raise BadInputError(
            f"--space: {2 * limits.reach_m:g} m across is too little or no room: give 1x1..40x40 m"
        )


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """table: roll, pitch (deg), yaw rate (deg/s), metres above the height held, every 10 ms
    (k, 4)."""

    name: str
    table: Array

    @property
    def seconds(self) -> float:
        return len(self.table) / RATE_HZ

    @property
    def held_s(self) -> float:
        """Until the craft is back and rests, about."""
        return self.seconds + HELD_S


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """Manoeuvres in order; what a flight is for, in words."""

    manoeuvres: tuple[Manoeuvre, ...]
    purpose: str

    rest_s = REST_S
    speed_most_m_s = SPEED_M_S

    def parts(self) -> list[tuple[str, Array]]:
        """Name and table of each manoeuvre."""
        return [(one.name, one.table) for one in self.manoeuvres]

    @property
    def seconds(self) -> float:
        """In the air, about."""
        return TAKE_OFF_S + sum(one.held_s for one in self.manoeuvres) + LANDING_S

    def timeline(self) -> list[dict[str, Any]]:
        """When to fly what: ``at_s`` from the end of the take-off, about, ``seconds``, ``fly``."""
        rows, at_s = [], 0.0
        for one in self.manoeuvres:
            rows.append({"at_s": at_s, "seconds": one.seconds, "fly": one.name})
            at_s += one.held_s
        return rows


def library(limits: Limits, seed: int = 0) -> dict[str, Manoeuvre]:
    """Every manoeuvre by name, each within the limits and back where it began. seed: of the random
    ones."""
    time = np.arange(round(6.0 * RATE_HZ)) / RATE_HZ
    still = np.zeros(len(time))
    doublet = np.repeat([1.0, -1.0, 0.0, -1.0, 1.0, 0.0] * 2, RATE_HZ // 2)
    sweep = np.cos(2 * math.pi * (0.6 * time + (5.0 - 0.6) * time**2 / 12.0))
    to_and_fro = np.cos(2 * math.pi * time / 2.0)
    steps = np.repeat([1.0, 0.0, -1.0, 0.0, 1.0, 0.0], RATE_HZ)
    random = np.random.default_rng(seed)
    tilt = limits.tilt_deg

    def levels(hold_s: float, *pattern: float) -> Array:
        """A pattern of levels, again and again with signs at random."""
        count = round(hold_s * RATE_HZ)
        signs = random.choice([-1.0, 1.0], len(time) // (count * len(pattern)) + 1)
        return np.repeat(np.outer(signs, pattern), count)[: len(time)]

    def of(name: str, **axes: Array) -> Manoeuvre:
        """Leans are those of the heading at its begin, so that they come back in a turn too."""
        roll, pitch, yaw, above = (
            axes.get(one, still) for one in ("roll", "pitch", "yaw", "above")
        )
        lean = (pitch - 1j * roll) * np.exp(-1j * heading_rad(yaw))
        table = np.column_stack([-lean.imag, lean.real, yaw, above])
        table[:, :2] *= limits.within(table)
        return Manoeuvre(name, table)

    back = (1.0, -1.0, -1.0, 1.0)
    made = [
        of("hover"),
        of("thrust steps", above=limits.step_m * steps),
        of("roll doublets", roll=0.75 * tilt * doublet),
        of("pitch doublets", pitch=0.75 * tilt * doublet),
        of("yaw steps", yaw=90.0 * doublet),
        of("roll chirp", roll=0.5 * tilt * sweep),
        of("pitch chirp", pitch=0.5 * tilt * sweep),
        of("yaw chirp", yaw=60.0 * sweep),
        of("to and fro, left and right", roll=tilt * to_and_fro),
        of("to and fro, ahead and back", pitch=tilt * to_and_fro),
        of(
            "turn with doublets",
            yaw=0.0 * still + 90.0,
            pitch=0.75 * tilt * doublet,
            roll=0.75 * tilt * np.roll(doublet, RATE_HZ // 2),
        ),
        of(
            "all axes at random",
            roll=0.75 * tilt * levels(0.25, *back),
            pitch=0.75 * tilt * levels(0.3, *back),
            yaw=60.0 * levels(0.5, 1.0, -1.0),
            above=limits.step_m * levels(1.0, 1.0, 0.0),
        ),
    ]
    return {one.name: one for one in made}


HOVER = ("hover", "thrust steps", "yaw steps")
BODY = ("roll doublets", "pitch doublets", "yaw steps", "roll chirp", "pitch chirp")
PROOF = ("all axes at random", "roll doublets", "turn with doublets", "pitch doublets")
"""Of the flights that need no model to be planned."""


def flight_of(names: Sequence[str], purpose: str, limits: Limits, seed: int) -> FlightPlan:
    """A flight of named manoeuvres."""
    known = library(limits, seed)
    return FlightPlan(tuple(known[name] for name in names), purpose)


# What manoeuvres tell of a craft: expected information on each constant and each effect, and the
# set with the most of it (D-optimal, greedy over manoeuvres).


BODY_DOUBT = 0.3
"""Of c0, c1, c2 and the thrust before any flight, as a share."""
LITTLE = 0.02
"""Gain a second of flight (nats) below which nothing more is planned."""


@dataclass(frozen=True, slots=True)
class Information:
    """keys: constants and sizes of effects. prior: what is known of them, (p, p). parts: by name of
    a manoeuvre what flying it adds, (p, p), and what the same time of hover would not."""

    keys: tuple[str, ...]
    prior: Array
    parts: Mapping[str, Array]

    def errors(self, flown: Sequence[str]) -> dict[str, float]:
        """Standard errors by key that these manoeuvres would leave, all fitted jointly."""
        errors = np.sqrt(np.diag(inverse(self._known(flown))))
        return dict(zip(self.keys, errors.tolist(), strict=True))

    def gain(self, flown: Sequence[str], more: str) -> float:
        """By how much one more manoeuvre shrinks what is open, in nats."""
        known = self._known(flown)
        return 0.5 * (_volume(known + self.parts[more]) - _volume(known))

    def _known(self, flown: Sequence[str]) -> Array:
        return self.prior + sum((self.parts[name] for name in flown), np.zeros_like(self.prior))


@dataclass(frozen=True, slots=True)
class Choice:
    """A manoeuvre that was chosen: gain in nats, and the keys of which it tells the most."""

    name: str
    gain: float
    tells: tuple[str, ...]


def _volume(normal: Array) -> float:
    return float(np.linalg.slogdet(normal)[1])


def information_of(
    runs: Mapping[str, Run], model: Model, known: Mapping[str, float] | None = None
) -> Information:
    """From flights of ``model``, one of each manoeuvre by name.

    Residuals there are noise alone; their slopes by every constant and every effect that is fitted,
    weighted by the noise, are the expected information. known: standard errors of effects' sizes
    that flights have given already, by key; of others nothing is known but the size worth finding.
    """
    named = [replace(run, name=name) for name, run in runs.items()]
    flights = prepare(named, least_s=3.0)
    point = point_of(model)
    problem = Problem(flights, model, point)
    problem.settle_filters()
    linear = problem.learn_noise(problem.linear(point, problem.every_key, flights))
    keys = tuple(linear.keys)
    parts = {name: np.zeros((len(keys),) * 2) for name in runs}
    for number, flight in enumerate(flights):
        own = [s for s in linear.spectra if s.flight == number]
        parts[flight.run.name] += quadratic(own, problem.noise, (), len(keys)).normal
    spread = dict(known or {})
    doubts = [_doubt(key, point, spread) for key in keys]
    prior = np.diag([0.0 if doubt is None else doubt**-2 for doubt in doubts])
    for one in problem.prior:
        if set(one.keys) <= set(keys):
            at = linear.place(one.keys)
            prior[np.ix_(at, at)] += one.at(point)[0]
    for i, key in enumerate(keys):  # what no prior holds is held by its own size
        if prior[i, i] <= 0.0:
            worth = KEYS[key].worth if key in KEYS else abs(point.get(key, 1.0)) or 1.0
            prior[i, i] = worth**-2
    return Information(keys, prior, parts)


def _doubt(key: str, point: Mapping[str, float], known: Mapping[str, float]) -> float | None:
    """Standard deviation of a number before the flight; None where the problem's prior says it."""
    if key in known:
        return known[key]
    if key in BODY_KEYS:
        return BODY_DOUBT * abs(point[key])
    if key in KEYS:
        return KEYS[key].worth
    return None


def choose(
    told: Information,
    seconds: Mapping[str, float],
    budget_s: float,
    least: float = LITTLE,
    flown: Sequence[str] = (),
) -> list[Choice]:
    """The manoeuvres with the most information a second, one after the other, each as often as it
    still tells more than the others; until the time is spent or the best gains less than ``least``
    nats a second. flown: those that were flown before."""
    chosen: list[Choice] = []
    left_s = budget_s
    while True:
        names = [*flown, *(one.name for one in chosen)]
        fitting = [name for name in told.parts if seconds[name] <= left_s]
        gains = {name: told.gain(names, name) for name in fitting}
        best = max(fitting, key=lambda name: gains[name] / seconds[name], default=None)
        if best is None or gains[best] < least * seconds[best]:
            return chosen
        before, after = told.errors(names), told.errors([*names, best])
        shrunk = sorted(told.keys, key=lambda key: after[key] / before[key])
        chosen.append(Choice(best, gains[best], tuple(shrunk[:3])))
        left_s -= seconds[best]


# The next flight: every manoeuvre is flown by the present model, and those that tell the most are
# put together.


class Pilot(Protocol):
    """Who flies, a craft or a model: ``cli.learn``."""

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


@contextmanager
def rehearsal(
    pilot: Pilot, programme: Any, *, seed: int, gains: Mapping[str, float] | None = None
) -> Iterator[tuple[Flown, Path]]:
    """A programme flown by a model: what came of it, and its recording, which goes with the
    block."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rehearsal.mcap"
        yield pilot.fly(programme, file, seed=seed, gains=gains), file


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
    pilot: Pilot,
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
    told = rehearsed(pilot, model, limits, seed, known)
    seconds = {name: one.held_s for name, one in library(limits).items()}
    choices = tuple(choose(told, seconds, budget_s, flown=flown))
    expected = told.errors([*flown, *(one.name for one in choices)])
    return Planned(_flight(choices, limits, seed), choices, expected, seed)


def rehearsed(
    pilot: Pilot,
    model: Model,
    limits: Limits,
    seed: int = 0,
    known: Mapping[str, float] | None = None,
) -> Information:
    """What each manoeuvre would tell."""
    manoeuvres = tuple(library(limits, seed).values())
    whole = FlightPlan(manoeuvres, "every manoeuvre, by the model")
    with rehearsal(pilot, whole, seed=seed) as (flown, file):
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
