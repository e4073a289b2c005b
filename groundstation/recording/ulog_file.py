"""PX4's ULog files: every topic of the log as a series, read by pyulog (extra ``logs``)."""

from __future__ import annotations

import contextlib
import io
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError, RecordingError, install
from groundstation.recording.column_map import read_mapped_series
from groundstation.recording.motor_columns import MOVES, changes, too_many
from groundstation.recording.session import Findings, Log, Recording, Series
from groundstation.telemetry.arrays import Array

# Which of a PX4 driver's outputs are motors 1 to 4, and what stands for none and full duty.
#
# An output is what its driver was told: a pulse, a DShot value, an ESC's count on a bus, a speed
# of a simulated rotor. Functions and ends of the ranges are parameters of the driver's prefix;
# without them, the numbers decide.


Parameters = Mapping[str, float]

MOTOR_1, MOTORS = 101, 12
"""Of an output's function that is motor 1 (PWM_MAIN_FUNCn), and how many such functions follow."""
PULSES, ONE_SHOT_US, DSHOT = (1000.0, 2000.0), (125.0, 250.0), (0.0, 1999.0)
"""Ends of the drivers' ranges: pulses where no parameter says others, OneShot125, PX4's DShot."""
ESC, SPEED = (0.0, 8191.0), (0.0, 1000.0)
"""The same of UAVCAN's ESCs, and of Gazebo's rotors, rad/s."""
DRIVERS = {"PWM_MAIN": PULSES, "PWM_AUX": PULSES, "UAVCAN_EC": ESC, "SIM_GZ_EC": SPEED}
WITH_FUNCTIONS = (*DRIVERS, "HIL_ACT")
LEAST_PWM_US, MOST_PWM_US = 800.0, 2200.0
"""Other values are of another protocol than pulses."""
DSHOT_TIMER = -2.0
"""Largest PWM_MAIN_TIMn that is DShot: -5 to -2 are its rates, -1 is OneShot, others pulses' Hz."""
BELOW_LOW, ABOVE_HIGH = 0.8, 1.1
"""Of a range's ends, beyond which outputs are not in it: disarmed ones are below by a tenth."""
NOT_KNOWN = (
    "the range of the motors' outputs is not known: up to {:.4g}, which {} would be as well; the"
    " parameters do not say, and the duty may be wrong by a factor"
)


@dataclass(frozen=True, slots=True)
class Outputs:
    """places: of motors 1 to 4 among an instance's outputs. prefix: of the driver's parameters,
    where their functions say the places. crowd: why they are no quadrotor's, or empty."""

    places: list[int]
    prefix: str = ""
    crowd: str = ""


@dataclass(frozen=True, slots=True)
class Range:
    """low, high: what stands for no and full duty, of each motor or all. what: in words. open: what
    is not known of it."""

    low: Array | float
    high: Array | float
    what: str
    open: str = ""


def motors_among(values: Array, parameters: Parameters) -> Outputs:
    """By the functions that the parameters give outputs (n, k), as far as these move; else the
    four that move, the first of them; where fewer do, the first four."""
    count = changes(values)
    for prefix in WITH_FUNCTIONS:
        given = {
            int(parameters.get(f"{prefix}_FUNC{k + 1}", 0)) - MOTOR_1: k
            for k in range(values.shape[1])
        }
        places = [given[motor] for motor in range(4) if motor in given]
        if len(places) == 4 and count[places].min() > 0:
            more = [given[motor] for motor in range(4, MOTORS) if motor in given]
            return Outputs(places, prefix, crowd_of(count, places, more, "output"))
    moving = np.flatnonzero(count > MOVES * float(np.median(np.sort(count)[-4:])))
    places = [int(k) for k in moving[:4]] if len(moving) >= 4 else [0, 1, 2, 3]
    others = [k for k in range(len(count)) if k not in places]
    return Outputs(places, crowd=crowd_of(count, places, others, "output"))


