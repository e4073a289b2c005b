"""Batches of packets and samples, and the clock behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import (
    ACCELEROMETER_M_S2,
    ANGLE_RAD,
    BATTERY_V,
    DUTY,
    GYRO_RAD_S,
    SAMPLE_PERIOD_S,
    TICK_S,
    Packets,
    decode,
    motor_counts,
)

# Batches: raw packets as a link delivers them, and decoded samples as columns.


MOST_COUNTS = 2**31 - 1
"""Counts to which values are held that no sensor can measure, 1e30 for none say."""
OVERDRIVEN = 1.001
"""A duty beyond full by more than rounding."""


@dataclass(frozen=True, slots=True)
class RawBatch:
    """Packets as received, in order of arrival.

    packets: (n, 32) uint8.
    host_time_ns: (n,) int64, Unix time at which the host saw each packet: may be late
        (a blocked loop), never early.
    """

    packets: Packets
    host_time_ns: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.packets)

    @staticmethod
    def concatenate(batches: Sequence[RawBatch]) -> RawBatch:
        if not batches:
            return RawBatch(np.empty((0, 32), np.uint8), np.empty(0, np.int64))
        return RawBatch(
            np.concatenate([b.packets for b in batches]),
            np.concatenate([b.host_time_ns for b in batches]),
        )


@dataclass(frozen=True, slots=True)
class SampleBatch:
    """Decoded samples, one row each, without duplicates, in order of device time.

    Frames and signs as in the design: body FLU, roll left side up positive, pitch nose DOWN
    positive, yaw counter-clockwise positive. A channel the source does not have is NaN.

    ticks: (n,) int64, unwrapped device time in units of ``tick_s``.
    tick_s: seconds per tick (73/72 us for the telemetry packet, 1 us for microSD logs).
    host_time_ns: (n,) int64, Unix time of the earliest copy's arrival.
    segment: (n,) int32, counts restarts of the device; device time is continuous inside one.
    copies: (n,) uint8, how many agreeing copies arrived (saturates at 255).
    battery_v: (n,) float32.
    duty: (n, 4) float32, 0..1, the PWM that acted over the 2 ms before the gyro sample; where
        rows are slower, the mean of two such settings if the source has both.
    duty_step: (n, 4) float32, the second of these two settings less the first; NaN where ``duty``
        is no such mean.
    gyro: (n, 3) float32, rad/s.
    accelerometer: (n, 3) float32, specific force in m/s^2.
    attitude: (n, 3) float32, roll pitch yaw in rad.
    rotor_rev_s: (n, 4) float32, measured rotor speeds where the source has them.
    debug: (n,) uint32.
    """

    ticks: NDArray[np.int64]
    host_time_ns: NDArray[np.int64]
    segment: NDArray[np.int32]
    copies: NDArray[np.uint8]
    battery_v: NDArray[np.float32]
    duty: NDArray[np.float32]
    gyro: NDArray[np.float32]
    accelerometer: NDArray[np.float32]
    attitude: NDArray[np.float32]
    rotor_rev_s: NDArray[np.float32]
    debug: NDArray[np.uint32]
    duty_step: NDArray[np.float32]
    tick_s: float = TICK_S

    def __len__(self) -> int:
        return len(self.ticks)

    def __repr__(self) -> str:
        """How much there is of which channels; the numbers are in the columns."""
        if not len(self):
            return "SampleBatch(empty)"
        known = [name for name in _PHYSICAL if np.isfinite(getattr(self, name)).any()]
        step_s = float(np.median(np.diff(self.ticks))) * self.tick_s if len(self) > 1 else np.inf
        span_s = float(self.ticks[-1] - self.ticks[0]) * self.tick_s
        rate = f"{span_s:.2f} s at {1 / step_s:.0f} Hz" if step_s > 0 else f"{span_s:.2f} s"
        return f"SampleBatch({len(self)} rows, {rate}: {', '.join(known)})"

    def to_arrow(self) -> Any:
        """A ``pyarrow.Table`` of every column in SI, a vector's parts apart (``gyro_x``,
        ``duty_1``, ``attitude_roll``), with ``time_s``; ``to_arrow().to_pandas()`` makes a frame.
        """
        import pyarrow

        table: dict[str, NDArray[Any]] = {"time_s": self.time_s}
        for name in COLUMNS:
            values = getattr(self, name)
            parts = _PARTS.get(name)
            if parts is None:
                table[name] = values
            else:
                table |= {f"{name}_{part}": values[:, i] for i, part in enumerate(parts)}
        return pyarrow.table(table)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Device time in seconds, shape (n,)."""
        return self.ticks.astype(np.float64) * self.tick_s

    @property
    def overdriven(self) -> NDArray[np.bool_]:
        """Rows (n,) with a motor beyond full duty, which none can be: nothing was received there.

        Who joins the topics of a flight on one clock may extrapolate those that ended first.
        """
        return np.asarray((self.duty > OVERDRIVEN).any(axis=1))

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> SampleBatch:
        """The chosen rows as a new batch."""
        return replace(self, **{name: getattr(self, name)[rows] for name in COLUMNS})

    @staticmethod
    def concatenate(batches: Sequence[SampleBatch]) -> SampleBatch:
        """Join batches that share ``tick_s``; an empty sequence gives an empty batch."""
        if not batches:
            return empty_samples(0)
        if len({batch.tick_s for batch in batches}) > 1:
            raise ValueError("sample batches with different tick lengths cannot be joined")
        columns = {
            name: np.concatenate([getattr(batch, name) for batch in batches]) for name in COLUMNS
        }
        return SampleBatch(**columns, tick_s=batches[0].tick_s)


