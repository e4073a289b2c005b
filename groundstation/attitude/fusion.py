"""Attitude from inertial sensors (thesis chapter 6): each sensor alone, filters, a check of
the axes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from groundstation.errors import BadInputError
from groundstation.report.page import MEASURED, SERIES, Page, figure, legend_above, thinned
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# What each inertial sensor says about attitude by itself (thesis 6.1).


REST_RATE = np.radians(3.0)
"""A craft whose rate varies by less than this (rad/s, standard deviation) lies still."""


def accelerometer_attitude(accelerometer: ArrayLike) -> Array:
    """Roll and pitch in rad from specific force (thesis eq. 6.1-6.2), (..., 3) to (..., 2).

    Any unit. True only where nothing but gravity acts: in the hand, not in flight. The roll uses
    the quadrant of a_z, so an upside-down craft is told from an upright one.
    """
    force = np.asarray(accelerometer, np.float64)
    x, y, z = force[..., 0], force[..., 1], force[..., 2]
    return np.stack([np.arctan2(y, z), np.arctan2(-x, np.hypot(y, z))], axis=-1)


def integrate_gyroscope(
    time_s: ArrayLike, gyro: ArrayLike, initial: ArrayLike = (0.0, 0.0, 0.0)
) -> Array:
    """Attitude (n, 3) in rad by integrating Euler rates (thesis eq. 6.3-6.6).

    time_s: (n,). gyro: (n, 3) rad/s; a rate counts from the sample before to its own, as the
    firmware takes it. initial: roll, pitch, yaw of the first row. Offsets of the gyro grow into
    the angles without bound: that is what the filters are for.
    """
    from groundstation.attitude.kernels import integrate

    time, rates = _columns(time_s, gyro)
    angles = np.empty((len(time), 3))
    integrate(time, rates, np.asarray(initial, np.float64), angles)
    return angles


def rest_bias(time_s: ArrayLike, gyro: ArrayLike, least_s: float = 0.5) -> Array | None:
    """Mean rate (3,) in rad/s while the craft lies still at the start, None where it never does.

    Looks at quarter-second pieces and stops at the first that moves; needs ``least_s``.
    """
    time, rates = _columns(time_s, gyro)
    end, step = 0, 0.25
    while True:
        last = int(np.searchsorted(time, time[0] + (end + 1) * step))
        first = int(np.searchsorted(time, time[0] + end * step))
        if last >= len(time) or last - first < 3:
            break
        if rates[first:last].std(axis=0).max() > REST_RATE:
            break
        # A slow steady turn is no rest: the mean must not wander from piece to piece.
        if np.abs(rates[first:last].mean(axis=0) - rates[:last].mean(axis=0)).max() > REST_RATE:
            break
        end += 1
    rows = int(np.searchsorted(time, time[0] + end * step))
    return rates[:rows].mean(axis=0) if end * step >= least_s else None


def _columns(time_s: ArrayLike, gyro: ArrayLike) -> tuple[Array, Array]:
    time = np.ascontiguousarray(time_s, np.float64)
    rates = np.ascontiguousarray(gyro, np.float64)
    if time.ndim != 1 or rates.shape != (len(time), 3) or len(time) < 2:
        raise ValueError(f"time {time.shape} and gyro {rates.shape}: need (n,) and (n, 3), n >= 2")
    return time, rates


# Sensor fusion: complementary and Kalman filter (thesis 6.2). Roll and pitch are referred to
# the earth by the accelerometer, yaw is relative to the start and drifts with the gyro's offset.


START_ROWS = 25
"""The first attitude is the accelerometer's mean over so many rows (50 ms)."""


@dataclass(frozen=True, slots=True)
class KalmanNoise:
    """Noise of the Kalman filter (thesis eq. 6.21; there without units).

    angle, bias: the diagonal of Q, added at every step, deg^2 and (deg/s)^2.
    accelerometer: R, deg^2.

    The estimate depends on the ratios to R only, so with all three in rad it is the same.
    The thesis's values belong to steps of 2 ms.
    """

    angle: float = 0.001
    bias: float = 0.001
    accelerometer: float = 5.0


