"""The firmware's loops around a model, and the file of their gains."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.control.firmwares import (
    RELEASE_2014,
    RELEASES,
    Firmware,
    PidGains,
    Release,
    firmware_of_model,
    require_finite,
)
from groundstation.control.metrics import LoopResponse
from groundstation.documents import decode_toml, explained, read_document, seems
from groundstation.dynamics.craft import Crafts, craft_of_model, craft_of_motors
from groundstation.dynamics.effect import FAR_M
from groundstation.dynamics.model import Model, model_vehicle, rotor_motors
from groundstation.dynamics.sensors import SENSORS, sensors_of_model
from groundstation.dynamics.simulation import (
    RATE,
    ROTOR,
    accelerations,
    craft_state,
    hover_duty,
    hover_rev_s,
    with_states,
)
from groundstation.dynamics.vehicle import MIXERS
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

# The craft as the closed-loop simulations turn it: that of ``simulate``, with the same effects.
#
# A record of ``dynamics/craft.py``, and what lies between the craft and its controller. It begins
# level, in a hover far from the ground.


HOVER_REV_S = 230.0
"""Where a model without a body is flown: it does not say what carries the craft."""
NUDGE_RATE, NUDGE_SPEED = 1e-3, 1e-2
"""rad/s and rev/s, of the differences by which a hover is linearised."""


@dataclass(frozen=True, slots=True)
class Plant:
    """craft, sensor: records of shape (1,). hover_rev_s: rotor speed that carries the craft.
    mixer: (3, 4). fusion: the controller hears the firmware's attitude filter, not the truth.
    firmware: whose loops fly it.
    """

    craft: Crafts
    sensor: NDArray[np.void]
    hover_rev_s: float
    mixer: Array
    fusion: bool
    firmware: Firmware = RELEASE_2014

    @property
    def start(self) -> Array:
        """The state that a simulation begins in, (17 + those of effects,)."""
        state = craft_state((0.0, 0.0, FAR_M), rotor_rev_s=self.hover_rev_s)
        return np.array(with_states(self.craft, state[None])[0])

    @property
    def airframe_x(self) -> bool:
        return bool((self.mixer[0] != 0.0).all())

    def hover_duty(self, supply_mv: ArrayLike) -> Array:
        """Duty 0..1 (k,), mean of the rotors, that holds the hover at supplies (k,) in mV."""
        return hover_duty(self.craft, self.hover_rev_s, supply_mv)

    def hover_thrust(self, supply_mv: ArrayLike) -> Array:
        """The firmware's 16-bit thrust (k,) for it."""
        return self.firmware.thrust(self.hover_duty(supply_mv), supply_mv)

    def slopes(self, axis: int) -> tuple[float, float, float]:
        """Around the hover, of the angular acceleration of an axis: damping in 1/s, by the speed of
        all rotors moved as the mixer says in (rad/s^2) per rev/s, and by their slope."""
        moved, start = np.sign(self.mixer[axis]), self.start[None, : RATE.stop + 4]

        def turn(rate: float, speed: float, slope: float) -> float:
            state = start.copy()
            state[0, RATE.start + axis] = rate
            state[0, ROTOR] += speed * moved
            found = accelerations(self.craft, state, slope * moved[None])
            return float(found[0, axis])

        by_rate = (turn(NUDGE_RATE, 0, 0) - turn(-NUDGE_RATE, 0, 0)) / (2 * NUDGE_RATE)
        by_speed = (turn(0, NUDGE_SPEED, 0) - turn(0, -NUDGE_SPEED, 0)) / (2 * NUDGE_SPEED)
        return -by_rate, by_speed, 0.5 * (turn(0, 0, 1.0) - turn(0, 0, -1.0))

    def gyro_response(self, s: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """What the gyro makes of a rate at s (n,) in 1/s, without the delay."""
        if not self.craft[0]["sensor_states"]:
            return np.ones_like(s)
        last, left = _gyro_step(self.craft[:1].tobytes(), self.craft.dtype)
        # Laplace integral by midpoints, exp(-s t) = exp(-s of the block) exp(-s within it)
        within = RESPONSE_STEP_S * (np.arange(RESPONSE_BLOCK) + 0.5)
        begun = RESPONSE_STEP_S * RESPONSE_BLOCK * np.arange(len(left))
        blocks = np.exp(-np.outer(s, within)) @ left.T
        lost = (np.exp(-np.outer(s, begun)) * blocks).sum(axis=1) * RESPONSE_STEP_S
        return last - s * lost


RESPONSE_S, RESPONSE_STEP_S = 0.5, 1e-4
"""Length and step of the sensors' step response."""
RESPONSE_BLOCK = 100
"""Its rows in a block: 5000 rows want 150 exponentials a frequency and not 5000."""
SETTLED = 1e-12
"""rad/s: blocks that are closer to the end of a step of 1 rad/s are settled, but for rounding."""


@lru_cache(maxsize=512)
def _gyro_step(craft: bytes, fields: np.dtype[np.void]) -> tuple[float, Array]:
    """What the gyro shows in the end of a step of the rate by 1 rad/s, and what it lacks before,
    (n, ``RESPONSE_BLOCK``): the same for every axis of a craft."""
    from groundstation.dynamics.sensing import gyro_step

    shown = np.empty(round(RESPONSE_S / RESPONSE_STEP_S))
    gyro_step(np.frombuffer(craft, fields).copy()[0], RESPONSE_STEP_S, shown)
    left = (shown[-1] - shown).reshape(-1, RESPONSE_BLOCK)
    settled = np.flatnonzero(np.abs(left).max(axis=1) > SETTLED).max(initial=0)
    return float(shown[-1]), left[: settled + 1].copy()


def plant_of_model(model: Model, fusion: bool = True, release: str | None = None) -> Plant:
    """A fitted model with all its effects.

    fusion: the controller hears the firmware's attitude filter; otherwise the true angles.
    release: of the firmware, None: the vehicle's.

    Raises BadInputError for a model without a body, or a firmware that cannot fly it.
    """
    vehicle, craft = model_vehicle(model), craft_of_model(model)
    mixer, firmware = MIXERS[vehicle.configuration], firmware_of_model(model, release)
    sensor = sensors_of_model(model)
    return Plant(craft, sensor, hover_rev_s(craft), mixer, fusion, firmware)


def motors_of_model(model: Model) -> Plant:
    """The motors of a model without a body."""
    craft = craft_of_motors(rotor_motors(model), {})
    mixer = MIXERS[model_vehicle(model).configuration]
    return Plant(craft, np.zeros(1, SENSORS), HOVER_REV_S, mixer, False)


# The firmware's loops: an angle PID that commands a rate PID, on the craft of a model.
#
# Gains go by the firmware's parameter names (``pid_rate.roll_kp``). As release 2014.01.0 runs
# them: angle loops, error in deg, output deg/s, 250 Hz; rate loops, error in deg/s, output in
# 16-bit PWM units, 500 Hz; yaw is commanded as a rate. As today's firmware does: both at 500 Hz,
# derivatives of what is measured, a yaw setpoint turns a heading that is held, and outputs are
# units of 16-bit thrust, which a motor gets whatever the battery (``firmwares``). Each integral
# is clamped, not the product with its gain. Here angles are in rad, pitch nose down positive;
# inside, the kernel turns them into the firmware's.


Complex = NDArray[Any]

GAIN_MOST = 1000.0
"""No gain of either firmware comes near it."""
SUPPLY_MV = 3700.0
STEP_RAD = {"roll": math.radians(10), "pitch": math.radians(10), "yaw": math.radians(90)}
"""Sizes of the steps by which loops are judged; yaw's in rad/s."""

FIRMWARE_FIELDS = np.dtype(
    [
        *((f"{loop}_{k}", "f8", (3,)) for loop in ("rate", "angle") for k in ("kp", "ki", "kd")),
        ("rate_limit", "f8", (3,)),
        ("angle_limit", "f8", (3,)),
        ("fusion_kp", "f8"),
        ("fusion_ki", "f8"),
        ("today", "i8"),
        ("curve", "f8", (4,)),
        ("most_n", "f8"),
        ("heading", "f8"),
        ("integral", "f8", (2, 3)),
        ("previous", "f8", (2, 3)),
        ("quaternion", "f8", (4,)),
        ("feedback", "f8", (3,)),
    ]
)


@dataclass(frozen=True, slots=True)
class CascadeResponse:
    """One row per pass of 2 ms: angles (k, 3) rad as the firmware estimates them, gyro (k, 3)
    rad/s as it measures them, pwm (k, 4) in steps of 1/512 of full PWM."""

    angles: Array
    gyro: Array
    pwm: Array


def require_gains(gains: Mapping[str, float], where: str) -> None:
    """Raises BadInputError for a name the firmware has not, or a gain that is not 0..1000."""
    for name, value in gains.items():
        if name not in RELEASE_2014.stock:
            known = ", ".join(RELEASE_2014.stock)
            raise BadInputError(f"{where}: {name!r} is no gain of the firmware: {known}")
        if not (math.isfinite(value) and 0.0 <= value <= GAIN_MOST):
            raise BadInputError(f"{where}: {name} is {value}, must be 0..{GAIN_MOST:g}")


def firmware_of(gains: Mapping[str, float], firmware: Firmware = RELEASE_2014) -> NDArray[np.void]:
    """The firmware at rest, shape (1,); gains not named are stock."""
    record = np.zeros(1, FIRMWARE_FIELDS)
    f = record[0]
    values = {**firmware.stock, **gains}
    for group, loop in (("pid_rate", "rate"), ("pid_attitude", "angle")):
        for index, axis in enumerate(AXES):
            for gain in ("kp", "ki", "kd"):
                f[f"{loop}_{gain}"][index] = values[f"{group}.{axis}_{gain}"]
    f["rate_limit"], f["angle_limit"] = firmware.rate_limit, firmware.angle_limit
    f["today"], f["curve"], f["most_n"] = firmware.is_today, firmware.curve, firmware.most_n
    f["fusion_kp"], f["fusion_ki"], f["quaternion"][0] = 0.8, 0.002, 1.0
    return record


def run_cascade(
    plant: Plant,
    gains: Mapping[str, float],
    setpoints: ArrayLike,
    thrust: ArrayLike | None = None,
    supply_mv: ArrayLike = SUPPLY_MV,
) -> CascadeResponse:
    """Fly setpoints (k, 3), roll and pitch in rad, yaw rate in rad/s, one row per 2 ms.

    thrust: 16-bit, (k,) or one number, by default what carries the craft. supply_mv: likewise. The
    PWM is what a flight gives on average, in which the thrust wanders across many of its 512 steps.
    The craft starts level, at rest, its rotors at the speed that carries it.
    """
    from groundstation.control.kernels import cascade_run

    wanted = np.ascontiguousarray(setpoints, np.float64)
    rows = len(wanted)
    # new arrays: numba compiles the kernel anew, half a minute, for one that is read-only
    supply = np.full(rows, supply_mv, np.float64)
    lift = np.full(rows, plant.hover_thrust(supply) if thrust is None else thrust, np.float64)
    angles, gyro, pwm = np.empty((rows, 3)), np.empty((rows, 3)), np.empty((rows, 4))
    cascade_run(
        plant.craft[0],
        plant.sensor[0],
        plant.airframe_x,
        plant.fusion,
        plant.start,
        firmware_of(gains, plant.firmware)[0],
        wanted,
        lift,
        supply,
        SAMPLE_PERIOD_S,
        angles,
        gyro,
        pwm,
    )
    return CascadeResponse(angles, gyro, pwm)


def step_response(
    plant: Plant,
    gains: Mapping[str, float],
    axis: str,
    seconds: float = 1.5,
    supply_mv: float = SUPPLY_MV,
) -> Array:
    """The answer (k,) to a step of ``STEP_RAD`` on one axis, as a share of the step."""
    index = AXES.index(axis)
    setpoints = np.zeros((round(seconds / SAMPLE_PERIOD_S), 3))
    setpoints[:, index] = STEP_RAD[axis]
    response = run_cascade(plant, gains, setpoints, None, supply_mv)
    measured = response.gyro if axis == "yaw" else response.angles
    return measured[:, index] / STEP_RAD[axis]


def loop_response(
    plant: Plant,
    gains: Mapping[str, float],
    axis: str,
    omega: Array,
    supply_mv: float = SUPPLY_MV,
) -> Complex:
    """The loop broken at the motors' input, linear around hover, at omega (n,) in rad/s.

    The rate path is sampled and held for 2 ms. The angle path sums gyro samples and holds for
    4 ms; together that is an integral of the samples without further delay.
    """
    index = AXES.index(axis)
    s = 1j * omega
    base, hold, lean, integral, derivative, sharp, _ = _loop_parts(plant, index, s, supply_mv)
    f = firmware_of(gains, plant.firmware)[0]
    fast, slow = integral_ratios(plant.firmware)
    rate = f["rate_kp"][index] + fast * f["rate_ki"][index] * integral
    slope = f["rate_kd"][index] * sharp if plant.firmware.is_today else 0.0
    angle = f["angle_kp"][index] + slow * f["angle_ki"][index] * integral
    angle = angle + f["angle_kd"][index] / slow * derivative
    return base * (rate * (hold + angle * lean) + slope * hold)


def integral_ratios(firmware: Firmware) -> tuple[float, float]:
    """What the integrals of the rate and of the angle loops are multiplied by: 2014's clamp macro
    evaluates a rate PID three times a pass, and its angle PIDs integrate half their period."""
    return (1.0, 1.0) if firmware.is_today else (3.0, 0.5)


def cascade_loop(
    plant: Plant, gains: Mapping[str, float], axis: str, supply_mv: float = SUPPLY_MV
) -> LoopResponse:
    """An axis's loops, broken at the motors' input; their margins mean something where they are
    stable."""
    omega = np.geomspace(0.05, math.pi / SAMPLE_PERIOD_S, 1500)
    return LoopResponse(omega, loop_response(plant, gains, axis, omega, supply_mv))


UNUSABLE = 4.0
"""Maximum sensitivity beyond which a loop is not worth simulating."""


YIELDING = 2.0
"""Times as far as with the gains beside them, that fast pushes may move a craft: the price of a
closer answer to setpoints."""
SLOW_RAD_S, FAST_RAD_S = 3.0, 10.0
"""Below the first a push is what lasts: in a third of a second it is seen and answered."""
STILL_S, STILL_RAD_S = 0.3, 1e-6
"""A craft in trim turns no faster in so long."""


COLUMNS = {
    "pid_rate": {"kp": 0, "ki": 1, "kd": 5},
    "pid_attitude": {"kp": 2, "ki": 3, "kd": 4},
}
"""Where the kernel has the gains of an axis."""


Worth = Callable[[NDArray[np.intp], Array], NDArray[np.bool_]]
"""Whether candidates, by their rows (n,), may be any good, by the least that their judgements
(n, 7) can be: what has not been judged yet is 0."""


def all_worth(rows: NDArray[np.intp], judgements: Array) -> NDArray[np.bool_]:
    """Every candidate is to be judged to its end."""
    return np.ones(len(rows), np.bool_)


class CascadeJudge:
    """Judges gains (m, d) of one axis, as ``Firmware.gain_names`` orders them, by a step of
    ``STEP_RAD``; a craft that does not hover level with equal motors (an uneven rotor, a gyro's
    offset) by the mean of one up and one down, in which its trim cancels.

    plants: of one firmware.
    Columns as ``DirectJudge``; the worst of several plants counts. Effort is the largest step of a
    motor away from hover, as a share of full PWM; compliance is in rad, yaw's in rad/s, per
    rad/s^2. What is unstable or has a sensitivity beyond
    ``unusable`` is infinite throughout.

    beside: gains of the axis; compliance is then over theirs at each frequency, and a push faster
    than ``SLOW_RAD_S`` counts the less, down to a ``YIELDING``-th: at 1 what is slow (a centre of
    gravity, a weak rotor, wind) moves it no further, and what is fast ``YIELDING`` times as far.
    """

    def __init__(
        self,
        plants: Sequence[Plant],
        axis: str,
        seconds: float,
        spare_s: float = 0.0,
        supply_mv: float = SUPPLY_MV,
        band: float = 0.05,
        unusable: float = UNUSABLE,
        beside: Mapping[str, float] | None = None,
    ) -> None:
        self._band, self._unusable = band, unusable
        self._index, self._size = AXES.index(axis), STEP_RAD[axis]
        self._rows = round(seconds / SAMPLE_PERIOD_S)
        self._plants = tuple(plants)
        self._supply = np.full(self._rows, supply_mv)
        omega = np.geomspace(0.5, 700.0, 160)
        s = 1j * omega
        self._late = -omega * spare_s
        self._parts = [_loop_parts(plant, self._index, s, supply_mv) for plant in plants]
        if beside is not None:
            self._parts = [
                (*parts[:-1], _over(plant, beside, axis, omega, supply_mv))
                for plant, parts in zip(plants, self._parts, strict=True)
            ]
        firmware = plants[0].firmware
        self._rest = firmware_of({}, firmware)
        self._ratios = integral_ratios(firmware)
        names = [f"{group}.{axis}_{k}" for group, ks in COLUMNS.items() for k in ks]
        self._stock = np.zeros(len(names))
        for name in names:
            self._stock[_column(name)] = firmware.stock[name]
        self._columns = [_column(name) for name in firmware.gain_names(axis)]
        self._sides = [(1.0, -1.0) if _drifts(plant, supply_mv) else (1.0,) for plant in plants]
        if not firmware.is_today:
            self._stock[_column(f"pid_rate.{axis}_kd")] = 0.0  # without effect

    def __call__(self, candidates: Array, worth: Worth = all_worth) -> Array:
        """Gains (m, d) to judgements (m, 7). What turns out not to be worth it, before a plant is
        flown, by what is known so far, is infinite as well."""
        from groundstation.control.kernels import cascade_margins

        gains = np.tile(self._stock, (len(candidates), 1))
        gains[:, self._columns] = candidates
        worst, margins = np.zeros((len(gains), 7)), np.empty((2, len(gains)))
        for parts in self._parts:
            cascade_margins(gains, *parts, self._late, *self._ratios, *margins)
            worst[:, [4, 6]] = np.maximum(worst[:, [4, 6]], margins.T)
        worst[~(worst[:, 4] <= self._unusable) | ~np.isfinite(worst[:, 4])] = np.inf
        for plant, sides in zip(self._plants, self._sides, strict=True):
            left = np.flatnonzero(np.isfinite(worst[:, 0]))
            good = worth(left, worst[left])
            worst[left[~good]] = np.inf
            left = left[good]
            here = self._flown(plant, sides, gains[left])
            worst[left, :4] = np.maximum(worst[left, :4], here[:, :4])
            worst[left, 5] = np.maximum(worst[left, 5], here[:, 4])
        return worst

    def _flown(self, plant: Plant, sides: Sequence[float], gains: Array) -> Array:
        """RMS, overshoot, settling, steady-state error and effort (m, 5) of gains (m, 6)."""
        from groundstation.control.kernels import cascade_many, measure_many

        room, found = self._rest.copy(), np.zeros((len(gains), 5))
        level = 512.0 * plant.hover_duty(self._supply)
        lift = plant.hover_thrust(self._supply)
        y = np.zeros((len(sides), len(gains), self._rows))
        effort = np.empty((len(sides), len(gains)))
        for side, response, largest in zip(sides, y, effort, strict=True):
            cascade_many(
                plant.craft[0],
                plant.sensor[0],
                plant.airframe_x,
                plant.fusion,
                plant.start,
                self._rest[0],
                room[0],
                self._index,
                gains,
                side * self._size,
                lift,
                level,
                self._supply,
                SAMPLE_PERIOD_S,
                largest,
                response,
            )
        measure_many(y.mean(axis=0), SAMPLE_PERIOD_S, self._band, found)
        found[:, 2] = np.where(np.isnan(found[:, 2]), np.inf, found[:, 2])
        found[:, 3], found[:, 4] = np.abs(found[:, 3]), effort.max(axis=0)
        return found


def _over(
    plant: Plant, beside: Mapping[str, float], axis: str, omega: Array, supply_mv: float
) -> Array:
    """What a push moves without a controller, over what it moves with some gains and may more."""
    loop = loop_response(plant, beside, axis, omega, supply_mv)
    most = np.interp(np.log(omega), np.log([SLOW_RAD_S, FAST_RAD_S]), [1.0, YIELDING])
    return np.abs(1.0 + loop) / most


def _drifts(plant: Plant, supply_mv: float) -> bool:
    """Whether stock gains have something to trim where nothing is asked for."""
    still = run_cascade(plant, {}, np.zeros((round(STILL_S / SAMPLE_PERIOD_S), 3)), None, supply_mv)
    return bool(np.abs(still.gyro).max() > STILL_RAD_S)


def _column(name: str) -> int:
    group, _, rest = name.partition(".")
    return COLUMNS[group][rest[-2:]]


def _loop_parts(plant: Plant, index: int, s: Complex, supply_mv: float) -> tuple[Any, ...]:
    """base, hold, lean, integral, derivative, sharp, push: L = base ((rate gains) (hold +
    (angle gains) lean) + rate derivative hold); derivative and sharp are those of angle and rate,
    push what a push of 1 rad/s^2 moves without a controller."""
    leak = 0.4 if plant.fusion and index < 2 else 0.0
    lean = 1 / (s + leak)
    slopes = plant.slopes(index)
    damping = slopes[0]
    base = math.degrees(1) * rate_per_pwm(plant, slopes, index, s, supply_mv)
    base = base * np.exp(-plant.sensor[0]["delay"] * s) * plant.gyro_response(s)
    push = np.abs(1 / (s + damping) * (1.0 if index == 2 else lean))
    twice = 2 * SAMPLE_PERIOD_S
    derivative = (1 - np.exp(-twice * s)) / twice
    if index == 2 and not plant.firmware.is_today:
        lean = np.zeros_like(s)  # no heading is held
    integral = 1 / s + 0.5 * SAMPLE_PERIOD_S
    sharp = (1 - np.exp(-SAMPLE_PERIOD_S * s)) / SAMPLE_PERIOD_S
    hold = hold_response(s, SAMPLE_PERIOD_S)
    return base, hold, lean, integral, derivative, sharp, push


def hold_response(s: Complex, period_s: float) -> Complex:
    """A value held for a period, at s (n,) in 1/s."""
    return (1 - np.exp(-period_s * s)) / (period_s * s)


def rate_per_pwm(
    plant: Plant, slopes: tuple[float, float, float], index: int, s: Complex, supply_mv: float
) -> Complex:
    """rad/s of the craft's body per unit of the controller's output, of 16-bit PWM or thrust, at
    s (n,) in 1/s. slopes: ``Plant.slopes`` of the axis."""
    damping, by_speed, by_slope = slopes
    a0, a1, a2 = (float(plant.craft[0][key].mean()) for key in ("a0", "a1", "a2"))
    mv = supply_mv / 65536.0
    if plant.firmware.is_today:
        volts = float(plant.hover_duty(supply_mv)) * supply_mv / 1000.0
        mv = 1000.0 * plant.firmware.volts_per_thrust(volts)
    # Roll moves two rotors (plus), or four by half (x); yaw moves all four.
    share = 0.5 if plant.airframe_x and index < 2 else 1.0
    speed = share * a0 * mv / (s + (a1 + 2 * a2 * plant.hover_rev_s))
    return (by_speed + by_slope * s) * speed / (s + damping)


# Gains in a TOML file: the thesis's form by axis, or the firmware's by parameter name.
#
# [roll]                        firmware = "2014"
# kp = 1.5e6                    "pid_rate.roll_kp" = 5.1
# kd = 1.0e4                    "pid_attitude.roll_kp" = 3.2
#
# The names are those of both firmwares and the numbers mean other things to each: a file that names
# none holds gains of 2014's.


FIRMWARE = "firmware"
LOOP = "loop"
BY_AXIS = ("direct", "whole")
UNNAMED: Release = "2014"


def load_gains(path: str | Path) -> dict[str, PidGains] | dict[str, float]:
    """Gains by axis (thesis) or by parameter (firmware).

    Raises BadInputError naming what is wrong: no file, no TOML, an unknown name, a number that
    no gain can be.
    """
    where, table = f"gains {path}", _read(path)[0]
    if not table:
        raise BadInputError(f"{where}: holds no gains")
    if any(name in table for name in AXES):
        return {axis: _of_axis(value, f"{where}: {axis}") for axis, value in table.items()}
    values = {}
    for name, value in table.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise BadInputError(
                f'{where}: {name} is no number; write "pid_rate.roll_kp" = 5.1 with quotes'
            )
        values[name] = float(value)
    require_gains(values, where)
    return values


def firmware_of_gains(path: str | Path) -> Release | None:
    """The firmware that a file of gains is for; None where it names none.

    Raises as ``load_gains``.
    """
    return _read(path)[1]


def loop_of_gains(path: str | Path) -> str | None:
    """The loop, direct or whole, that a file of gains by axis is for; None where it names none.

    Raises as ``load_gains``.
    """
    return _read(path)[2]


def require_gains_of(
    path: str | Path, release: Release, whose: str, *, said: str | None = None
) -> None:
    """Raises BadInputError where a file of the firmware's gains is for another release.

    whose: what flies ``release``, in words. said: the release that the user says the file is for.
    """
    named = firmware_of_gains(path)
    if said is not None and named is not None and named != said:
        raise BadInputError(f"gains {path}: for firmware {named}, --firmware says {said}")
    if (named or said or UNNAMED) == release:
        return
    what = f'taken for firmware {UNNAMED}, for no line says firmware = "{release}"'
    if named or said:
        what = f"for firmware {named or said}"
    raise BadInputError(
        f"gains {path}: {what}; {whose} flies {release}, where the same names mean other numbers"
    )


def gains_text(
    gains: Mapping[str, PidGains] | Mapping[str, float],
    release: Release | None = None,
    loop: str | None = None,
) -> str:
    """What ``load_gains`` reads back to the same numbers. release, loop: whose gains they are."""
    lines = [f'{FIRMWARE} = "{release}"'] if release else []
    lines += [f'{LOOP} = "{loop}"'] if loop else []
    for name, value in gains.items():
        if isinstance(value, PidGains):
            by_name = msgspec.structs.asdict(value).items()
            lines += [f"[{name}]", *(f"{k} = {v!r}" for k, v in by_name)]
        else:
            lines.append(f'"{name}" = {value!r}')
    return "\n".join(lines) + "\n"


def _read(path: str | Path) -> tuple[dict[str, Any], Release | None, str | None]:
    """A file's gains as they stand, the firmware and the loop that it names."""
    where, content = f"gains {path}", b""
    try:
        content = read_document(Path(path))
        table = decode_toml(content, dict[str, Any])
    except (OSError, ValueError) as error:
        raise BadInputError(f"{where}: cannot be read: {error}{seems(content)}") from error
    release, loop = (table.pop(key, None) for key in (FIRMWARE, LOOP))
    for key, value, known in ((FIRMWARE, release, RELEASES), (LOOP, loop, BY_AXIS)):
        if value is not None and value not in known:
            raise BadInputError(f"{where}: {key} is {value!r}, there are {', '.join(known)}")
    return table, release, loop


def _of_axis(value: Any, where: str) -> PidGains:
    if where.rsplit(" ", 1)[-1] not in AXES:
        raise BadInputError(f"{where} is no axis: there are {', '.join(AXES)}")
    try:
        gains = msgspec.convert(value, PidGains, strict=False)
    except msgspec.ValidationError as error:
        raise BadInputError(f"{where}: {explained(error, PidGains)}") from error
    require_finite(gains, where)
    return gains