def crowd_of(
    count: NDArray[np.intp], places: Sequence[int], others: Sequence[int], field: str
) -> str:
    """Why more than the motors at these places move, by how often each output changes, or empty."""
    names = [f"{field}[{k}]" for k in others]
    return too_many(count[list(places)], count[list(others)], names)


def range_of(given: Array, parameters: Parameters, found: Outputs) -> Range | None:
    """What the motors' outputs (n, 4) mean; None where nothing that is known has such numbers."""
    turning = given[np.isfinite(given) & (given > 0.0)]
    least, most = (float(turning.min()), float(turning.max())) if len(turning) else PULSES
    timers = [
        value
        for prefix in ([found.prefix] if found.prefix else ["PWM_MAIN", "PWM_AUX"])
        for k in range(8)
        if (value := parameters.get(f"{prefix}_TIM{k}")) is not None
    ]
    digital = any(one <= DSHOT_TIMER for one in timers) or parameters.get("DSHOT_CONFIG", 0.0) > 0.0
    bus = found.prefix and not found.prefix.startswith("PWM")
    if digital and not bus and 1.0 < most <= DSHOT[1]:
        return Range(*DSHOT, "DShot")
    told = _told(parameters, found, least, most)
    return told if told is not None else _by_numbers(parameters, found, least, most)


def _told(parameters: Parameters, found: Outputs, least: float, most: float) -> Range | None:
    """By the ends that the parameters of the driver say, where the numbers lie between them."""
    prefix = found.prefix or "PWM_MAIN"
    if prefix not in DRIVERS:
        return None
    ends = []
    for end, usual in zip(("MIN", "MAX"), DRIVERS[prefix], strict=True):
        shared = parameters.get(f"{prefix}_{end}", usual)
        if prefix == "PWM_MAIN":
            shared = parameters.get(f"PWM_{end}", shared)
        own = [parameters.get(f"{prefix}_{end}{k + 1}", -1.0) for k in found.places]
        ends.append(np.array([one if one >= 0.0 else shared for one in own]))
    low, high = ends
    if not (high > low).all():
        low, high = (np.full(4, end) for end in DRIVERS[prefix])
    if least < BELOW_LOW * low.min() or most > ABOVE_HIGH * high.max():
        return None
    if not found.prefix and not (least >= LEAST_PWM_US and most <= MOST_PWM_US):
        return None
    unit = {"UAVCAN_EC": "an ESC's counts", "SIM_GZ_EC": "rotor speeds"}.get(prefix, "pulses")
    of = " us" if unit == "pulses" else " rad/s" if unit == "rotor speeds" else ""
    return Range(low, high, f"{unit} of {low[0]:g} to {high[0]:g}{of}")


def _by_numbers(parameters: Parameters, found: Outputs, least: float, most: float) -> Range | None:
    """By their least and most while the motors turn."""
    if most <= 1.0:
        return Range(0.0, 1.0, "fractions")
    if most <= ONE_SHOT_US[1] and least >= ONE_SHOT_US[0] - 5.0:
        return Range(*ONE_SHOT_US, "OneShot125")
    if least >= LEAST_PWM_US and most <= MOST_PWM_US:
        return Range(*PULSES, "pulses of 1000 to 2000 us")
    if most <= SPEED[1]:
        if any(one.startswith("SIM_GZ_EC_FUNC") for one in parameters) and not found.prefix:
            return Range(*SPEED, "rotor speeds of 0 to 1000 rad/s")
        return Range(*DSHOT, "DShot", NOT_KNOWN.format(most, "a simulation's 0 to 1000"))
    if most <= DSHOT[1]:
        return Range(*DSHOT, "DShot")
    if most <= ESC[1]:
        return Range(*ESC, "an ESC's counts of 0 to 8191")
    return None


# The motors of a PX4 quadrotor, from whichever topics a log has, in our order and as duty.
#
# ``actuator_motors`` (since 1.13) has the thrust that was asked for, each rotor's place in
# ``CA_ROTORn_PX`` and ``_PY``; ``THR_MDL_FAC`` f makes it the signal s: f s^2 + (1 - f) s. Before,
# ``actuator_outputs`` has what an output was told, an instance for each driver; most idle.


