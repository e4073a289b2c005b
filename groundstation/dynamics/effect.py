"""What is known of a physical effect: the vocabulary of the files in ``dynamics/effects``."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError

# What the law of an effect is given and returns, stage by stage.
#
# A law is a plain function of numbers and of the named tuples below, in Python that numba compiles:
# it takes its parameters' values as a tuple in their order and returns tuples; it stores nothing.
# The stages, in the order in which a flight passes them:
#
# | stage | law | returns |
# |---|---|---|
# | delay | (values) | how late every measurement is, s |
# | supply | (values, craft, supply, supply_mv) | voltage behind the report, mV |
# | motor | (values, motor, slope) | dn/dt of one motor, rev/s^2 |
# | rotor | (values, craft, body, wrench) | thrust (N) and torque about x, y, z (N m) |
# | body | (values, craft, body) | ((3,) rad/s^2, (3,) m/s^2), body axes: what it adds |
# | sensor | (values, craft, body, reading) | a ``Reading`` |
# | tachometer | (values) | time constant of the sensor behind recorded rotor speeds, s |
# | attitude | (values) | proportional and integral gain of the attitude filter, 1/s and 1/s^2 |
#
# A body or sensor effect that declares states takes them as a last argument, a tuple, and returns
# one more item: the tuple of their slopes. Where several effects act at a stage each is given what
# the ones before it left (``Effect.order``).


Three = tuple[float, float, float]
Four = tuple[float, float, float, float]

SPIN: Four = (-1.0, 1.0, -1.0, 1.0)
"""Sign of each rotor's drag torque about z: M1 and M3 turn counter-clockwise (thesis eq. 3.20)."""
STATE_SLOTS = 16
"""States that a user's own effects may have together at a stage."""
VALUE_SLOTS = 16
"""Parameters of all own effects of a model together."""
FAR_M = 1000.0
"""Height of a craft that no ground touches."""


class Craft(NamedTuple):
    """What is constant in a flight: SI, rotor speed in rev/s.

    thrust: N, drag: N m, per (rev/s)^2 of a rotor. rotor_x, rotor_y: m forward and left. a0, a1,
    a2: of each motor (thesis eq. 3.82). back_emf_mv: of each, mV per rev/s, its bound a1/a0.
    """

    mass: float
    gravity: float
    inertia: Three
    thrust: float
    drag: float
    rotor_x: Four
    rotor_y: Four
    a0: Four
    a1: Four
    a2: Four
    winding_ohm: float
    back_emf_mv: Four


class Supply(NamedTuple):
    """The reported battery voltage in mV at a row and at the row before, and what it drives."""

    reported: float
    before: float
    period_s: float
    duty: Four
    rotor: Four


class Motor(NamedTuple):
    """One motor: constants of eq. 3.82, armature voltage in mV, speed in rev/s."""

    a0: float
    a1: float
    a2: float
    armature_mv: float
    rev_s: float


class Body(NamedTuple):
    """The craft at an instant, in body axes (forward, left, up) unless said otherwise.

    height: m above the ground, ``FAR_M`` where it is not known. quaternion: body to inertial.
    velocity: m/s over ground. rate: rad/s. rotor: rev/s, rotor_slope: rev/s^2. thrust: N, of all
    rotors. angular: rad/s^2 and force: m/s^2 (specific force) as far as they are reckoned:
    at the body stage by the effects before, at the sensor stage completely.
    """

    height: float
    quaternion: Four
    velocity: Three
    rate: Three
    rotor: Four
    rotor_slope: Four
    thrust: float
    angular: Three
    force: Three


class Reading(NamedTuple):
    """What the sensors show: gyro in rad/s, accelerometer in m/s^2, rotor speeds in rev/s."""

    gyro: Three
    accelerometer: Three
    rotor: Four


