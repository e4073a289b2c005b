"""What is known of a physical effect: the vocabulary of the files in ``dynamics/effects``.

Each of those files defines one ``EFFECT``: parameters, law, what it needs, where it shows and what
it is confused with. Everything that flies, fits, searches or describes effects reads it there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, Literal

from groundstation.errors import BadInputError

Stage = Literal["delay", "supply", "motor", "rotor", "body", "sensor", "attitude", "tachometer"]
Channel = Literal[
    "gyro x",
    "gyro y",
    "gyro z",
    "accelerometer x",
    "accelerometer y",
    "accelerometer z",
    "roll",
    "pitch",
    "yaw",
]
Kind = Literal["size", "shape", "choice"]
Need = Literal["accelerometer", "attitude", "modelled rotors"]
Unmeasured = Literal["velocity", "height"]
Law = Callable[..., Any]
"""See ``dynamics/law.py`` for the signature of each stage."""

GYRO: tuple[Channel, ...] = ("gyro x", "gyro y", "gyro z")
TILT_RATES: tuple[Channel, ...] = ("gyro x", "gyro y")
FORCE: tuple[Channel, ...] = ("accelerometer x", "accelerometer y", "accelerometer z")
ANGLES: tuple[Channel, ...] = ("roll", "pitch", "yaw")

TILTING = frozenset(
    {"high roll or pitch rate", "roll or pitch torque", "turning about several axes"}
)
YAWING = frozenset({"high yaw rate", "after yaw commands", "turning about several axes"})
ROTORS = frozenset({"rotor acceleration", "rotors slowing down", "thrust change"})
THRUST = frozenset({"high thrust", "low thrust", "climb", "descent", "thrust change"})
STEADY = frozenset({"whole flight", "hover"})
TRANSLATION = frozenset({"translation", "tilted"})
"""Regimes of ``comparison/regimes.py``, in groups."""

THRUST_STEPS = (
    "steps of collective thrust over 60..140 % of hover, once with a full and once with an"
    " empty battery, and the motor bench"
)
DOUBLETS = "fast roll and pitch doublets with attitude in the recording"
HOVER_DOUBLETS = "fast roll and pitch doublets on the spot, too short to gain speed"
TRANSLATE = "steady flight to and fro along both axes at 1..2 m/s, then hover"
YAW_STEPS = "yaw steps both ways, then a steady turn at 3 rad/s"
CLIMBS = "climbs and descents at several steady speeds, well above the ground"
"""Manoeuvres that several effects name."""
SLIP = 10.0
"""So many times what is plausible is a slip of the pen; a craft with it only tumbles."""


@dataclass(frozen=True, slots=True)
class Unknown:
    """The number that fits and the search estimate instead of a parameter.

    of: its value for one of the parameter; back: the other way. A time constant, say, for a
    bandwidth, so that the effect is absent at 0.
    """

    name: str
    unit: str
    of: Callable[[float], float]
    back: Callable[[float], float]


def _other_of_pair(value: float) -> float:
    """Time constant (s) of a bandwidth (Hz) and the other way; 0 stands for no lag in both."""
    return 1.0 / (2.0 * math.pi * value) if value > 0.0 else 0.0


TIME_CONSTANT = Unknown("time_constant_s", "s", of=_other_of_pair, back=_other_of_pair)
"""Of a low-pass given by its bandwidth."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect.

    low, high: what is plausible on a small craft, signs included; beyond it a finding is refused.
    absent: the value at which the effect is not there (of a shape: what it is taken for then).
    kind: a size makes the effect, a shape only forms it, a choice is one of the whole numbers
    low..high (which rotor). least, most: values that can be flown at all.

    The rest speaks of the unknown that is estimated, in its own unit: unknown: which, where it is
    not the parameter itself. bounds: where a fit keeps it. step: of finite differences, 0 means a
    hundredth of ``worth``. stride: largest change in one step of a fit. worth: the size worth
    finding, the default's where None. starts: from where joint fits begin. near: columns hold so
    far from where they were evaluated; None: everywhere, the law is linear. shares: the key
    (``effect.parameter``) of the same number of the craft in another effect: fitted together the
    two have one value. tried: values of a shape of which none tells of the others, each of them
    screened (how long a pendulum is).
    """

    name: str
    unit: str
    default: float
    low: float
    high: float
    absent: float = 0.0
    kind: Kind = "size"
    least: float = -math.inf
    most: float = math.inf
    unknown: Unknown | None = None
    bounds: tuple[float, float] = (-math.inf, math.inf)
    step: float = 0.0
    stride: float = math.inf
    worth: float | None = None
    starts: tuple[float, ...] = ()
    near: float | None = None
    shares: str = ""
    tried: tuple[float, ...] = ()

    def to_unknown(self, value: float) -> float:
        """A value of the parameter in the unit in which it is estimated."""
        return value if self.unknown is None else self.unknown.of(value)

    def from_unknown(self, value: float) -> float:
        """The other way."""
        return value if self.unknown is None else self.unknown.back(value)


@dataclass(frozen=True, slots=True)
class State:
    """One number that an effect remembers.

    follows: a channel of ``Reading``'s gyro or accelerometer in body axes that the state is a
    delayed copy of: it begins at that channel's value and an observer corrects the two alike.
    noise: the parameter that is the state's standard deviation, where noise drives it: an observer
    estimates it. moving: the standard deviation of what its law leaves of it, where nobody saw how
    it began: an observer corrects it as well. inertial: of such a vector in inertial axes, x and y
    one behind the other. made: what it begins with in a made flight, where
    ``initial`` is no more than what can be expected of a recorded one (of an angle that nobody
    measures).
    turns: of a sensor, the reported angle that is off by it, in rad.
    """

    name: str
    initial: float = 0.0
    follows: Channel | None = None
    noise: str = ""
    moving: float = 0.0
    inertial: Literal["", "x", "y"] = ""
    made: float | None = None
    turns: Literal["", "roll", "pitch", "yaw"] = ""


@dataclass(frozen=True, slots=True)
class Confusion:
    """Another effect that can look the same, and the manoeuvre that separates the two."""

    other: str
    manoeuvre: str


@dataclass(frozen=True, slots=True)
class Rename:
    """The base constant whose change an effect is, and what its size makes of the given value."""

    constant: str
    moved: Callable[[float, float], float]


class Role(Enum):
    """What fits and the search make of an effect."""

    CANDIDATE = auto()
    """Fitted with the base constants, selected where it explains something."""
    ESTIMATE = auto()
    """A candidate that is an error of the reported angles alone, driven by what is measured."""
    CONSTANT = auto()
    """The change of a base constant under another name."""
    ON_BOARD = auto()
    """What a firmware does to its readings: known, in a model or not."""
    WITH_BASE = auto()
    """Fitted with the base constants wherever samples show it."""
    NOISE = auto()
    """Driven by noise: an observer follows it, no regressor shows it."""
    UNPHASED = auto()
    """With an angle that nobody measures: identified by its power, no regressor shows it."""


CANDIDATES = (Role.CANDIDATE, Role.ESTIMATE)


@dataclass(frozen=True, slots=True)
class Effect:
    """One physical effect.

    name: that of its file. stage, law: where it enters and how (``dynamics/law.py``). order: laws
    of a stage act in this order. states: what it remembers, in the order in which the law takes
    them: of a listed sensor, its slopes and what is shown are linear in them. fastest: values ->
    fastest rate in 1/s of these states, for an integrator's step.
    adds: its law in words. signature: by what a person knows it. excited_by: what to fly so that
    it shows. channels, regimes: where it shows first. needs: channels without which it cannot be
    told; ``modelled rotors``: not where rotor speeds were measured. unmeasured: what its law reads
    that no sensor shows.
    on_board: the vehicle's field that says its size: what a firmware does to its readings, known
    and no candidate: it is in a model or it is not.
    renames: the base constant whose change it is. It is no candidate beside that constant, which
    explains the same, but its name once that has moved.
    negligible, because: a size (norm of all sizes) below which it is fitted but no finding.
    doubt: values -> standard errors that no residual shows, by parameter.
    """

    name: str
    stage: Stage
    parameters: tuple[Parameter, ...]
    adds: str
    signature: str
    excited_by: str
    channels: tuple[Channel, ...]
    law: Law
    regimes: frozenset[str] = frozenset()
    order: int = 0
    states: tuple[State, ...] = ()
    fastest: Callable[[Mapping[str, float]], float] | None = None
    needs: tuple[Need, ...] = ()
    unmeasured: tuple[Unmeasured, ...] = ()
    on_board: str = ""
    renames: Rename | None = None
    negligible: float = 0.0
    because: str = ""
    doubt: Callable[[Mapping[str, float]], dict[str, float]] | None = None
    confused_with: tuple[Confusion, ...] = ()

    def __repr__(self) -> str:
        return f"Effect({self.name}: {self.adds})"

    @property
    def sizes(self) -> tuple[Parameter, ...]:
        """Parameters that alone make the effect."""
        return tuple(p for p in self.parameters if p.kind == "size")

    @property
    def role(self) -> Role:
        """What fits and the search make of it."""
        if any(state.noise for state in self.states):
            return Role.NOISE
        if any(state.made is not None for state in self.states):
            return Role.UNPHASED
        if self.stage == "tachometer":
            return Role.WITH_BASE
        if self.renames:
            return Role.CONSTANT
        if self.on_board:
            return Role.ON_BOARD
        return Role.ESTIMATE if any(state.turns for state in self.states) else Role.CANDIDATE

    @property
    def choice(self) -> Parameter | None:
        """The parameter that picks one of several (a rotor), if it has one."""
        return next((p for p in self.parameters if p.kind == "choice"), None)

    def parameter(self, name: str) -> Parameter:
        """One of its parameters. Raises BadInputError, naming those there are."""
        for one in self.parameters:
            if one.name == name:
                return one
        names = ", ".join(p.name for p in self.parameters)
        raise BadInputError(f"effect {self.name}: no parameter {name!r}; there are {names}")

    def values(self, given: Mapping[str, float]) -> dict[str, float]:
        """Every parameter: the given value, or its default.

        Raises BadInputError for a parameter that does not exist or a value that cannot be flown.
        """
        for name in given:
            self.parameter(name)
        values = {p.name: float(given.get(p.name, p.default)) for p in self.parameters}
        for p in self.parameters:
            value = values[p.name]
            if not math.isfinite(value):
                raise BadInputError(f"effect {self.name}: {p.name} is {value}, must be finite")
            if not p.least <= value <= p.most:
                limits = (
                    "must not be negative"
                    if p.least == 0.0 > value
                    else (f"must lie in {p.least:g}..{p.most:g}")
                )
                raise BadInputError(f"effect {self.name}: {p.name} is {value:g}, {limits}")
            if p.kind == "choice" and value not in range(int(p.low), int(p.high) + 1):
                raise BadInputError(
                    f"effect {self.name}: {p.name} is {value:g}, must be a whole number in"
                    f" {p.low:.0f}..{p.high:.0f}"
                )
        return values

    def require_sizes(self, given: Mapping[str, float]) -> None:
        """Raises BadInputError for a value many times beyond the plausible range."""
        for name, value in given.items():
            p = self.parameter(name)
            most = SLIP * max(abs(p.to_unknown(p.low)), abs(p.to_unknown(p.high)))
            if not abs(p.to_unknown(float(value))) <= most:
                raise BadInputError(
                    f"effect {self.name}: {name} is {value:g} {p.unit}".rstrip()
                    + f", a craft has {p.low:g}..{p.high:g}; correct the number or its unit"
                )

    def absent(self, given: Mapping[str, float]) -> bool:
        """Whether these values amount to no effect at all."""
        values = self.values(given)
        return all(values[p.name] == p.absent for p in self.sizes)

    def plausible(self, given: Mapping[str, float]) -> bool:
        """Whether every value lies in its range, as far as its doubt lets it be known, or is the
        one that means absent."""
        values = {p.name: float(given.get(p.name, p.default)) for p in self.parameters}
        off = {} if self.doubt is None else self.doubt(values)
        return all(
            p.low - off.get(p.name, 0.0) <= values[p.name] <= p.high + off.get(p.name, 0.0)
            or values[p.name] == p.absent
            for p in self.parameters
        )