NAME = "quadrotor_motors"
"""Of the series that is made, with columns m1 to m4: fractions of full duty."""
ORDER = (0, 3, 1, 2)
"""Ours (front right, rear right, rear left, front left) in the order of PX4's quadrotor x."""
BETAFLIGHT_ORDER = (1, 0, 2, 3)
"""The same where MOT_ORDERING is 1: rear right, front right, rear left, front left."""
QUADRANTS = ((1, 1), (-1, 1), (-1, -1), (1, -1))
"""Signs of forward and right of our rotors' places."""
SPINS = (1, -1, 1, -1)
"""Signs of CA_ROTORn_KM of our rotors: 1 and 3 turn counter-clockwise."""
MAV_TYPES = {
    **{1: "a fixed wing", 3: "a coaxial helicopter", 4: "a helicopter", 10: "a rover"},
    **{11: "a boat", 12: "a submarine", 13: "a hexarotor", 14: "an octorotor", 15: "a tricopter"},
    **dict.fromkeys((19, 20, 21, 22, 23, 24, 25), "a VTOL"),
}
"""Crafts by MAVLink's MAV_TYPE that are no quadrotor, which is 2."""
ASKED = (
    "the motors' duty is not known: actuator_motors is the thrust that was asked for, and the log"
    " has no THR_MDL_FAC, by which it becomes duty"
)


@dataclass(frozen=True, slots=True)
class Motors:
    """series: with columns m1 to m4, None where there are none. notes: what was settled. open: what
    was not, or why there are none; empty where all is known."""

    series: Series | None
    notes: tuple[str, ...] = ()
    open: str = ""


def motors_of(series: Sequence[Series], parameters: Parameters) -> Motors:
    """The motors of a log. parameters: of the craft, as far as the log has them."""
    if reason := _another_craft(parameters):
        return Motors(None, open=reason)
    asked = [one for one in _instances(series, "actuator_motors") if "control[3]" in one.columns]
    outputs = _instances(series, "actuator_outputs")
    told = _moved(outputs, "output")
    if asked:
        moved = _moved(asked, "control")
        if max(told, default=0) > 0 and (max(moved) <= 0 or "THR_MDL_FAC" not in parameters):
            motors = _of_outputs(outputs, parameters)
            if max(moved) <= 0 or (motors.series is not None and not motors.open):
                still = () if max(moved) > 0 else ("actuator_motors never moves",)
                return Motors(motors.series, (*still, *motors.notes), motors.open)
        return _of_thrust(asked, moved, parameters)
    return _of_outputs(outputs, parameters) if outputs else Motors(None)


def _instances(series: Sequence[Series], topic: str) -> list[Series]:
    return [one for one in series if re.fullmatch(rf"{topic}(\.\d+)?", one.name)]


def _moved(instances: Sequence[Series], field: str) -> list[int]:
    """How often the least busy of four columns changes, of each instance; -1 of one with fewer."""
    tables = [_numbered(one, field) for one in instances]
    return [int(np.sort(changes(one))[-4]) if one.shape[1] >= 4 else -1 for one in tables]


def _chosen(instances: Sequence[Series], moved: Sequence[int], what: str) -> str:
    """A note on the instance that moves most often, empty where it is the only one."""
    best = int(np.argmax(moved))
    if len(instances) == 1:
        return ""
    idle = ", ".join(one.name for one, count in zip(instances, moved, strict=True) if count <= 0)
    least = f"; not {idle}" if idle else " most often"
    return f"the motors are {instances[best].name}, whose {what} move{least}"


def _another_craft(parameters: Parameters) -> str:
    kind = parameters.get("MAV_TYPE", 2.0)
    if kind != 2.0:
        also = f", {MAV_TYPES[int(kind)]}" if kind in MAV_TYPES else ""
        return f"not of a quadrotor (MAV_TYPE {kind:g}{also}): its motors are left out"
    rotors = parameters.get("CA_ROTOR_COUNT", 4.0)
    if rotors != 4.0:
        return f"not of a quadrotor (CA_ROTOR_COUNT {rotors:g}): its motors are left out"
    return ""


