"""Can it be? What a quadrotor's channels can hold, and whether they agree with each other.

A range for each channel (``soundness`` judges samples by it), values that are missing, and what is
measured twice: the rate at which the attitude turns and the gyro, specific force at rest and 1 g,
motors and whether the craft lies still or flies. Every format is judged alike, after it was read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from groundstation.dynamics.rotations import body_rates
from groundstation.recording.channels import CHANNELS
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch


@dataclass(frozen=True, slots=True)
class Kind:
    """What is possible of a kind of channel.

    low, high: in the channel's shown unit. moves: nothing real keeps exactly the same value while
    the others of its kind change; a dead sensor does, a wire that is off, a column of zeros.
    """

    low: float
    high: float
    moves: bool


KINDS = {
    "battery_v": Kind(2.0, 60.0, False),
    "duty": Kind(-0.001, np.inf, True),  # beyond full duty is judged apart
    "gyro": Kind(-4000.0, 4000.0, True),
    "accelerometer": Kind(-50.0, 50.0, True),
    "attitude": Kind(-180.5, 180.5, False),
    "rotor_rev_s": Kind(0.0, 100_000.0, True),
}
"""By field. One cell nearly empty to fourteen full; gyros end at 2000 or 4000 deg/s, accelerometers
at 2 to 32 g; the smallest rotors that fly stay below 80 000 rev/min. Yaw may count turns."""
SLOWEST_HZ, FASTEST_HZ = 20.0, 10_000.0
"""Samples a second between which telemetry of a flight is: else the clock's unit is another."""
MISSING = 0.02
"""Share of missing values worth a word: sources of a log begin one after the other."""
BLOCKS, BLOCK_ROWS = 16, 1500
"""Samples that redundancy is judged on: blocks spread evenly over a recording."""
WINDOW_S = 0.04
"""Between two attitudes whose difference is a rate: above the noise of their last digit."""
TURNS_RAD_S = np.radians(5.0)
"""Root mean square of a rate from which it can be compared."""
AGREES, UNLIKE = 0.7, 0.3
"""Correlation from which two rates are the same motion, and below which they are not."""
FACTOR = 2.0
"""By which one rate is another's unit: deg and rad are 57 apart."""
REST_S, REST_RAD_S, REST_M_S2 = 0.5, np.radians(1.0), 0.3
"""A window in which gyro and accelerometer scatter less is rest, on the ground."""
AT_REST_G = (0.85, 1.15)
IDLE, BARELY = 0.25, 0.05
"""Duty above which no motor idles on the ground, and below which none flies."""


def absent(
    samples: SampleBatch, known: dict[str, int], ranges: dict[str, tuple[float, float]]
) -> Iterator[str]:
    """Values that are not there, and motors that hardly turn in flight. known: channel -> samples
    that have it. ranges: channel -> least and largest in its shown unit."""
    for field in KINDS:
        channels = [one for one in CHANNELS if one.field == field and one.name in ranges]
        lost = {one.name: len(samples) - known[one.name] for one in channels}
        for count in sorted(set(lost.values())):
            if count > MISSING * len(samples):
                names = ", ".join(name for name, one in lost.items() if one == count)
                yield f"{names} missing in {count} of {len(samples)} samples"
    flown = ranges.get("duty_1", (0.0, 1.0))[1]
    if 0.0 < flown < BARELY and _flies(samples):
        yield f"the motors' duty never exceeds {flown:.2g} though the craft flies: check its unit"
    duty = [
        range_ for name, range_ in ranges.items() if name.startswith("duty_") and "step" not in name
    ]
    if len(duty) == 4 and all(low == high == 0.0 for low, high in duty):
        if _flies(samples):
            yield (
                "the motors are off throughout while the craft turns: it was moved by hand, or"
                " their duty is not in the file"
            )
    elif len(duty) == 4 and all(low == high for low, high in duty) and _flies(samples):
        shown = f"{duty[0][0]:.2g}" if len({*duty}) == 1 else "each the same"
        yield f"the motors' duty is {shown} throughout though the craft turns as in flight"