COLUMNS: tuple[str, ...] = tuple(f.name for f in fields(SampleBatch) if f.name != "tick_s")
"""Names of the per-row arrays of a ``SampleBatch``."""

_PARTS: dict[str, Sequence[str]] = {
    "duty": "1234",
    "gyro": "xyz",
    "accelerometer": "xyz",
    "attitude": ("roll", "pitch", "yaw"),
    "rotor_rev_s": "1234",
    "duty_step": "1234",
}
_PHYSICAL = ("battery_v", *_PARTS)
_INTEGER_TYPES: dict[str, type[np.generic]] = {
    "ticks": np.int64,
    "host_time_ns": np.int64,
    "segment": np.int32,
    "copies": np.uint8,
    "debug": np.uint32,
}


def empty_samples(rows: int, tick_s: float = TICK_S) -> SampleBatch:
    """A batch of ``rows`` rows: integers 0, copies 1, every physical channel NaN."""
    columns: dict[str, NDArray[Any]] = {}
    for name in COLUMNS:
        if name in _INTEGER_TYPES:
            columns[name] = np.zeros(rows, _INTEGER_TYPES[name])
        else:
            shape = (rows, len(_PARTS[name])) if name in _PARTS else (rows,)
            columns[name] = np.full(shape, np.nan, np.float32)
    columns["copies"][:] = 1
    return SampleBatch(**columns, tick_s=tick_s)


def samples_from_packets(
    packets: Packets,
    ticks: NDArray[np.int64],
    host_time_ns: NDArray[np.int64],
    segment: NDArray[np.int32],
    copies: NDArray[np.uint8],
) -> SampleBatch:
    """Decode (n, 32) deduplicated packets into physical units."""
    records = decode(packets)
    attitude = records["angles"] * np.float32(ANGLE_RAD)
    attitude[:, 1] *= -1  # the firmware's pitch is nose up positive
    return SampleBatch(
        ticks=ticks,
        host_time_ns=host_time_ns,
        segment=segment,
        copies=copies,
        battery_v=records["battery"] * np.float32(BATTERY_V),
        duty=motor_counts(records) * np.float32(DUTY),
        gyro=records["gyro"] * np.float32(GYRO_RAD_S),
        accelerometer=records["accelerometer"] * np.float32(ACCELEROMETER_M_S2),
        attitude=attitude,
        rotor_rev_s=np.full((len(records), 4), np.nan, np.float32),
        debug=records["debug"].astype(np.uint32),
        duty_step=np.full((len(records), 4), np.nan, np.float32),
    )


