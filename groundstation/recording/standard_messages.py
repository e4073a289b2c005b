"""Telemetry as the message types that any viewer knows: Imu and BatteryState, at 50 Hz or more.

Both have a fixed size here, so a batch is one structured array, laid out as CDR lays it out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.rotations import quaternion_of_attitude
from groundstation.recording.cdr import HEADER
from groundstation.telemetry.packet import SAMPLE_PERIOD_S
from groundstation.telemetry.samples import SampleBatch

IMU_TOPIC = "/imu"
BATTERY_TOPIC = "/battery"
RATE_HZ = 50.0

SEPARATOR = "=" * 80
HEADER_DEFINITION = f"""\
{SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
TIME_DEFINITION = f"""\
{SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
QUATERNION_DEFINITION = f"""\
{SEPARATOR}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
IMU_DEFINITION = f"""\
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
{QUATERNION_DEFINITION}{SEPARATOR}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
{HEADER_DEFINITION}{TIME_DEFINITION}"""
BATTERY_DEFINITION = f"""\
uint8 POWER_SUPPLY_STATUS_UNKNOWN=0
uint8 POWER_SUPPLY_HEALTH_UNKNOWN=0
uint8 POWER_SUPPLY_TECHNOLOGY_LIPO=3
std_msgs/Header header
float32 voltage
float32 temperature
float32 current
float32 charge
float32 capacity
float32 design_capacity
float32 percentage
uint8 power_supply_status
uint8 power_supply_health
uint8 power_supply_technology
bool present
float32[] cell_voltage
float32[] cell_temperature
string location
string serial_number
{HEADER_DEFINITION}{TIME_DEFINITION}"""

_FRAME = b"base_link\0"
_LIPO = 3
_STAMP = {
    "cdr": ("S4", 0),
    "sec": ("<i4", 4),
    "nanosec": ("<u4", 8),
    "frame_length": ("<u4", 12),
    "frame": (f"S{len(_FRAME)}", 16),
}


def layout(fields: dict[str, tuple[str, int]], size: int) -> np.dtype[np.void]:
    everything = {**_STAMP, **fields}
    return np.dtype(
        {
            "names": list(everything),
            "formats": [kind for kind, _ in everything.values()],
            "offsets": [offset for _, offset in everything.values()],
            "itemsize": size,
        }
    )


_IMU = layout(
    {
        "orientation": ("(4,)<f8", 28),
        "orientation_covariance": ("(9,)<f8", 60),
        "angular_velocity": ("(3,)<f8", 132),
        "angular_velocity_covariance": ("(9,)<f8", 156),
        "linear_acceleration": ("(3,)<f8", 228),
        "linear_acceleration_covariance": ("(9,)<f8", 252),
    },
    324,
)
_BATTERY = layout(
    {
        "voltage": ("<f4", 28),
        "unmeasured": ("(6,)<f4", 32),  # temperature ... percentage
        "technology": ("u1", 58),
        "present": ("u1", 59),
        "location_length": ("<u4", 68),  # two empty sequences before it
        "serial_length": ("<u4", 76),  # an empty string is its terminator alone
    },
    81,
)


Maker = Callable[[SampleBatch], Iterator[tuple[str, int, bytes]]]
"""Topic, log time (ns) and CDR payload of what rows come to."""


class StandardMessages:
    """Thins sample batches to one message per topic in each period of device time.

    Remembers which period it has served, so that consecutive batches join without a seam.
    rate_hz: periods a second. more: what else is made of the rows that are chosen.
    """

    def __init__(self, rate_hz: float = RATE_HZ, more: Maker | None = None) -> None:
        self._rate_hz, self._more = rate_hz, more
        self._segment: int | None = None
        self._origin_s = 0.0
        self._slot = -1

    def messages(self, batch: SampleBatch) -> Iterator[tuple[str, int, bytes]]:
        """Topic, log time (ns) and CDR payload for what ``batch`` adds."""
        if not len(batch):
            return
        restarts = np.flatnonzero(np.diff(batch.segment)) + 1
        runs = zip(np.split(batch.segment, restarts), np.split(batch.time_s, restarts), strict=True)
        chosen = batch[np.concatenate([self._new(int(run[0]), times) for run, times in runs])]
        if not len(chosen):
            return
        times = np.maximum(chosen.host_time_ns, 0)
        if not _nothing_known(chosen):
            for time_ns, message in zip(times.tolist(), _imu(chosen), strict=True):
                yield IMU_TOPIC, time_ns, message.tobytes()
        for time_ns, message, volt in zip(
            times.tolist(), _battery(chosen), chosen.battery_v, strict=True
        ):
            if np.isfinite(volt):
                yield BATTERY_TOPIC, time_ns, message.tobytes()
        if self._more is not None:
            yield from self._more(chosen)

    def _new(self, segment: int, time_s: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which samples of one segment are the first of their period."""
        if segment != self._segment:
            self._segment, self._origin_s, self._slot = segment, float(time_s[0]), -1
        since_s = time_s - self._origin_s
        # half a sample early, or the rounding of ticks decides which sample is first
        slots = np.floor((since_s + SAMPLE_PERIOD_S / 2) * self._rate_hz).astype(np.int64)
        new = np.diff(slots, prepend=self._slot) != 0
        self._slot = int(slots[-1])
        return new


def quaternion(attitude_rad: NDArray[np.floating]) -> NDArray[np.float64]:
    """Body-to-inertial unit quaternions in ROS's order x y z w, shape (n, 4), of angles (n, 3)."""
    return np.roll(quaternion_of_attitude(attitude_rad), -1, axis=-1)


def _nothing_known(batch: SampleBatch) -> bool:
    channels = (batch.attitude, batch.gyro, batch.accelerometer)
    return not any(bool(np.isfinite(channel).any()) for channel in channels)


def stamped(layout: np.dtype[np.void], batch: SampleBatch) -> NDArray[np.void]:
    out = np.zeros(len(batch), layout)
    out["cdr"] = HEADER
    times = np.maximum(batch.host_time_ns, 0)
    out["sec"] = np.minimum(times // 1_000_000_000, np.iinfo(np.int32).max)
    out["nanosec"] = times % 1_000_000_000
    out["frame_length"] = len(_FRAME)
    out["frame"] = _FRAME
    return out


def _imu(batch: SampleBatch) -> NDArray[np.void]:
    out = stamped(_IMU, batch)
    channels = (
        ("orientation", batch.attitude, quaternion),
        ("angular_velocity", batch.gyro, np.asarray),
        ("linear_acceleration", batch.accelerometer, np.asarray),
    )
    for name, values, convert in channels:
        known = np.atleast_2d(np.isfinite(values).all(axis=1, keepdims=True))
        out[name] = convert(np.where(known, values, 0))
        # a first covariance of -1 is the message's own mark for "no such estimate"
        out[f"{name}_covariance"][:, 0] = np.where(known[:, 0], 0.0, -1.0)
    return out


def _battery(batch: SampleBatch) -> NDArray[np.void]:
    out = stamped(_BATTERY, batch)
    out["voltage"] = batch.battery_v
    out["unmeasured"] = np.nan
    out["technology"] = _LIPO
    out["present"] = 1
    out["location_length"] = 1
    out["serial_length"] = 1
    return out