def ranges_of(samples: SampleBatch) -> tuple[dict[str, dict[str, Any]], dict[str, int]]:
    """Least, largest and mean of each channel that is there, and in how many samples it is."""
    ranges, known = {}, {}
    for channel in CHANNELS:
        values = channel.of(samples)
        there = np.isfinite(values)
        count = int(np.count_nonzero(there))
        if count:
            known[channel.name] = count
            shown = (values if count == len(values) else values[there]).astype(np.float64)
            ranges[channel.name] = {
                "unit": channel.unit,
                "min": float(shown.min()) * channel.scale,
                "max": float(shown.max()) * channel.scale,
                "mean": float(shown.mean()) * channel.scale,
            }
    return ranges, known


@np.errstate(all="ignore")  # values of nonsense have been told, and count for nothing here
def contradictions(samples: SampleBatch) -> list[str]:
    """What is measured twice and does not agree, on ``BLOCKS`` of a recording."""
    blocks = list(_blocks(samples))
    return [*_rates(blocks), *_gravity(blocks), *_idle(samples, blocks)]


def _blocks(samples: SampleBatch) -> Iterator[SampleBatch]:
    """Samples without a restart or a silence between them."""
    starts = np.linspace(0, max(0, len(samples) - BLOCK_ROWS), BLOCKS).astype(np.intp)
    for start in np.unique(starts):
        block = samples[int(start) : int(start) + BLOCK_ROWS]
        steps = np.diff(block.ticks)
        usual = np.median(steps) if len(steps) else 0
        if len(steps) < 2 or usual <= 0:
            continue
        cuts = np.flatnonzero((steps > 10 * usual) | (steps <= 0)) + 1
        edges = np.concatenate([[0], cuts, [len(block)]])
        longest = int(np.argmax(np.diff(edges)))
        yield block[int(edges[longest]) : int(edges[longest + 1])]


