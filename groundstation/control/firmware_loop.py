"""The firmware's loops: an angle PID that commands a rate PID, on the craft of a model.

Gains go by the firmware's parameter names (``pid_rate.roll_kp``). As release 2014.01.0 runs them:
angle loops, error in deg, output deg/s, 250 Hz; rate loops, error in deg/s, output in 16-bit PWM
units, 500 Hz; yaw is commanded as a rate. As today's firmware does: both at 500 Hz, derivatives of
what is measured, a yaw setpoint turns a heading that is held, and outputs are units of 16-bit
thrust, which a motor gets whatever the battery (``firmwares``). Each integral is clamped, not the
product with its gain. Here angles are in rad, pitch nose down positive; inside, the kernel turns
them into the firmware's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.control.firmwares import RELEASE_2014, Firmware
from groundstation.control.margins import LoopResponse, Margins
from groundstation.control.plant import Plant
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

Complex = NDArray[Any]

GAIN_MOST = 1000.0
"""No gain of either firmware comes near it."""
SUPPLY_MV = 3700.0
STEP_RAD = {"roll": math.radians(10), "pitch": math.radians(10), "yaw": math.radians(90)}
"""Sizes of the steps by which loops are judged; yaw's in rad/s."""

FIRMWARE = np.dtype(
    [
        ("rate_kp", "f8", (3,)),
        ("rate_ki", "f8", (3,)),
        ("rate_kd", "f8", (3,)),
        ("angle_kp", "f8", (3,)),
        ("angle_ki", "f8", (3,)),
        ("angle_kd", "f8", (3,)),
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


def firmware_of(
    gains: Mapping[str, float],
    firmware: Firmware = RELEASE_2014,
) -> NDArray[np.void]:
    """The firmware at rest, shape (1,); gains not named are stock."""
    record = np.zeros(1, FIRMWARE)
    f = record[0]
    values = {**firmware.stock, **gains}
    for group, loop in (("pid_rate", "rate"), ("pid_attitude", "angle")):
        for index, axis in enumerate(AXES):
            for gain in ("kp", "ki", "kd"):
                f[f"{loop}_{gain}"][index] = values[f"{group}.{axis}_{gain}"]
    f["rate_limit"], f["angle_limit"] = firmware.rate_limit, firmware.angle_limit
    f["today"], f["curve"], f["most_n"] = firmware.is_today, firmware.curve, firmware.most_n
    f["fusion_kp"], f["fusion_ki"] = 0.8, 0.002
    f["quaternion"][0] = 1.0
    return record


def run_cascade(
    plant: Plant,
    gains: Mapping[str, float],
    setpoints: ArrayLike,
    thrust: ArrayLike | None = None,
    supply_mv: ArrayLike = SUPPLY_MV,
) -> CascadeResponse:
    """Fly setpoints (k, 3), roll and pitch in rad, yaw rate in rad/s, one row per 2 ms.

    thrust: 16-bit, (k,) or one number, by default what carries the craft. supply_mv: likewise.
    The PWM is what a flight gives on average, in which the thrust wanders across many of its 512
    steps.
    The craft starts level, at rest, its rotors at the speed that carries it.
    """
    from groundstation.control.flight_kernels import cascade_run

    wanted = np.ascontiguousarray(setpoints, np.float64)
    rows = len(wanted)
    # new arrays: numba compiles the kernel anew, half a minute, for one that is read-only
    supply = np.full(rows, supply_mv, np.float64)
    if thrust is None:
        thrust = plant.hover_thrust(supply)
    lift = np.full(rows, thrust, np.float64)
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
    slope = 0.0
    if plant.firmware.is_today:
        slope = f["rate_kd"][index] * sharp
    angle = f["angle_kp"][index] + slow * f["angle_ki"][index] * integral
    angle = angle + f["angle_kd"][index] / slow * derivative
    if not plant.firmware.is_today:
        rate, slope = rate + slope, 0.0  # of the error, the angle loop's part included
    return base * (rate * (hold + angle * lean) + slope * hold)


def integral_ratios(firmware: Firmware) -> tuple[float, float]:
    """What the integrals of the rate and of the angle loops are multiplied by: 2014's clamp macro
    evaluates a rate PID three times a pass, and its angle PIDs integrate half their period."""
    return (1.0, 1.0) if firmware.is_today else (3.0, 0.5)


def cascade_margins(
    plant: Plant, gains: Mapping[str, float], axis: str, supply_mv: float = SUPPLY_MV
) -> Margins:
    """Margins of an axis's loops, broken at the motors' input; meaningful where it is stable."""
    return cascade_loop(plant, gains, axis, supply_mv).margins


def cascade_loop(
    plant: Plant, gains: Mapping[str, float], axis: str, supply_mv: float = SUPPLY_MV
) -> LoopResponse:
    """An axis's loops, broken at the motors' input."""
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

    def __call__(self, candidates: Array) -> Array:
        from groundstation.control.flight_kernels import cascade_many
        from groundstation.control.linear_loop_kernels import measure_many

        gains = np.tile(self._stock, (len(candidates), 1))
        gains[:, self._columns] = candidates
        worst, one = np.zeros((len(gains), 7)), np.zeros((len(gains), 7))
        peak, compliance = np.empty(len(gains)), np.empty(len(gains))
        room = self._rest.copy()
        for plant, parts, sides in zip(self._plants, self._parts, self._sides, strict=True):
            left = np.flatnonzero(np.isfinite(worst[:, 0]))
            level = 512.0 * plant.hover_duty(self._supply)
            y = np.zeros((len(sides), len(left), self._rows))
            effort = np.empty((len(sides), len(left)))
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
                    gains[left],
                    *parts,
                    self._late,
                    *self._ratios,
                    self._unusable,
                    side * self._size,
                    plant.hover_thrust(self._supply),
                    level,
                    self._supply,
                    SAMPLE_PERIOD_S,
                    peak[: len(left)],
                    largest,
                    compliance[: len(left)],
                    response,
                )
            measure_many(y.mean(axis=0), SAMPLE_PERIOD_S, self._band, one)
            here = one[: len(left)]
            here[:, 2] = np.where(np.isnan(here[:, 2]), np.inf, here[:, 2])
            here[:, 3] = np.abs(here[:, 3])
            here[:, 4], here[:, 5] = peak[: len(left)], effort.max(axis=0)
            here[:, 6] = compliance[: len(left)]
            here[~np.isfinite(here[:, 4])] = np.inf
            worst[left] = np.maximum(worst[left], here)
        return worst


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
    damping = plant.slopes(index)[0]
    base = math.degrees(1) * rate_per_pwm(plant, index, s, supply_mv)
    base = base * np.exp(-plant.sensor[0]["delay"] * s) * plant.gyro_response(s)
    push = 1 / (s + damping)
    twice = 2 * SAMPLE_PERIOD_S
    derivative = (1 - np.exp(-twice * s)) / twice
    push = np.abs(push * (1.0 if index == 2 else lean))
    if index == 2 and not plant.firmware.is_today:
        lean = np.zeros_like(s)  # no heading is held
    integral = 1 / s + 0.5 * SAMPLE_PERIOD_S
    sharp = (1 - np.exp(-SAMPLE_PERIOD_S * s)) / SAMPLE_PERIOD_S
    hold = hold_response(s, SAMPLE_PERIOD_S)
    return base, hold, lean, integral, derivative, sharp, push


def hold_response(s: Complex, period_s: float) -> Complex:
    """A value held for a period, at s (n,) in 1/s."""
    return (1 - np.exp(-period_s * s)) / (period_s * s)


def rate_per_pwm(plant: Plant, index: int, s: Complex, supply_mv: float) -> Complex:
    """rad/s of the craft's body per unit of the controller's output, of 16-bit PWM or thrust."""
    damping, by_speed, by_slope = plant.slopes(index)
    speed = speed_per_pwm(plant, index, s, supply_mv)
    return (by_speed + by_slope * s) * speed / (s + damping)


def speed_per_pwm(plant: Plant, index: int, s: Complex, supply_mv: float) -> Complex:
    """rev/s by which the rotors of an axis move, per unit of the controller's output."""
    motor = {key: float(plant.craft[0][key].mean()) for key in ("a0", "a1", "a2")}
    pole = motor["a1"] + 2 * motor["a2"] * plant.hover_rev_s
    if plant.firmware.is_today:
        volts = float(plant.hover_duty(supply_mv)) * supply_mv / 1000.0
        mv = 1000.0 * plant.firmware.volts_per_thrust(volts)
    else:
        mv = supply_mv / 65536.0
    # Roll moves two rotors (plus), or four by half (x); yaw moves all four.
    share = 0.5 if plant.airframe_x and index < 2 else 1.0
    return share * motor["a0"] * mv / (s + pole)