def to_inertial(quaternion: Any, vector: Any) -> Three:
    """A body vector in inertial axes; quaternion (w, x, y, z) body to inertial."""
    w, x, y, z = quaternion
    a, b, c = vector
    return (
        (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c,
        2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c,
        2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c,
    )


def to_body(quaternion: Any, vector: Any) -> Three:
    """An inertial vector in body axes."""
    w, x, y, z = quaternion
    return to_inertial((w, -x, -y, -z), vector)


def butterworth_slopes(given: Any, state: Any, corner_hz: float) -> Any:
    """Slopes of three signals behind a low-pass of second order, and of their slopes.

    given: the signals (3); state: what has passed and its slopes (6).
    """
    pace = 2.0 * math.pi * corner_hz
    stiff, damped = pace * pace, math.sqrt(2.0) * pace
    x, y, z = given
    return (
        state[3],
        state[4],
        state[5],
        stiff * (x - state[0]) - damped * state[3],
        stiff * (y - state[1]) - damped * state[4],
        stiff * (z - state[2]) - damped * state[5],
    )


def butterworth_behind(state: Any, corner_hz: float) -> Any:
    """How far the integrals of three signals behind that low-pass are behind the signals' own:
    with w'' = (2 pi f)^2 (u - w) - sqrt(2) 2 pi f w', what is missing of u is in w and w'."""
    pace = 2.0 * math.pi * corner_hz
    late, later = math.sqrt(2.0) / pace, 1.0 / (pace * pace)
    return (
        late * state[0] + later * state[3],
        late * state[1] + later * state[4],
        late * state[2] + later * state[5],
    )


def rotor_wrench(craft: Any, rotor: Any) -> tuple[float, float, float, float]:
    """Thrust (3.13) and torques (3.21 with lever; yaw by drag only) of equal rotors, N and N m.

    rotor: rev/s, four numbers.
    """
    n1, n2, n3, n4 = rotor
    s1, s2, s3, s4 = n1 * n1, n2 * n2, n3 * n3, n4 * n4
    (x1, x2, x3, x4), (y1, y2, y3, y4) = craft.rotor_x, craft.rotor_y
    return (
        craft.thrust * (s1 + s2 + s3 + s4),
        craft.thrust * (y1 * s1 + y2 * s2 + y3 * s3 + y4 * s4),
        -craft.thrust * (x1 * s1 + x2 * s2 + x3 * s3 + x4 * s4),
        craft.drag * (SPIN[0] * s1 + SPIN[1] * s2 + SPIN[2] * s3 + SPIN[3] * s4),
    )


# Each of the files in ``dynamics/effects`` defines one ``EFFECT``: parameters, law, what it needs,
# where it shows and what it is confused with. Whatever flies, fits, searches or describes effects
# reads it there.


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
"""Its arguments at each stage are in the table above."""

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
"""Regimes of ``gap.regimes_of``, in groups."""

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

    name: that of its file. stage, law: where it enters and how (table above). order: laws
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
                limits = f"must lie in {p.least:g}..{p.most:g}"
                if p.least == 0.0 > value:
                    limits = "must not be negative"
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


# The numbers that fits and the search estimate of an effect, and the way back to its parameters.
#
# A point is a dictionary from key to value. Most unknowns are a parameter (``effect.parameter``);
# a bandwidth is estimated as a time constant; an effect with a choice (which rotor) has one
# variant for each, whose key is ``effect.1``, ``effect.2`` and so on (with ``.parameter`` where
# it has several sizes).


@dataclass(frozen=True, slots=True)
class Key:
    """An unknown: where it stands in a point, and the parameter behind it.

    absent: its value where the effect is not there. low, high: plausible values. worth: a size
    worth finding. step: of differences. All in the unknown's own unit.
    """

    key: str
    effect: Effect
    parameter: Parameter
    choice: int | None = None

    @property
    def unit(self) -> str:
        return (self.parameter.unknown or self.parameter).unit

    @property
    def absent(self) -> float:
        one = self.parameter
        return one.to_unknown(one.default if one.kind == "shape" else one.absent)

    @property
    def plausible(self) -> tuple[float, float]:
        one = self.parameter
        low, high = sorted((one.to_unknown(one.low), one.to_unknown(one.high)))
        return low, high

    @property
    def bounds(self) -> tuple[float, float]:
        one = self.parameter
        if one.unknown is not None:
            return one.bounds
        return max(one.bounds[0], one.least), min(one.bounds[1], one.most)

    @property
    def worth(self) -> float:
        one = self.parameter
        if one.worth is not None:
            return one.worth
        return abs(one.to_unknown(one.default) - self.absent) or abs(one.default)

    @property
    def step(self) -> float:
        return self.parameter.step or 0.01 * max(self.worth, 1e-3 * abs(self.plausible[1]))


def variants(effect: Effect) -> tuple[tuple[Key, ...], ...]:
    """The ways in which an effect may be there, sizes before shapes: one, or one per choice."""
    choice, shapes = effect.choice, [p for p in effect.parameters if p.kind == "shape"]
    numbers = [((p.unknown or p).name, p) for p in (*effect.sizes, *shapes)]
    if choice is None:
        return (tuple(Key(f"{effect.name}.{name}", effect, p) for name, p in numbers),)
    found = []
    for which in range(int(choice.low), int(choice.high) + 1):
        stem = f"{effect.name}.{which}"
        keys = [stem if len(numbers) == 1 else f"{stem}.{name}" for name, _ in numbers]
        found.append(
            tuple(Key(key, effect, p, which) for key, (_, p) in zip(keys, numbers, strict=True))
        )
    return tuple(found)


def to_point(effect: Effect, given: Mapping[str, float]) -> dict[str, float]:
    """Parameters as a point; those not given have their default."""
    values = effect.values(given)
    which = None if effect.choice is None else int(values[effect.choice.name])
    keys = next(keys for keys in variants(effect) if keys[0].choice == which)
    return {one.key: one.parameter.to_unknown(values[one.parameter.name]) for one in keys}


def to_values(keys: tuple[Key, ...], point: Mapping[str, float]) -> dict[str, float]:
    """A variant's parameters at a point, in the effect's order."""
    effect = keys[0].effect
    found = {
        one.parameter.name: one.parameter.from_unknown(point.get(one.key, one.absent))
        for one in keys
    }
    if effect.choice is not None and keys[0].choice is not None:
        found[effect.choice.name] = float(keys[0].choice)
    return {p.name: found[p.name] for p in effect.parameters}


def to_stderr(
    keys: tuple[Key, ...], point: Mapping[str, float], errors: Mapping[str, float]
) -> dict[str, float]:
    """Standard errors of a variant's parameters from those of its unknowns (first order)."""
    found = {}
    for one in keys:
        if (error := errors.get(one.key)) is None:
            continue
        if one.parameter.unknown is not None:
            value = point.get(one.key, one.absent)
            ends = [one.parameter.from_unknown(value + sign * one.step) for sign in (1.0, -1.0)]
            error *= abs(ends[0] - ends[1]) / (2.0 * one.step)
        found[one.parameter.name] = error
    doubt = keys[0].effect.doubt
    if doubt is not None:
        for name, more in doubt(to_values(keys, point)).items():
            if name in found:
                found[name] = (found[name] ** 2 + more**2) ** 0.5
    return found


# Effects of the low-passes that today's firmware runs behind its sensors: what they share.
#
# Butterworth's filter of second order (``butterworth_slopes``), at 1 kHz on board
# (``sensors_bmi088_bmp3xx.c``). 0 Hz means no filter.


LOOP_S = 1e-3
"""How often the firmware runs it."""


def on_board_filter(
    name: str,
    law: Law,
    channels: tuple[Channel, ...],
    behind: str,
    corner: tuple[float, float],
    longest_s: float,
    **more: Any,
) -> Effect:
    """The effect of a filter behind ``behind`` (in words), which shows in its three ``channels``.

    corner: usual one and lowest, Hz. longest_s: time constant that a fit may reach. more: further
    fields of the ``Effect``.
    """
    usual_hz, lowest_hz = corner
    return Effect(
        name=name,
        stage="sensor",
        law=law,
        states=(
            *(State(f"filtered {axis}", follows=axis) for axis in channels),
            *(State(f"slope of filtered {axis}") for axis in channels),
        ),
        fastest=_fastest,
        parameters=(
            Parameter(
                "corner_hz",
                "Hz",
                default=usual_hz,
                low=lowest_hz,
                high=250.0,
                least=0.0,
                unknown=TIME_CONSTANT,
                bounds=(0.0, longest_s),
                step=1e-4,
            ),
        ),
        adds=f"the firmware's low-pass of second order behind the {behind}; 0 Hz means none",
        signature=f"the {behind} comes late by 1 / (4.4 corner) and shows no faster motion",
        channels=channels,
        on_board=f"{name}_hz",
        **more,
    )


def power_passed(hz: NDArray[np.float64], corner_hz: float) -> NDArray[np.float64]:
    """Share of a vibration's power that is left behind such a filter as the firmware runs it, by
    the bilinear transform (Oppenheim and Schafer); corner 0: all of it."""
    if corner_hz <= 0.0:
        return np.ones_like(hz)
    ratio = np.tan(math.pi * hz * LOOP_S) / math.tan(math.pi * corner_hz * LOOP_S)
    return np.asarray(1.0 / (1.0 + ratio**4), np.float64)


def _fastest(values: Mapping[str, float]) -> float:
    return 2.0 * math.pi * values["corner_hz"]
