"""Can it be? What a quadrotor's channels can hold, and whether they agree with each other.

A range for each channel, values that are missing or never change, and what is measured twice: the
rate at which the attitude turns and the gyro, specific force at rest and 1 g, motors and whether
the craft lies still or flies. Every format is judged alike, after it was read.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.rotations import body_rates
from groundstation.errors import BadInputError
from groundstation.recording.channels import CHANNELS, Channel
from groundstation.recording.session import Recording
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.renewal import renewals
from groundstation.telemetry.samples import SampleBatch

Array = NDArray[np.float64]


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
    "duty": Kind(-0.001, np.inf, True),  # beyond full duty has a count of its own
    "gyro": Kind(-4000.0, 4000.0, True),
    "accelerometer": Kind(-50.0, 50.0, True),
    "attitude": Kind(-180.5, 180.5, False),
    "rotor_rev_s": Kind(0.0, 100_000.0, True),
}
"""By field. One cell nearly empty to fourteen full; gyros end at 2000 or 4000 deg/s, accelerometers
at 2 to 32 g; the smallest rotors that fly stay below 80 000 rev/min. Yaw may count turns."""
FITTED = ("battery_v", "duty", "gyro", "accelerometer", "rotor_rev_s")
"""Fields that fits take."""
REFUSED = 0.1
"""Share of impossible samples from which a unit or a scale is wrong, and no fit is worth its while;
fewer are spikes."""
SLOWEST_HZ, FASTEST_HZ = 20.0, 10_000.0
"""Samples a second between which telemetry of a flight is: else the clock's unit is another."""
MISSING = 0.02
"""Share of missing values worth a word: sources of a log begin one after the other."""
STUCK_S, STUCK_ROWS, OTHERS_MOVE = 0.5, 50, 0.2
"""How long a channel keeps one value until it is stuck, and the share of these samples in which the
others of its kind change."""
RESTS, FULL = 0.01, 0.99
"""Duties at which a motor may stand for long: off, and saturated."""
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


def require_possible(recording: Recording, fields: Collection[str] = FITTED) -> None:
    """Raises BadInputError where much of what a fit needs cannot be: a unit or a scale is wrong."""
    samples = recording.samples
    ranges = {name: (one["min"], one["max"]) for name, one in ranges_of(samples)[0].items()}
    for field in fields:
        channels = [one for one in CHANNELS if one.field == field and one.name in ranges]
        for count, line in _beyond(samples, KINDS[field], channels, ranges):
            if count > REFUSED * len(samples):
                raise BadInputError(
                    f"{recording.path.name}: {line}; 'groundstation inspect' shows every channel,"
                    " a column map says another unit"
                )


def impossible(
    samples: SampleBatch, known: dict[str, int], ranges: dict[str, tuple[float, float]]
) -> Iterator[str]:
    """Values that cannot be, or are not there. known: channel -> samples that have it. ranges:
    channel -> least and largest in its shown unit."""
    for field, kind in KINDS.items():
        channels = [one for one in CHANNELS if one.field == field and one.name in ranges]
        yield from (line for _, line in _beyond(samples, kind, channels, ranges))
        absent = {one.name: len(samples) - known[one.name] for one in channels}
        for count in sorted(set(absent.values())):
            if count > MISSING * len(samples):
                names = ", ".join(name for name, one in absent.items() if one == count)
                yield f"{names} missing in {count} of {len(samples)} samples"
    flown = ranges.get("duty_1", (0.0, 1.0))[1]
    if 0.0 < flown < BARELY and _flies(samples):
        yield f"the motors' duty never exceeds {flown:.2g} though the craft flies: check its unit"


def _beyond(
    samples: SampleBatch,
    kind: Kind,
    channels: Sequence[Channel],
    ranges: dict[str, tuple[float, float]],
) -> Iterator[tuple[int, str]]:
    """Samples in which channels of a kind hold what it cannot, and a line that says so."""
    rows = np.zeros(len(samples), np.bool_)
    worst, names = (0.0, 0.0, ""), []
    for channel in channels:
        least, most = (-np.inf, np.inf) if channel.name == "yaw" else (kind.low, kind.high)
        low, high = ranges[channel.name]
        if low < least or high > most:
            shown = channel.shown(samples)
            rows |= (shown < least) | (shown > most)
            worst = max(worst, (least - low, low, channel.unit), (high - most, high, channel.unit))
            names.append(channel.name)
    if names:
        value = f"{worst[1]:.4g} {worst[2]}".removesuffix(" 1")
        count = int(rows.sum())
        yield (
            count,
            f"{', '.join(names)} up to {value}, which cannot be, in {count} of"
            f" {len(samples)} samples: check unit and scale",
        )


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


def motionless(samples: SampleBatch, period_s: float) -> Iterator[str]:
    """Channels that keep one value while others of their kind change."""
    least = max(STUCK_ROWS, round(STUCK_S / max(period_s, 1e-6)))
    for field, kind in KINDS.items():
        values = getattr(samples, field)
        if not kind.moves or not _stands(values, least):
            continue
        parts = [renewals(values[:, k]) for k in range(values.shape[1])]
        channels = [one for one in CHANNELS if one.field == field]
        for index, (channel, rows) in enumerate(zip(channels, parts, strict=True)):
            others = [one for k, one in enumerate(parts) if k != index and len(one) > 1]
            if not len(rows) or not others:
                continue
            first = int(rows[0])
            value = float(channel.of(samples)[first]) * channel.scale
            if len(rows) == 1:
                if max(map(len, others)) > STUCK_ROWS:
                    yield f"{channel.name} is {value:g} throughout while the others change: dead?"
                continue
            apart = np.diff(rows, append=len(samples))
            place = int(np.argmax(apart))
            first, long = int(rows[place]), int(apart[place])
            value = float(channel.of(samples)[first])
            if long < least or (field == "duty" and not RESTS < value < FULL):
                continue
            moved = min(np.count_nonzero((one >= first) & (one < first + long)) for one in others)
            if moved > OTHERS_MOVE * long:
                yield (
                    f"{channel.name} is stuck for {long} samples from number {first + 1} on, while"
                    " the others change"
                )


def _stands(values: NDArray[np.float32], least: int) -> bool:
    """Whether any of the channels (n, k) may keep a value for ``least`` rows, by a few of them."""
    few = values[:: max(1, min(least, len(values) // 8) // 4)]
    same = few[1:] == few[:-1]
    return bool((same[2:] & same[1:-1] & same[:-2]).any())


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
    """Whether it turns like nothing that stands on the ground."""
    moving = [np.sqrt(np.mean(one.gyro.astype(np.float64) ** 2)) for one in _blocks(samples)]
    return bool(len(moving) and np.median(moving) > TURNS_RAD_S)