def packet_counts(samples: SampleBatch) -> dict[str, NDArray[np.int64]]:
    """The packet's integers behind ``samples``: the inverse of ``samples_from_packets``.

    Keys: timestamp (unwrapped), battery, motors, gyro, accelerometer, angles (pitch in the
    packet's nose-up convention), debug. Exact for samples that came from packets. A channel
    without data (NaN) gives 0, a value beyond 32 bits their limit.
    """
    angles = _counts(samples.attitude, ANGLE_RAD)
    angles[:, 1] *= -1
    return {
        "timestamp": samples.ticks.astype(np.int64),
        "battery": _counts(samples.battery_v, BATTERY_V),
        "motors": _counts(samples.duty, DUTY),
        "gyro": _counts(samples.gyro, GYRO_RAD_S),
        "accelerometer": _counts(samples.accelerometer, ACCELEROMETER_M_S2),
        "angles": angles,
        "debug": samples.debug.astype(np.int64),
    }


def _counts(values: NDArray[np.float32], unit: float) -> NDArray[np.int64]:
    scaled = np.nan_to_num(values.astype(np.float64) / unit, nan=0.0)
    return np.rint(scaled.clip(-MOST_COUNTS, MOST_COUNTS)).astype(np.int64)


# Samples by a mask: blocks of consecutive ones, and values where samples are missing.


def spans(mask: ArrayLike) -> list[tuple[int, int]]:
    """(first, last) of each block of consecutive true samples; ``last`` is not in it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(mask, np.int8), [0]])))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def filled(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """NaN samples on the straight line between their neighbours; all NaN stays NaN."""
    flat = values.reshape(len(values), -1)
    out = flat.copy()
    rows = np.arange(len(flat), dtype=np.float64)
    for column in range(flat.shape[1]):
        known = np.isfinite(flat[:, column])
        if known.any() and not known.all():
            out[:, column] = np.interp(rows, rows[known], flat[known, column])
    return out.reshape(values.shape)


# What a craft logs besides its telemetry: series of their own, at moments of their own.


@dataclass(frozen=True, slots=True)
class LogTable:
    """Some rows of one table.

    host_time_ns: (n,) int64, Unix time at which each came. time_s: (n,) float64 on the device's
    clock. columns: name -> (n,) float64, in the firmware's own unit.
    """

    name: str
    host_time_ns: NDArray[np.int64]
    time_s: NDArray[np.float64]
    columns: dict[str, NDArray[np.float64]]


# The clock behind a recording's samples: its period, what is missing, and whose clock it is.
#
# A craft stamps a sample when it measures it: steps are whole periods, and a longer step is a
# loss. A host stamps it when it came. Late samples make long steps and short ones behind them,
# and none is missing as long as the stamps come back to the line that the earliest of them lie
# on.


PERIOD_TOLERANCE, SINGLE_STEPS = 0.05, 0.02
"""How far a step of the telemetry may be from 2 ms, and which share of such steps tells it."""
UNEVEN, UNEVEN_SHARE = 0.2, 0.1
"""Share of a period by which a step misses whole periods, and share of such steps, from which the
stamps are a host's."""
CATCHES_UP = -0.1
"""Correlation of neighbouring steps below which late stamps are caught up: independent delays give
-0.5, a craft that samples unevenly 0."""
ENVELOPE_ROWS = 25
"""Samples before and behind a long step of which the earliest tell whether one is missing."""
BURST, SCATTER = 1.5, 0.15
"""Mean step over the median one from which samples come in bursts, and scatter of the steps over
the median one from which that is no period."""
COARSE = 5.0
"""A clock's unit is coarse where so many are more than a period."""
LATEST_ROWS = 4
"""Behind a long step so near the end nothing tells yet whether it is caught up."""
MISSED = 0.6
"""Share of a period by which the earliest stamps behind a long step are later than those before it
where a sample is missing."""
LEAST_ROWS = 50


@dataclass(frozen=True, slots=True)
class RowSteps:
    """From each sample to the next inside a segment.

    rows: (m,) index of the first sample. step_s: (m,). lost: (m,) samples missing between.
    period_s: the usual step, 0 where there is none. by_host: whether the stamps are a host's.
    uneven: whether they say only roughly when a sample was taken: a host's, or a coarse clock's.
    """

    rows: NDArray[np.intp]
    step_s: Array
    lost: NDArray[np.int64]
    period_s: float
    by_host: bool
    uneven: bool