def _of_thrust(asked: Sequence[Series], moved: Sequence[int], parameters: Parameters) -> Motors:
    best = asked[int(np.argmax(moved))]
    columns = _numbered(best, "control")
    count = changes(columns)
    if reason := crowd_of(count, range(4), range(4, len(count)), "control"):
        return Motors(None, open=reason)
    factor = parameters.get("THR_MDL_FAC", 0.0)
    thrust = np.nan_to_num(columns[:, :4], nan=0.0).clip(0.0, 1.0)  # NaN: disarmed
    note = _chosen(asked, moved, "controls")
    duty, notes = thrust, [note] if note else []
    if 0.0 < factor <= 1.0:
        root = np.sqrt((1.0 - factor) ** 2 + 4.0 * factor * thrust)
        duty = (root - (1.0 - factor)) / (2.0 * factor)
        notes.append(f"the motors' duty is their thrust command through THR_MDL_FAC {factor:g}")
    motors = _ordered(best, duty, parameters, notes)
    if "THR_MDL_FAC" in parameters or motors.series is None:
        return motors
    return Motors(motors.series, motors.notes, "; ".join(filter(None, [ASKED, motors.open])))


def _of_outputs(outputs: Sequence[Series], parameters: Parameters) -> Motors:
    """Those of the instance of which four move most often."""
    moved = _moved(outputs, "output")
    best = int(np.argmax(moved))
    if moved[best] < 0:
        return Motors(None, open="no instance of actuator_outputs has four outputs: no motors")
    values = _numbered(outputs[best], "output")
    found = motors_among(values, parameters)
    if found.crowd:
        return Motors(None, open=found.crowd)
    note = _chosen(outputs, moved, "outputs")
    notes = [note] if note else []
    given = values[:, found.places]
    meant = range_of(given, parameters, found)
    if meant is None:
        most = float(np.nanmax(given))
        return Motors(None, open=f"outputs up to {most:.4g}, which no driver has: no motors")
    if found.places != [0, 1, 2, 3] and not found.prefix:
        listed = ", ".join(str(k) for k in found.places)
        notes.append(f"the motors are outputs {listed}, the four that move")
    notes.append(f"the motors' outputs are {meant.what}")
    duty = np.clip((given - meant.low) / (meant.high - meant.low), 0.0, None)
    duty[given <= 0.0] = 0.0
    motors = _ordered(outputs[best], duty, parameters, notes)
    open_ = "; ".join(filter(None, [meant.open, motors.open]))
    return motors if motors.series is None else Motors(motors.series, motors.notes, open_)


def _ordered(source: Series, duty: Array, parameters: Parameters, notes: Sequence[str]) -> Motors:
    """In our order: by the rotors' places, where the parameters have them."""
    order: Sequence[int] = ORDER if parameters.get("MOT_ORDERING", 0.0) != 1.0 else BETAFLIGHT_ORDER
    open_ = ""
    places = [
        (parameters.get(f"CA_ROTOR{k}_PX"), parameters.get(f"CA_ROTOR{k}_PY")) for k in range(4)
    ]
    if all(x is not None and y is not None for x, y in places):
        signs = [(int(np.sign(x or 0.0)), int(np.sign(y or 0.0))) for x, y in places]
        if set(signs) != set(QUADRANTS):
            return Motors(None, open="not of a quadrotor x (CA_ROTORn_PX, _PY): motors left out")
        order = [signs.index(quadrant) for quadrant in QUADRANTS]
        spins = [parameters.get(f"CA_ROTOR{k}_KM", 0.0) for k in order]
        if all(spin * usual < 0.0 for spin, usual in zip(spins, SPINS, strict=True)):
            open_ = "its rotors turn the other way round (CA_ROTORn_KM): c2 comes out negative"
    columns = {f"m{number}": duty[:, place] for number, place in enumerate(order, start=1)}
    return Motors(Series(NAME, source.time_ns, columns), tuple(notes), open_)


