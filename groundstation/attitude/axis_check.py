"""Are the axes what they should be? (thesis 6.3)

The craft is turned by hand about roll (left up first), then pitch (nose down first), then yaw
(counter-clockwise first), each there and back. Every source of attitude must show the three turns
on its own three axes, in this order and with these signs. Which of its axes a source shows a turn
on follows from when each axis moves; so an axis that is inverted, or swapped with another, is
named for each source by itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from groundstation.attitude.sensors import rest_bias
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch

LEAST_TURN = np.radians(10.0)
LEAST_SECONDS = 3.0


@dataclass(frozen=True, slots=True)
class AxisFinding:
    """What one source shows of one turn.

    shown_on: the source's axis that moved when this one was turned. inverted: the wrong way.
    """

    source: str
    axis: str
    shown_on: str
    inverted: bool

    @property
    def as_expected(self) -> bool:
        return self.shown_on == self.axis and not self.inverted

    def __str__(self) -> str:
        if self.as_expected:
            return f"{self.source} {self.axis}: as expected"
        place = "" if self.shown_on == self.axis else f" appears on the {self.shown_on} axis"
        sign = f"{' and' if place else ''} is inverted" if self.inverted else ""
        return f"{self.source} {self.axis}{place}{sign}"


@dataclass(frozen=True, slots=True)
class AxisCheck:
    """Outcome of ``check_axes``: one finding per source and turn, and what could not be judged."""

    findings: tuple[AxisFinding, ...]
    unclear: tuple[str, ...]

    @property
    def faults(self) -> tuple[AxisFinding, ...]:
        return tuple(finding for finding in self.findings if not finding.as_expected)

    @property
    def verdict(self) -> str:
        """``as_expected``, ``wrong_axes`` or ``unclear``."""
        if self.faults:
            return "wrong_axes"
        return "unclear" if self.unclear else "as_expected"


def check_axes(samples: SampleBatch) -> AxisCheck:
    """Judge gyro, accelerometer and reported attitude of a hand-turned recording.

    Raises BadInputError where the recording is too short or has no gyro.
    """
    time = _usable_time(samples)
    gyro = samples.gyro.astype(np.float64)
    bias = rest_bias(time, gyro)
    gyro = gyro - (np.zeros(3) if bias is None else bias)
    force = samples.accelerometer.astype(np.float64) / STANDARD_GRAVITY
    findings: list[AxisFinding] = []
    unclear: list[str] = []
    # Left up shows as +y, nose down as -x of the specific force (thesis eq. 6.1-6.2).
    sources = {
        "gyro": np.cumsum(gyro * np.gradient(time)[:, None], axis=0),
        "accelerometer": np.column_stack([force[:, 1], -force[:, 0]]),
        "attitude": np.unwrap(samples.attitude.astype(np.float64), axis=0),
    }
    for source, signals in sources.items():
        if not np.isfinite(signals).all():
            unclear.append(f"{source}: not in this recording")
            continue
        found, doubt = _turns(source, time, _smooth(signals - signals[:50].mean(axis=0), time))
        findings += found
        unclear += doubt
    level = force[:50].mean(axis=0)
    if np.isfinite(level).all() and level[2] < 0.8:
        unclear.append(
            f"accelerometer: at rest it reads {level[0]:+.2f} {level[1]:+.2f} {level[2]:+.2f} g,"
            " not +1 g on z: lay the craft level to start with"
        )
    return AxisCheck(tuple(findings), tuple(unclear))


def _usable_time(samples: SampleBatch) -> Array:
    time = samples.time_s
    if len(samples) < 100 or time[-1] - time[0] < LEAST_SECONDS:
        raise BadInputError(
            f"axis check: {len(samples)} rows are too short; record all three turns"
            f" (at least {LEAST_SECONDS:.0f} s)"
        )
    if not np.isfinite(samples.gyro).all():
        raise BadInputError("axis check: the recording has no gyro; use one that has")
    return time - time[0]


def _turns(source: str, time: Array, signals: Array) -> tuple[list[AxisFinding], list[str]]:
    """Match a source's axes to the turns by when each moved most."""
    names = AXES[: signals.shape[1]]
    excursion = np.abs(signals).max(axis=0)
    still = [name for name, size in zip(names, excursion, strict=True) if size < LEAST_TURN]
    if still:
        return [], [f"{source}: hardly moved on {', '.join(still)}; turn it by 30 deg or more"]
    motion = np.square(np.gradient(signals, time, axis=0))
    motion /= motion.sum(axis=0)
    centre = motion.T @ time
    spread = np.sqrt((motion * np.square(time[:, None] - centre)).sum(axis=0))
    order = np.argsort(centre)
    for before, after in pairwise(order):
        if centre[after] - centre[before] < 0.5 * (spread[before] + spread[after]):
            return [], [
                f"{source}: {names[before]} and {names[after]} moved at the same time;"
                " turn about one axis after the other"
            ]
    findings = []
    for turn, column in enumerate(order):
        signal = signals[:, column]
        first = int(np.argmax(np.abs(signal) > 0.5 * excursion[column]))
        findings.append(AxisFinding(source, names[turn], names[column], bool(signal[first] < 0)))
    return findings, []


def _smooth(signals: Array, time: Array, window_s: float = 0.1) -> Array:
    """Moving average: vibration and quantisation are not turns."""
    width = max(1, round(window_s / float(np.median(np.diff(time)))))
    padded = np.pad(signals, ((width // 2, width - 1 - width // 2), (0, 0)), mode="edge")
    total = np.cumsum(np.vstack([np.zeros(signals.shape[1]), padded]), axis=0)
    return (total[width:] - total[:-width]) / width