@dataclass(frozen=True, slots=True)
class KalmanEstimate:
    """attitude: (n, 3) roll, pitch, yaw in rad. bias: (n, 3) offsets of the Euler rates, rad/s."""

    attitude: Array
    bias: Array


def complementary(
    time_s: ArrayLike, gyro: ArrayLike, accelerometer: ArrayLike, weight: float = 0.998
) -> Array:
    """Attitude (n, 3) in rad by the complementary filter (thesis eq. 6.7-6.10).

    time_s: (n,). gyro: (n, 3) rad/s. accelerometer: (n, 3), any unit. weight: W, 0..1, of the
    gyro; with steps of 2 ms the default trusts the accelerometer over about a second.

    Raises ValueError for a weight outside 0..1 and for shapes that do not fit.
    """
    from groundstation.attitude.kernels import complement

    if not 0.0 <= weight <= 1.0:
        raise ValueError(f"weight {weight} is outside 0..1")
    time, rates, tilt = _inputs(time_s, gyro, accelerometer)
    angles = np.empty((len(time), 3))
    complement(time, rates, tilt, _start(accelerometer), weight, angles)
    return angles


def kalman(
    time_s: ArrayLike,
    gyro: ArrayLike,
    accelerometer: ArrayLike,
    noise: KalmanNoise | None = None,
) -> KalmanEstimate:
    """Attitude and gyro offsets by one two-state Kalman filter per axis (eq. 6.11-6.20).

    The input is the Euler rate from the gyro (6.3), the measurement the accelerometer's angle.
    Yaw has no measurement: its bias stays zero, and an offset of the gyro drifts into it. Subtract
    ``rest_bias`` from the gyro where the recording starts at rest.

    time_s: (n,). gyro: (n, 3) rad/s. accelerometer: (n, 3), any unit.
    """
    from groundstation.attitude.kernels import kalman_axes

    chosen = noise or KalmanNoise()
    time, rates, tilt = _inputs(time_s, gyro, accelerometer)
    attitude, bias = np.empty((len(time), 3)), np.empty((len(time), 3))
    # One scale for all: radians inside, ratios as given.
    unit = np.radians(1.0) ** 2
    kalman_axes(
        time,
        rates,
        tilt,
        _start(accelerometer),
        chosen.angle * unit,
        chosen.bias * unit,
        chosen.accelerometer * unit,
        attitude,
        bias,
    )
    return KalmanEstimate(attitude, bias)


def _inputs(
    time_s: ArrayLike, gyro: ArrayLike, accelerometer: ArrayLike
) -> tuple[Array, Array, Array]:
    time = np.ascontiguousarray(time_s, np.float64)
    rates = np.ascontiguousarray(gyro, np.float64)
    force = np.asarray(accelerometer, np.float64)
    if time.ndim != 1 or rates.shape != (len(time), 3) or force.shape != rates.shape:
        raise ValueError(
            f"time {time.shape}, gyro {rates.shape}, accelerometer {force.shape}:"
            " need (n,), (n, 3), (n, 3)"
        )
    if len(time) < 2:
        raise ValueError("sensor fusion needs at least two rows")
    return time, rates, np.ascontiguousarray(accelerometer_attitude(force))


def _start(accelerometer: ArrayLike) -> Array:
    """Eq. 6.7, from the mean force so that noise and the wrap of roll do not matter."""
    force = np.asarray(accelerometer, np.float64)[:START_ROWS].mean(axis=0)
    return np.array([*accelerometer_attitude(force), 0.0])


# One recording through every way to an attitude, beside the reported one (thesis 6.2).


LEAST_ROWS = 100
END_SHARE, END_ROWS = 20, 500
"""Start and end are those of lines through a twentieth of the recording, a second at most."""


@dataclass(frozen=True, slots=True)
class Fused:
    """Angles by method, (n, 3) roll, pitch, yaw in rad; ``accelerometer`` has no yaw (NaN).

    time_s: (n,). rest_bias: (3,) rad/s, or None where the recording does not begin at rest.
    """

    time_s: Array
    angles: dict[str, Array]
    rest_bias: Array | None
    weight: float
    noise: KalmanNoise

    def moved_deg(self) -> dict[str, list[float]]:
        """End minus start, by method, of the rows that have angles."""
        return {
            name: [float(np.degrees(_moved(axis[np.isfinite(axis)]))) for axis in angles.T]
            for name, angles in self.angles.items()
        }