def _numbered(series: Series, field: str) -> Array:
    """Columns ``field[0]``, ``field[1]``, ... (n, k)."""
    columns: list[Array] = []
    while (name := f"{field}[{len(columns)}]") in series.columns:
        columns.append(np.asarray(series.columns[name], np.float64))
    return np.column_stack(columns) if columns else np.empty((len(series.time_ns), 0))


MAGIC = b"ULog\x01\x12\x35"
US_NS = 1000
HEADER_BYTES = 3
"""Of a message."""


class _OnlyForward(io.BufferedReader):
    """A file for pyulog, which steps back from the end of a message: where the file ends within it,
    to before its beginning, and again for ever."""

    _message_at = 0

    def read(self, size: int | None = -1, /) -> bytes:
        if size == HEADER_BYTES:
            self._message_at = self.tell()
        return super().read(size)

    def seek(self, offset: int, whence: int = 0, /) -> int:
        if whence == io.SEEK_CUR and self.tell() + offset < self._message_at:
            return super().seek(0, io.SEEK_END)
        return super().seek(offset, whence)


def read_ulog(path: Path, source: str | Path | None = None) -> Recording:
    """Read a ULog by a column map (None: the named one that knows it).

    A topic is a series of its name; of several instances, the first has the plain name and the
    others ``NAME.1``, ``NAME.2``. A quadrotor's motors are ``quadrotor_motors.m1`` to ``m4``.

    Raises BadInputError where no map fits, and as ``content_of``.
    """
    return read_mapped_series(path, "ulog", content_of(path), source)


@np.errstate(invalid="ignore")  # damage may leave a NaN that numpy signals when it is converted
def content_of(path: Path) -> Log:
    """Every topic, and a quadrotor's motors.

    Raises BadInputError where pyulog is not installed, RecordingError where the file does not read.
    """
    try:
        from pyulog import ULog
        from pyulog.exceptions import ULogException
    except ImportError as error:
        raise BadInputError(f"{path}: a ULog, which pyulog reads: {install('logs')}") from error
    try:
        with (
            contextlib.redirect_stdout(io.StringIO()),  # it prints what it thinks of a file
            _OnlyForward(io.FileIO(path)) as file,
        ):
            log = ULog(file)
    except (
        ULogException,
        OSError,
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        struct.error,
        AttributeError,
        MemoryError,
    ) as error:
        raise RecordingError(
            f"{path}: a damaged ULog, which cannot be read; copy it from the card again"
        ) from error
    series = []
    for one in log.data_list:
        if "timestamp" not in one.data:  # its definition is damaged
            continue
        time_ns = one.data["timestamp"].astype(np.int64) * US_NS
        order = np.argsort(time_ns, kind="stable")
        name = f"{one.name}.{one.multi_id}" if one.multi_id else one.name
        columns = {field: values[order] for field, values in one.data.items()}
        series.append(Series(name, time_ns[order], columns))
    damage = ["the log is damaged; what was in order was read"] if log.file_corruption else []
    damage += _dropped([int(one.duration) for one in log.dropouts])
    parameters = {
        name: float(value)
        for name, value in log.initial_parameters.items()
        if isinstance(value, (int, float))
    }
    motors = motors_of(series, parameters)
    series += [motors.series] if motors.series is not None else []
    unclear = {"duty": motors.open} if motors.open else {}
    return Log(series, Findings(damage, list(motors.notes), unclear))


def _dropped(durations_ms: list[int]) -> list[str]:
    """A line for all that the logger could not write, none where it could."""
    if not durations_ms:
        return []
    places = f"in {len(durations_ms)} places, the longest {max(durations_ms)} ms"
    where = "in one place" if len(durations_ms) == 1 else places
    return [f"the logger dropped {sum(durations_ms)} ms {where}"]