def row_steps(samples: SampleBatch) -> RowSteps:
    """The steps of a recording and what is missing in them."""
    rows = np.flatnonzero(np.diff(samples.segment) == 0)
    step_s = np.diff(samples.ticks)[rows].astype(np.float64) * samples.tick_s
    moving = step_s[step_s > 0]
    period_s = float(np.median(moving)) if len(moving) else 0.0
    if samples.tick_s == TICK_S:
        # Half of the steps may be gaps: a few single steps tell the telemetry's period.
        single = np.abs(moving / SAMPLE_PERIOD_S - 1) < PERIOD_TOLERANCE
        if len(moving) == 0 or single.mean() > SINGLE_STEPS:
            period_s = SAMPLE_PERIOD_S
    lost = np.zeros(len(rows), np.int64)
    readings, periods = set(), []
    for own in np.unique(samples.segment[rows]):  # a radio may have gone on more slowly
        part = slice(*np.searchsorted(samples.segment[rows], [own, own + 1]))
        step = step_s[part]
        period = period_s
        reading = "exact"
        if samples.tick_s != TICK_S and (step > 0).any():
            period = float(np.median(step[step > 0]))
            reading = _reading(step, period, samples.tick_s)
        if reading != "exact":
            lost[part], period = _lost_by_count(step, period, reading == "coarse")
        elif period > 0:
            lost[part] = np.where(step > 1.5 * period, np.rint(step / period) - 1, 0)
        readings.add(reading)
        periods.append((len(step), period))
    if readings - {"exact"}:
        period_s = max(periods)[1]
    return RowSteps(rows, step_s, lost, period_s, "host" in readings, bool(readings - {"exact"}))


def on_even_grid(samples: SampleBatch) -> SampleBatch:
    """Samples with uneven stamps on the even grid on which their craft took them, none later than
    its stamp; what is missing stays missing. Others as they are."""
    steps = row_steps(samples)
    if not steps.uneven:
        return samples
    ticks = samples.ticks.copy()
    for own in np.unique(samples.segment):
        first, last = np.searchsorted(samples.segment, [own, own + 1])
        if last - first < LEAST_ROWS:
            continue
        inside = slice(*np.searchsorted(steps.rows, [first, last - 1]))
        step, lost = steps.step_s[inside], steps.lost[inside]
        place = np.concatenate([[0], np.cumsum(1 + lost)]).astype(np.float64)
        stamps = np.concatenate([[0.0], np.cumsum(step)])
        period = _slope(place, stamps)
        start = float((stamps - place * period).min())
        ticks[first:last] = ticks[first] + np.rint((start + place * period) / samples.tick_s)
    return replace(samples, ticks=ticks)


def _reading(step: Array, period: float, tick_s: float) -> str:
    """How steps (m,) of a clock are to be read: ``exact``, ``coarse`` where they are few units of
    the clock, or ``host``."""
    step = step[: 1 << 16]
    if len(step) < LEAST_ROWS or np.abs(step / period - 1).mean() < 0.02:
        return "exact"
    usual = np.clip(step, 0.0, 5.0 * np.mean(step))
    usual = usual - usual.mean()
    if not float(usual[1:] @ usual[:-1]) < CATCHES_UP * float(usual @ usual):
        return "exact"
    resolution = int(np.gcd.reduce(np.rint(step / tick_s).astype(np.int64))) * tick_s
    off = np.abs(step - np.rint(step / period) * period)
    if (off > max(UNEVEN * period, 1.01 * resolution)).mean() > UNEVEN_SHARE:
        return "host"
    if COARSE * resolution > step.mean():
        return "coarse"
    return "host" if step.mean() > BURST * period else "exact"