def _moved(angle: Array) -> float:
    """The last less the first of (n,), both by straight lines through what is around them."""
    ends = max(1, min(len(angle) // END_SHARE, END_ROWS))
    return _at_start(angle[::-1][:ends]) - _at_start(angle[:ends])


def _at_start(values: Array) -> float:
    """The line through values (n,) at the first of them; NaN without any."""
    if len(values) < 3:
        return float(values[0]) if len(values) else np.nan
    _, start = np.polyfit(np.arange(len(values)), values, 1)
    return float(start)


def _unwrapped(attitude: Array) -> Array:
    """Angles (n, 3) without jumps of a turn, across rows that have none as well."""
    out = attitude.copy()
    known = np.isfinite(attitude).all(axis=1)
    out[known] = np.unwrap(attitude[known], axis=0)
    return out


def fuse(samples: SampleBatch, weight: float = 0.998, noise: KalmanNoise | None = None) -> Fused:
    """Integration, accelerometer, complementary filter (W), Kalman filter (Q, R).

    Raises BadInputError for too few rows with gyro and accelerometer, and a weight outside 0..1.
    """
    if not 0.0 <= weight <= 1.0:
        raise BadInputError(f"weight {weight:g}: must be 0..1")
    inertial = np.hstack([samples.gyro, samples.accelerometer])
    samples = samples[np.flatnonzero(np.isfinite(inertial).all(axis=1))]
    if len(samples) < LEAST_ROWS:
        raise BadInputError("too few rows with gyro and accelerometer")
    time, force = samples.time_s, samples.accelerometer
    bias = rest_bias(time, samples.gyro)
    gyro = samples.gyro - (np.zeros(3) if bias is None else bias)
    chosen = noise or KalmanNoise()
    tilt = accelerometer_attitude(force)
    angles = {
        "integrated": integrate_gyroscope(time, samples.gyro),
        "accelerometer": np.column_stack([tilt, np.full(len(tilt), np.nan)]),
        "complementary": complementary(time, samples.gyro, force, weight),
        "kalman": kalman(time, gyro, force, chosen).attitude,
        "reported": _unwrapped(samples.attitude.astype(np.float64)),
    }
    return Fused(time, angles, bias, weight, chosen)


# A page on sensor fusion: drift, filters, and what the craft reports (thesis Figures 6.3, 6.5).


COLOURS = dict(
    zip(("integrated", "complementary", "kalman", "accelerometer"), SERIES, strict=False)
) | {"reported": MEASURED}
FILTERS = ("complementary", "kalman")


def fusion_page(fused: Fused, name: str) -> Page:
    """name: of the recording."""
    noise = fused.noise
    page = Page(
        f"Attitude of {name}",
        f"{len(fused.time_s)} rows; W = {fused.weight:g}; Q = ({noise.angle:.3g} deg^2,"
        f" {noise.bias:.3g} (deg/s)^2), R = {noise.accelerometer:.3g} deg^2",
    )
    at_rest = (
        "the recording does not begin at rest, so nothing was subtracted from the gyro"
        if fused.rest_bias is None
        else "at rest the gyro reads "
        + ", ".join(f"{value:.2f}" for value in np.degrees(fused.rest_bias))
        + " deg/s, which was subtracted from the Kalman filter's input"
    )
    page.text(
        "Turned by hand and put back, each angle should end where it began. Integration drifts with"
        f" the gyro's offset; {at_rest}. Yaw has no reference on any of these ways. In flight the"
        " accelerometer feels thrust instead of gravity: its angles then say nothing."
    )
    page.table(
        ["end minus start, deg", *AXES],
        [
            [method, *(None if np.isnan(value) else value for value in values)]
            for method, values in fused.moved_deg().items()
        ],
    )
    page.heading("Drift")
    page.figure(
        angles_figure(fused, ("integrated", "reported")),
        "The gyro integrated from the first row on, beside the reported angles.",
    )
    page.heading("Filters")
    page.figure(
        angles_figure(fused, ("accelerometer", *FILTERS, "reported")),
        "The accelerometer's angle, what the two filters make of it and of the gyro, and what the"
        " craft reports.",
    )
    page.heading("Filters less reported")
    page.figure(_differences(fused), "The same two filters, less the reported angle.")
    return page


def angles_figure(fused: Fused, methods: tuple[str, ...]) -> Figure:
    """Angles by method in deg, one panel an axis."""
    more: dict[str, dict[str, Any]] = {
        "accelerometer": {"linewidth": 0.5, "alpha": 0.5},
        "reported": {"linestyle": "--"},
    }
    lines: dict[str, Line] = {
        method: (fused.angles[method], {"color": COLOURS[method], **more.get(method, {})})
        for method in methods
    }
    return _panels(fused.time_s, lines, 6.0)


def _differences(fused: Fused) -> Figure:
    reported = fused.angles["reported"]
    lines: dict[str, Line] = {
        method: (fused.angles[method] - reported, {"color": COLOURS[method]}) for method in FILTERS
    }
    return _panels(fused.time_s, lines, 5.0)


Line = tuple[Array, dict[str, Any]]
"""Angles (n, 3) in rad and how they are drawn."""


def _panels(time_s: Array, lines: Mapping[str, Line], height: float) -> Figure:
    """Angles by name in deg, one panel an axis; none where there are none."""
    made, every = figure(height=height, rows=3, sharex=True)
    for i, (axes, axis) in enumerate(zip(every, AXES, strict=True)):
        for name, (angles, style) in lines.items():
            if np.isfinite(angles[:, i]).any():
                axes.plot(*thinned(time_s, np.degrees(angles[:, i])), label=name, **style)
        axes.set_ylabel(f"{axis}, deg")
    if every[0].lines:
        legend_above(every[0])
    every[-1].set_xlabel("time, s")
    return made


# Are the axes what they should be? (thesis 6.3)
#
# The craft is turned by hand about roll (left up first), then pitch (nose down first), then yaw
# (counter-clockwise first), each there and back. Every source of attitude must show the three turns
# on its own three axes, in this order and with these signs. Which of its axes a source shows a turn
# on follows from when each axis moves; so an axis that is inverted, or swapped with another, is
# named for each source by itself.


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
    time = samples.time_s
    if len(samples) < 100 or time[-1] - time[0] < LEAST_SECONDS:
        raise BadInputError(
            f"axis check: {len(samples)} rows are too short; record all three turns"
            f" (at least {LEAST_SECONDS:.0f} s)"
        )
    if not np.isfinite(samples.gyro).all():
        raise BadInputError("axis check: the recording has no gyro; use one that has")
    time, gyro = time - time[0], samples.gyro.astype(np.float64)
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


# A page on an axis check: the three turns as each source shows them (thesis Figures 6.4, 6.5).


def axis_page(samples: SampleBatch, check: AxisCheck, apart: list[str], name: str) -> Page:
    """apart: what is measured twice and does not agree, in lines. name: of the recording."""
    page = Page(f"Axes of {name}", f"{len(samples)} rows")
    kind = {"as_expected": "good", "wrong_axes": "bad"}.get(check.verdict, "neutral")
    page.verdict(check.verdict.replace("_", " ").capitalize() + ".", kind)
    page.bullets([*map(str, check.findings), *check.unclear, *apart])
    page.heading("The turns")
    page.figure(
        axis_figure(samples),
        "Left up, nose down, counter-clockwise, each there and back, must show first upwards and on"
        " its own panel, whatever shows it.",
    )
    return page


def axis_figure(samples: SampleBatch) -> Figure:
    """Each axis by the gyro's integral, by gravity, and as reported, in deg."""
    tilt = accelerometer_attitude(samples.accelerometer)
    shown = {
        "gyro, integrated": integrate_gyroscope(samples.time_s, samples.gyro),
        "accelerometer": np.column_stack([tilt, np.full(len(tilt), np.nan)]),
        "reported": np.unwrap(samples.attitude.astype(np.float64), axis=0),
    }
    lines: dict[str, Line] = {
        name: (angles - angles[:50].mean(axis=0), {"color": color, "linestyle": style})
        for (name, angles), color, style in zip(
            shown.items(), (*SERIES[:2], MEASURED), ("-", "-", "--"), strict=True
        )
    }
    return _panels(samples.time_s - samples.time_s[0], lines, 5.0)
