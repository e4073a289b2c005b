"""Numbers that are no measurement: what a program writes where it has none, and an attitude that
stands while the craft turns."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from groundstation.recording.channels import CHANNELS, Channel
from groundstation.recording.plausibility import KINDS
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import SampleBatch, spans

Mask = NDArray[np.bool_]

FAR = {
    **{"gyro": 200.0, "attitude": 180.0, "accelerometer": 4.0, "battery_v": 10.0, "duty": 3.0},
    "rotor_rev_s": 20_000.0,
}
"""Fields in which one value is looked for that stands for none, and how far from all others, in the
shown unit, it is at least: further than a flight jumps without a value between."""
APART, PLACES, ROWS = 2.0, 3, 10
"""Times the range of all other values that it is away from them, and how many separate places or
how many rows have it: -999, 65535, 1e30. A peak or a blow has neighbours, and neither stays nor
comes back to the last digit."""
LEAST_DUTY = -1.5e-5
"""A count of -1 is below nothing, whatever the counts of the duty go to."""
KINDS_OF_IT = 3
"""As many such values of a channel are looked for."""
TURNS_RAD_S, SMOOTH_S, STANDS_S = np.radians(5.0), 0.1, 2.0
"""An attitude that stands for so long is none where the gyro, averaged over that short a while as
rotors shake it, turns by more (root mean square)."""


def sentinels(samples: SampleBatch, field: str) -> Iterator[tuple[Mask, str]]:
    """Rows (n,) of a field with one exact value, far from all others, and words."""
    if field not in FAR:
        return
    for channel in CHANNELS:
        if channel.field == field and channel.is_in(samples):
            values = channel.of(samples).astype(np.float64)
            for _ in range(KINDS_OF_IT):
                rows = _sentinel(values, FAR[field] / channel.scale, _bounds(channel))
                if rows is None:
                    break
                yield rows, _words(channel, float(values[rows][0]), rows)
                values = np.where(rows, np.nan, values)


def _words(channel: Channel, value: float, rows: Mask) -> str:
    shown = f"{value * channel.scale:.6g} {channel.unit}"
    shown = shown.removesuffix(" 1")
    return (
        f"{channel.name} is exactly {shown} in {int(rows.sum())} of {len(rows)} samples, far from"
        " all others: it stands for no value"
    )


def _bounds(channel: Channel) -> tuple[float, float]:
    """Between which a channel is, in the samples' own unit."""
    kind = KINDS[channel.field]
    if channel.name == "yaw":  # counts turns
        return -np.inf, np.inf
    low = LEAST_DUTY if channel.field == "duty" else kind.low
    return low / channel.scale, kind.high / channel.scale


def _sentinel(values: Array, far: float, bounds: tuple[float, float]) -> Mask | None:
    """Rows of the least or largest value, where it is one that stands for none. bounds: between
    which a measurement is; one beyond them is none, however near."""
    known = np.isfinite(values)
    if not known.any():
        return None
    for value in (float(values[known].min()), float(values[known].max())):
        rows = values == value
        rest = values[known & ~rows]
        if not len(rest):
            return None
        away = float(np.abs(rest - value).min())
        places = int(np.count_nonzero(rows[1:] & ~rows[:-1])) + int(rows[0])
        often = places >= PLACES or np.count_nonzero(rows) >= ROWS
        low, high = bounds
        never = value < low <= float(rest.min()) or value > high >= float(rest.max())
        if often and (never or away > max(far, APART * float(np.ptp(rest)))):
            return np.asarray(rows)
    return None


def standing(samples: SampleBatch) -> tuple[Mask, str] | None:
    """Where (n, 3) an attitude stands while the gyro turns, and words: one angle throughout, or all
    of them for seconds."""
    attitude, gyro = samples.attitude, samples.gyro.astype(np.float64)
    if len(samples) < 3 or not np.isfinite(attitude).any() or not np.isfinite(gyro).any():
        return None
    time_s = samples.time_s
    period_s = float(np.median(np.diff(time_s)))
    if not period_s > 0.0:
        return None
    width = max(1, round(SMOOTH_S / period_s))
    middle = [np.nanmedian(one) if np.isfinite(one).any() else 0.0 for one in gyro.T]
    smooth = _means(np.nan_to_num(gyro - middle), width)
    rows: Mask = np.zeros(attitude.shape, np.bool_)
    least = round(STANDS_S / period_s)
    for axis in range(3):
        known = np.isfinite(attitude[:, axis])
        angles = attitude[known, axis]
        if known.sum() > least and np.ptp(angles) == 0.0:
            rows[:, axis] = known & (np.sqrt(np.mean(smooth[known, axis] ** 2)) > TURNS_RAD_S)
    names = [name for k, name in enumerate(("roll", "pitch", "yaw")) if rows[:, k].any()]
    if names:
        which = "the attitude" if len(names) == 3 else ", ".join(names)
        return rows, f"{which} never changes while the gyro turns: no measurement"
    same = np.zeros(len(rows), np.bool_)
    same[1:] = (attitude[1:] == attitude[:-1]).all(axis=1)
    longest = 0.0
    for first, last in spans(same):
        span_s = float(time_s[last - 1] - time_s[first])
        turned = float(np.sqrt(np.mean(smooth[first:last] ** 2, axis=0)).max())
        if last - first > least and span_s >= STANDS_S and turned > TURNS_RAD_S:
            rows[first:last] = True
            longest = max(longest, span_s)
    if not longest:
        return None
    return rows, f"the attitude stands for {longest:.1f} s while the gyro turns: no measurement"


def _means(values: Array, width: int) -> Array:
    """Running means (n, 3)."""
    sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])
    ends = np.minimum(np.arange(len(values)) + width, len(values))
    first = np.maximum(ends - width, 0)
    return (sums[ends] - sums[first]) / np.maximum(ends - first, 1)[:, None]