def _lost_by_count(step: Array, period: float, coarse: bool) -> tuple[NDArray[np.int64], float]:
    """Samples missing in each step of uneven stamps, and the period that their count gives."""
    from scipy.ndimage import minimum_filter1d

    scatter = float(np.median(np.abs(step - period)))
    if coarse or scatter > SCATTER * period or float(step.mean()) > BURST * period:
        period = _mean_step(step)
    stamps = np.concatenate([[0.0], np.cumsum(step)])
    late = stamps - period * np.arange(len(stamps))
    width = ENVELOPE_ROWS
    behind = minimum_filter1d(late, width, origin=-(width // 2), mode="nearest")
    before = minimum_filter1d(late, width, origin=width // 2, mode="nearest")
    lost = np.zeros(len(step), np.int64)
    last = 0
    for k in np.flatnonzero((step > 1.5 * period) & (behind[1:] - before[:-1] > MISSED * period)):
        earliest = late[max(last, int(k) - width + 1) : int(k) + 1].min()
        missing = int(float(behind[k + 1] - earliest) / period + 1.0 - MISSED)
        if missing > (0 if len(step) - k > LATEST_ROWS else LATEST_ROWS):
            lost[k], last = missing, int(k) + 1
    place = np.concatenate([[0], np.cumsum(1 + lost)]).astype(np.float64)
    return lost, _slope(place, stamps)


def _mean_step(step: Array) -> float:
    """A low one of the mean steps over many samples: bursts even out, and losses lengthen some."""
    stamps = np.concatenate([[0.0], np.cumsum(step)])
    width = min(len(step), 4 * ENVELOPE_ROWS)
    return float(np.quantile(stamps[width:] - stamps[:-width], 0.3)) / width


def _slope(place: Array, stamps: Array) -> float:
    """Period of the line below stamps: through the earliest of each block of samples."""
    blocks = np.array_split(np.arange(len(place)), max(2, min(50, len(place) // ENVELOPE_ROWS)))
    rough = float((stamps[-1] - stamps[0]) / max(place[-1] - place[0], 1.0))
    lowest = np.array([block[np.argmin((stamps - rough * place)[block])] for block in blocks])
    x, y = place[lowest], stamps[lowest]
    x = x - x.mean()
    return float(x @ y / (x @ x))


# How often a channel really changes.
#
# A logger that joins sources of several rates repeats the last value of the slower ones. Rows then
# promise more than was measured: the motors of a log may be renewed in one row of five.


FIELDS = ("battery_v", "duty", "gyro", "accelerometer", "attitude", "rotor_rev_s")
PAUSE = 4.0
"""Times the usual distance between two changes from which a channel rests and is not slow."""
LEAST_CHANGES = 8
SETTINGS_HZ = 400.0
"""Below it a channel that is renewed more slowly than its rows lacks something: controllers set the
motors 500 times a second."""
TOGETHER = 16
"""Neighbouring distances of changes taken as one: a clock keeps their sum, whatever its ratio to
the rows; where values change by chance, those of quantised settings in quiet air, it scatters."""
EVEN, EVEN_SHARE = 0.25, 0.6
"""Share of a hold by which distances and their sums may differ, and share of them that do not."""
HELD = 1.5
"""Mean rows that a value stands from which the rows are faster than the channel."""


def renewals(values: NDArray[Any]) -> NDArray[np.intp]:
    """Rows at which a channel (n,) or (n, k) has another value than at the last row that has one,
    the first of them included."""
    known = np.isfinite(values)
    there = known if values.ndim == 1 else known.all(axis=1)
    if there.all():
        changed = values[1:] != values[:-1]
        rows = np.flatnonzero(changed if values.ndim == 1 else changed.any(axis=1)) + 1
        return np.concatenate([[0], rows]).astype(np.intp)
    place = np.flatnonzero(there)
    if not len(place):
        return place
    return place[renewals(values[place])]


def rows_held(rows: NDArray[np.intp]) -> float:
    """Mean distance of neighbouring ``renewals`` in rows, rests left out: 1 for a channel that is
    new in every row, NaN where too few tell."""
    apart = np.diff(rows)
    if len(apart) < LEAST_CHANGES:
        return float("nan")
    return float(apart[apart <= PAUSE * np.median(apart)].mean())


def slower_than_rows(rows: NDArray[np.intp]) -> float:
    """The same where a source is slower than the rows that repeat it, else 1: then its values stand
    for nearly equal numbers of rows; what changes now and then does not."""
    apart = np.diff(rows)
    hold = rows_held(rows)
    if not hold > HELD or np.median(apart) < 2.0:
        return 1.0  # in most places new in every row
    for count in (1, min(TOGETHER, len(apart) // 2)):
        together = np.convolve(apart, np.ones(count), "valid")
        even = np.abs(together - np.median(together)) <= max(1.0, EVEN * hold)
        if even.mean() <= EVEN_SHARE:
            return 1.0
    return hold