def _rates(blocks: Sequence[SampleBatch]) -> Iterator[str]:
    """Rates of the attitude against the gyro, both as means over ``WINDOW_S``."""
    pairs = [pair for block in blocks for pair in [_rate_pairs(block)] if len(pair[0])]
    if not pairs:
        return
    turned = np.vstack([one for one, _ in pairs])
    gyro = np.vstack([other for _, other in pairs])
    gyro = gyro - np.median(gyro, axis=0)
    power = np.mean(turned**2, axis=0)
    size = np.sqrt(power)
    both = turned.T @ gyro / len(gyro)
    spread = np.sqrt(np.mean(gyro**2, axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        alike = both / (size[:, None] * spread)
        ratio = np.sqrt(power) / spread
    angles = ("roll", "pitch", "yaw")
    for i, axis in enumerate("xyz"):
        if size[i] < TURNS_RAD_S or not spread[i] > 0.0:
            continue
        if abs(alike[i, i]) > AGREES and not 1 / FACTOR < ratio[i] < FACTOR:
            yield (
                f"the attitude turns {ratio[i]:.3g} times as fast about {axis} as gyro_{axis} says:"
                " check the gyro's unit (rad/s and deg/s are 57.3 apart)"
            )
            if not 1 / FACTOR < ratio[(i + 1) % 3] < FACTOR:
                return  # one unit for all axes
        elif alike[i, i] < -AGREES:
            yield f"{angles[i]} turns against gyro_{axis}: the sign of one is wrong"
        elif abs(alike[i, i]) < UNLIKE and np.abs(alike[i]).max() > AGREES:
            other = "xyz"[int(np.abs(alike[i]).argmax())]
            yield f"{angles[i]} turns with gyro_{other}, not gyro_{axis}: axes are exchanged"


def _rate_pairs(block: SampleBatch) -> tuple[Array, Array]:
    """Body rates by the attitude and by the gyro (k, 3), rad/s, of the same spans."""
    time_s = block.time_s
    lag = max(1, round(WINDOW_S / float(np.median(np.diff(time_s)))))
    if len(block) < 4 * lag:
        return np.empty((0, 3)), np.empty((0, 3))
    attitude = block.attitude.astype(np.float64)
    change = np.remainder(attitude[lag:] - attitude[:-lag] + np.pi, 2 * np.pi) - np.pi
    elapsed = (time_s[lag:] - time_s[:-lag])[:, None]
    middle = attitude[lag // 2 :][: len(change)]
    turned = body_rates(middle, change / elapsed)
    gyro = block.gyro.astype(np.float64)
    sums = np.vstack([np.zeros(3), np.cumsum(gyro, axis=0)])
    means = (sums[lag + 1 :] - sums[1:-lag]) / lag
    good = np.isfinite(turned).all(axis=1) & np.isfinite(means).all(axis=1)
    good &= np.abs(middle[:, 1]) < np.radians(70)  # a vertical nose has no roll and yaw
    return turned[good], means[good]


def _rests(blocks: Sequence[SampleBatch]) -> Iterator[SampleBatch]:
    """Windows of ``REST_S`` in which the craft lies still, by gyro and accelerometer."""
    for block in blocks:
        period = float(np.median(np.diff(block.time_s)))
        rows = max(10, round(REST_S / period))
        for first in range(0, len(block) - rows + 1, rows):
            window = block[first : first + rows]
            still = window.gyro.std(axis=0).max() < REST_RAD_S
            if still and np.linalg.norm(window.accelerometer, axis=1).std() < REST_M_S2:
                yield window


def _gravity(blocks: Sequence[SampleBatch]) -> Iterator[str]:
    """Specific force at rest against 1 g, and whether its z points up."""
    force = np.vstack([np.empty((0, 3)), *(one.accelerometer for one in blocks)]) / STANDARD_GRAVITY
    force = force[np.isfinite(force).all(axis=1)]
    if not len(force):
        return
    mean_g = float(np.linalg.norm(force, axis=1).mean())
    upward = float(force[:, 2].mean())
    if 0.5 < mean_g < 2.0 and upward < -0.5:
        yield f"accelerometer_z is {upward:.2g} g in the mean: its sign; z points up"
    sizes = [np.linalg.norm(one.accelerometer.mean(axis=0)) for one in _rests(blocks)]
    if len(sizes) >= 2 and 0.5 < mean_g < 2.0:
        rest_g = float(np.median(sizes)) / STANDARD_GRAVITY
        if not AT_REST_G[0] < rest_g < AT_REST_G[1]:
            yield f"at rest the accelerometer reads {rest_g:.3g} g: check its scale"


def _idle(samples: SampleBatch, blocks: Sequence[SampleBatch]) -> Iterator[str]:
    """Motors that never stop although the craft lies still: their zero is another."""
    if not np.isfinite(samples.duty).any():
        return
    least = float(np.nanmin(samples.duty))
    if least <= IDLE:
        return
    for window in _rests(blocks):
        if (window.duty == np.float32(least)).all():
            yield (
                f"the motors' duty is {least:.2g} while the craft lies still, and never less:"
                " check its unit and zero (pulses of 1000..2000 us read as DShot?)"
            )
            return


def _flies(samples: SampleBatch) -> bool:
    """Whether it turns like nothing that stands on the ground, and nothing that lies about."""
    size = np.linalg.norm(samples.accelerometer.astype(np.float64), axis=1) / STANDARD_GRAVITY
    if np.isfinite(size).any() and not 0.5 < float(np.nanmedian(size)) < 2.0:
        return False
    known = [one.gyro[np.isfinite(one.gyro)].astype(np.float64) for one in _blocks(samples)]
    moving = [np.sqrt(np.mean(one**2)) for one in known if len(one)]
    return bool(len(moving) and np.median(moving) > TURNS_RAD_S)
