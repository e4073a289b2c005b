"""What is in a recording, how good it is, and what of it can be used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.rotations import body_rates
from groundstation.errors import BadInputError
from groundstation.recording.session import (
    CHANNELS,
    NO_CHANNEL,
    NOTES_METADATA,
    ROWS_METADATA,
    UNCLEAR_METADATA,
    Channel,
    Recording,
)
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import (
    ACCELEROMETER_M_S2,
    GYRO_RAD_S,
    SAMPLE_PERIOD_S,
    STANDARD_GRAVITY,
    TICK_S,
)
from groundstation.telemetry.samples import (
    FIELDS,
    HELD,
    OVERDRIVEN,
    SETTINGS_HZ,
    RowSteps,
    SampleBatch,
    renewals,
    row_steps,
    rows_held,
    slower_than_rows,
    spans,
)

# A recording in plain numbers and words: rate, gaps, loss, clipping, a verdict.


GAPS_LISTED = 100
"""The report lists this many of the longest gaps; ``gap_count`` counts all."""
RENEWAL_ROWS = 100_000
"""Samples by which it is measured how often channels are renewed."""
LOSS_TOLERATED = 0.01
GAP_TOLERATED_S = 0.05
STANDS = 0.5
"""Share of samples that repeat the time before, from which it does not advance: more repeat it than
have one of their own."""
FEW = 10
"""Samples: 20 ms of telemetry."""
RENEWED = {
    "duty": "the motors' settings are renewed",
    "gyro": "the gyro is renewed",
    "accelerometer": "the accelerometer is renewed",
}
FULL_DUTY = 4088 / 4096
"""The largest duty of a 9-bit PWM."""
LOW_BATTERY_V = 3.0
MARKS = ("mark", "gap", "gap ended")
"""Kinds of events that point at a stretch of a flight."""

_GYRO_RANGES_DEG_S = (250, 500, 1000, 2000)
_ACCELEROMETER_RANGES_G = (2, 4, 8, 16, 24)
_RAIL = 0.9995


def inspect_recording(recording: Recording) -> dict[str, Any]:
    """Describe a recording in plain numbers and words, ready for JSON (None for no value).

    All times are device time; the pause at a restart, which device time cannot tell, is in
    none of them. The period is the packet's 2 ms or, for other sources, the median step; a
    gap is a step of more than one and a half periods. Clipping is a sample at the end of the
    packet's 16 bits, at a usual range of the sensor (other sources), or a motor at full duty.

    Keys: file, kind, link, samples, raw_packets (0 where the source had none), duration_s,
    rate_hz (samples over duration), period_s, lost_samples, gaps (start_s, duration_s, lost,
    segment; the 100 longest), gap_count, duplicates (further copies of samples), malformed
    (no telemetry packets), damaged (contradicting the other copies, or fitting nowhere),
    repeated_times, segments, clipping (channel -> samples), ranges (channel -> unit, min,
    max, mean), missing (channels without data), tables (name -> rows), marks (events that a client
    or the live twin put there), damage, verdict.
    """
    samples = recording.samples
    steps = row_steps(samples)
    renewed = _renewed(samples)
    rows = recording.metadata.get(ROWS_METADATA, {})
    raw_packets = _raw_packets(recording)
    segments = len(np.unique(samples.segment))
    duration_s = float(steps.step_s.sum()) + segments * steps.period_s
    report: dict[str, Any] = {
        "file": str(recording.path),
        "kind": recording.kind,
        "link": recording.link,
        "samples": len(samples),
        "raw_packets": raw_packets,
        "duration_s": duration_s,
        "rate_hz": len(samples) / duration_s if duration_s > 0 else 0.0,
        "period_s": steps.period_s,
        "lost_samples": int(steps.lost.sum()),
        "gaps": _gaps(samples, steps),
        "gap_count": int(np.count_nonzero(steps.lost)),
        **_packet_counts(recording),
        "repeated_times": int(np.count_nonzero(steps.step_s == 0)),
        "out_of_order": _count(rows.get("out_of_order", "")),
        "row_copies": _count(rows.get("copies", "")),
        "clock": "host" if steps.by_host else "craft",
        "segments": segments,
        **_channels(samples, renewed, steps.period_s),
        "tables": {name: len(table.time_s) for name, table in recording.tables.items()},
        "marks": [_mark(event) for event in recording.events if event.get("kind") in MARKS],
        "damage": list(recording.damage),
        "unclear": dict(recording.metadata.get(UNCLEAR_METADATA, {})),
        "notes": list(recording.metadata.get(NOTES_METADATA, {}).values()),
        "being_written": recording.being_written,
    }
    asked = Asked(report, samples, renewed)
    faults = [
        words for least, question in QUESTIONS if len(samples) >= least for words in question(asked)
    ]
    grade = "bad" if _useless(report) else "usable, with faults" if faults else "good"
    verdict = f"{grade}: {'; '.join(faults) or _summary(report)}"
    report["verdict"] = f"being recorded, so far {verdict}" if recording.being_written else verdict
    return report


def _mark(event: dict[str, Any]) -> dict[str, Any]:
    """An event with all its keys: a file, another program's say, need not have them."""
    return {**event, **{key: str(event.get(key, "")) for key in ("link", "text")}}


def _count(text: str) -> int:
    """A count of a file's metadata, 0 where that is no number."""
    return int(text) if text.isdecimal() and len(text) < 20 else 0


def _useless(report: dict[str, Any]) -> str:
    """Why nothing can be done with the samples, or empty."""
    if report["samples"] == 0:
        return "no samples"
    if not report["ranges"]:
        return f"no channel has data: {report['unclear'].get(NO_CHANNEL, 'none is known here')}"
    if report["samples"] >= FEW and report["repeated_times"] > STANDS * report["samples"]:
        return (
            f"time does not advance: {report['repeated_times']} of {report['samples']} samples have"
            " the time of the one before, as where a time since 1970 was written with too few"
            " digits; write it again, or say how many rows a second there are (--rate)"
        )
    return ""


def _summary(report: dict[str, Any]) -> str:
    lost, samples = report["lost_samples"], report["samples"]
    share = 100 * lost / (lost + samples)
    loss = f"{lost} samples lost ({share:.2g} %)" if lost else "nothing lost"
    stamped = ", stamped by a host" if report["clock"] == "host" else ""
    return f"{report['duration_s']:.3g} s at {report['rate_hz']:.4g} Hz{stamped}, {loss}"


def _gaps(samples: SampleBatch, steps: RowSteps) -> list[dict[str, Any]]:
    """The longest gaps in order of time; ``start_s`` counts from the segment's first sample."""
    where = np.flatnonzero(steps.lost)
    if len(where) > GAPS_LISTED:
        where = np.sort(where[np.argsort(-steps.step_s[where], kind="stable")[:GAPS_LISTED]])
    rows = steps.rows[where]
    first = np.searchsorted(samples.segment, samples.segment[rows])
    start_s = (samples.ticks[rows] - samples.ticks[first]) * samples.tick_s
    columns = {
        "start_s": start_s,
        "duration_s": steps.step_s[where],
        "lost": steps.lost[where],
        "segment": samples.segment[rows],
    }
    cells = zip(*(one.tolist() for one in columns.values()), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in cells]


def _raw_packets(recording: Recording) -> int:
    if recording.raw is not None:
        return len(recording.raw)
    return int(recording.samples.copies.sum()) if recording.kind == "mcap" else 0


def _packet_counts(recording: Recording) -> dict[str, int]:
    """What became of the packets that are no sample: the decoder says so again."""
    raw = recording.raw
    if raw is None or recording.kind != "mcap":  # one made packet a sample, where there are any
        copies = recording.samples.copies.astype(np.int64)
        return {"duplicates": int((copies - 1).clip(0).sum()), "malformed": 0, "damaged": 0}
    from groundstation.telemetry.decoder import decode_all

    counts = decode_all(raw)[1]
    damaged = counts.damaged + counts.disagreeing
    return {"duplicates": counts.duplicates, "malformed": counts.malformed, "damaged": damaged}


def _channels(
    samples: SampleBatch, renewed: Mapping[str, NDArray[np.intp]], period_s: float
) -> dict[str, Any]:
    """What each channel holds, how often it is renewed, and which there are none of."""
    ranges, missing_values = {}, {}
    for channel in CHANNELS:
        values = channel.of(samples)
        shown = values[np.isfinite(values)].astype(np.float64)
        if not len(shown):
            continue
        if len(shown) < len(values):
            missing_values[channel.name] = len(values) - len(shown)
        ranges[channel.name] = {
            "unit": channel.unit,
            "min": float(shown.min()) * channel.scale,
            "max": float(shown.max()) * channel.scale,
            "mean": float(shown.mean()) * channel.scale,
        }
    held = {name: rows_held(rows) for name, rows in renewed.items() if period_s > 0}
    return {
        "clipping": _clipping(samples),
        "ranges": ranges,
        "missing_values": missing_values,
        "renewed_hz": {n: 1 / (hold * period_s) for n, hold in held.items() if np.isfinite(hold)},
        "missing": [
            one.name for one in CHANNELS if one.field != "duty_step" and one.name not in ranges
        ],
    }


def _clipping(samples: SampleBatch) -> dict[str, int]:
    """Samples at the rail, per channel that has any."""
    clipped = {}
    for channel in CHANNELS:
        values = channel.of(samples)
        if channel.field == "duty":
            count = int(np.count_nonzero(values >= np.float32(FULL_DUTY)))
        elif channel.field in ("gyro", "accelerometer"):
            count = _at_rail(values, channel, samples.tick_s == TICK_S)
        else:
            continue
        if count:
            clipped[channel.name] = count
    return clipped


def _at_rail(values: NDArray[np.float32], channel: Channel, is_packet: bool) -> int:
    """Samples at the end of the packet's 16 bits, or stuck at a usual range of the sensor."""
    finite = values[np.isfinite(values)].astype(np.float64)
    is_gyro = channel.field == "gyro"
    if is_packet:
        counts = np.rint(finite / (GYRO_RAD_S if is_gyro else ACCELEROMETER_M_S2))
        return int(np.count_nonzero((counts >= 32767) | (counts <= -32768)))
    shown = np.abs(finite * channel.scale)
    peak = shown.max(initial=0.0)
    for limit in _GYRO_RANGES_DEG_S if is_gyro else _ACCELEROMETER_RANGES_G:
        if _RAIL * limit <= peak <= limit / _RAIL:
            count = int(np.count_nonzero(shown >= _RAIL * limit))
            return count if count > 1 else 0  # one alone is a peak that happens to lie there
    return 0


def _renewed(samples: SampleBatch) -> dict[str, NDArray[np.intp]]:
    """Field -> rows with a new value, of at most ``RENEWAL_ROWS`` in the middle of a recording."""
    first = max(0, (len(samples) - RENEWAL_ROWS) // 2)
    middle = slice(first, first + RENEWAL_ROWS)
    found = {}
    for name in FIELDS:
        values = getattr(samples, name)[middle]
        if values.ndim > 1:  # a channel that is not there at all hides no other
            values = values[:, np.isfinite(values).any(axis=0)]
        rows = renewals(values) if values.size else np.empty(0, np.intp)
        if len(rows):
            found[name] = rows
    return found


# What is asked of a recording.


@dataclass(frozen=True, slots=True)
class Asked:
    """report: as ``inspect_recording`` gives it, without a verdict. renewed: field -> rows with a
    new value."""

    report: dict[str, Any]
    samples: SampleBatch
    renewed: Mapping[str, NDArray[np.intp]]


def _damaged(asked: Asked) -> Iterator[str]:
    damage = asked.report["damage"]
    if damage:
        yield damage[0] + (f" (and {len(damage) - 1} more)" if len(damage) > 1 else "")
    if useless := _useless(asked.report):
        yield useless


def _lost(asked: Asked) -> Iterator[str]:
    report, samples = asked.report, asked.report["samples"]
    if samples < FEW:
        yield f"only {samples} samples: nothing can be told of the craft"
    lost = report["lost_samples"]
    longest = max(report["gaps"], key=lambda gap: gap["duration_s"], default=None)
    if longest and lost > LOSS_TOLERATED * (lost + samples):
        yield (
            f"{lost} samples lost ({100 * lost / (lost + samples):.2g} %), gaps:"
            f" {report['gap_count']}, the longest {longest['duration_s']:.3g} s"
        )
    elif longest and longest["duration_s"] > GAP_TOLERATED_S:
        yield f"a gap of {longest['duration_s']:.3g} s at {longest['start_s']:.3f} s"


def _counted(asked: Asked) -> Iterator[str]:
    report = asked.report
    repeated = report["repeated_times"]
    if report["out_of_order"]:
        yield f"{report['out_of_order']} samples were out of order, and sorted"
    if report["row_copies"]:
        yield f"{report['row_copies']} rows were copies of others, and left out"
    if 0 < repeated <= STANDS * report["samples"]:
        yield f"{repeated} samples repeat the time of the one before"
    if report["segments"] > 1:
        yield f"restarts of the device: {report['segments'] - 1}"
    if asked.samples.tick_s == TICK_S and report["period_s"] != SAMPLE_PERIOD_S:
        yield f"a sample every {report['period_s'] * 1e3:.3g} ms where the telemetry has 2 ms"
    for channel, count in report["clipping"].items():
        yield f"{channel} at its limit in {count} samples"


def _values(asked: Asked) -> Iterator[str]:
    force = np.linalg.norm(asked.samples.accelerometer.astype(np.float64), axis=1)
    force_g = force[np.isfinite(force)] / STANDARD_GRAVITY
    if len(force_g) and not 0.5 < (mean_g := float(force_g.mean())) < 2:
        yield f"the accelerometer's mean is {mean_g:.3g} g: check its unit"
    least_v = asked.report["ranges"].get("battery", {}).get("min", LOW_BATTERY_V)
    if KINDS["battery_v"].low <= least_v < LOW_BATTERY_V:
        yield f"the battery went down to {least_v:.2f} V"


def _paced(asked: Asked) -> Iterator[str]:
    hz = 1 / asked.report["period_s"] if asked.report["period_s"] > 0 else FASTEST_HZ
    if not SLOWEST_HZ <= hz <= FASTEST_HZ:
        yield (
            f"{hz:.3g} samples a second, where telemetry of a flight has {SLOWEST_HZ:g} to"
            f" {FASTEST_HZ:g}: check the time's unit{', or log faster' * (hz < SLOWEST_HZ)}"
        )


def _believed(asked: Asked) -> Iterator[str]:
    found = rejections(asked.samples)
    yield from (one.words for one in found)
    left = without(asked.samples, [one for one in found if one.rows.any()])
    yield from _absent(left, asked.report)


def _slowly_renewed(asked: Asked) -> Iterator[str]:
    for name, what in RENEWED.items():
        hz = asked.report["renewed_hz"].get(name, np.inf)
        if hz < SETTINGS_HZ and slower_than_rows(asked.renewed[name]) > HELD:
            yield f"{what} {hz:.3g} times a second in {1 / asked.report['period_s']:.3g} samples"


def _contradictory(asked: Asked) -> Iterator[str]:
    yield from (said for name, said in asked.report["unclear"].items() if name != NO_CHANNEL)
    yield from contradictions(asked.samples)


QUESTIONS: tuple[tuple[int, Callable[[Asked], Iterable[str]]], ...] = (
    (0, _damaged),
    (1, _lost),
    (1, _counted),
    (1, _values),
    (FEW, _paced),
    (FEW, _believed),
    (FEW, _slowly_renewed),
    (FEW, _contradictory),
)
"""From how many samples on a question is asked, and the question, worst first: each gives words, or
none, for what a user should know before trusting the recording."""


# Can it be? What a quadrotor's channels can hold, and whether they agree with each other.
#
# A range for each channel, values that are missing, and what is measured twice: the rate at which
# the attitude turns and the gyro, specific force at rest and 1 g, motors and whether the craft lies
# still or flies. Every format is judged alike, after it was read.


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


def _absent(samples: SampleBatch, report: Mapping[str, Any]) -> Iterator[str]:
    """Values that are not there, and motors that hardly turn in flight. samples: without what is
    not believed of them. report: as ``inspect_recording`` gives it."""
    ranges = {name: (one["min"], one["max"]) for name, one in report["ranges"].items()}
    for field in KINDS:
        names = [one.name for one in CHANNELS if one.field == field and one.name in ranges]
        lost = {name: report["missing_values"].get(name, 0) for name in names}
        for count in sorted(set(lost.values())):
            if count > MISSING * len(samples):
                which = ", ".join(name for name, one in lost.items() if one == count)
                yield f"{which} missing in {count} of {len(samples)} samples"
    flown = ranges.get("duty_1", (0.0, 1.0))[1]
    if 0.0 < flown < BARELY and _flies(samples):
        yield f"the motors' duty never exceeds {flown:.2g} though the craft flies: check its unit"
    duty = [ranges[f"duty_{m}"] for m in range(1, 5) if f"duty_{m}" in ranges]
    if len(duty) < 4 or any(low != high for low, high in duty) or not _flies(samples):
        return
    if all(low == 0.0 for low, _ in duty):
        yield (
            "the motors are off throughout while the craft turns: it was moved by hand, or"
            " their duty is not in the file"
        )
    else:
        shown = f"{duty[0][0]:.2g}" if len({*duty}) == 1 else "each the same"
        yield f"the motors' duty is {shown} throughout though the craft turns as in flight"


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


# Numbers that are no measurement: what a program writes where it has none, and an attitude that
# stands while the craft turns.


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
TURNS_ALONE_RAD_S, SMOOTH_S, STANDS_S = np.radians(5.0), 0.1, 2.0
"""An attitude that stands for so long is none where the gyro, averaged over that short a while as
rotors shake it, turns by more (root mean square)."""


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


def _standing(samples: SampleBatch) -> tuple[Mask, str] | None:
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
            rows[:, axis] = known & (np.sqrt(np.mean(smooth[known, axis] ** 2)) > TURNS_ALONE_RAD_S)
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
        if last - first > least and span_s >= STANDS_S and turned > TURNS_ALONE_RAD_S:
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


# Which samples are believed: the one judgement of them, for ``inspect`` and for every later step.
#
# What a channel cannot hold, what was extrapolated there, and what a dead sensor repeats is
# rejected: ``inspect`` tells it, and whatever analyses a recording takes it as missing
# (``sound``).


REJECTED_METADATA = "taken as missing"
"""Under which a recording's metadata name what was rejected, field -> words."""
OTHER_UNIT = 0.1
"""Share of impossible samples, here and there in a recording, from which a unit or a scale is
wrong, and the whole field is rejected; fewer are spikes."""
OTHER_FULL = 0.9
"""The same of duties beyond full: controllers that ask for more than there is are logged so."""
SMOOTH = 0.1
"""Share of its usual change of slope below which a channel is not measured but extrapolated."""
STUCK_S, STUCK_ROWS, OTHERS_MOVE = 0.5, 50, 0.2
"""How long a channel keeps one value until it is stuck, and the share of these samples in which the
others of its kind change."""
MOST_YAW_DEG = 1e4
"""Yaw may count turns, 28 to either side."""
RESTS, FULL = 0.01, 0.99
"""Duties at which a motor may stand for long: off, and saturated."""


@dataclass(frozen=True, slots=True)
class Rejection:
    """rows: (n, k), samples of a field's k channels that are not believed; none where it is told
    only. words: why, for people."""

    field: str
    rows: Mask
    words: str


def sound(recording: Recording) -> Recording:
    """The recording with what is rejected as missing (NaN), and words for it in its metadata.

    Raises BadInputError where its rows are several crafts' or sensors'."""
    mixed = recording.metadata.get(UNCLEAR_METADATA, {}).get("rows")
    if mixed:
        raise BadInputError(f"{recording.path}: {mixed}")
    found = [one for one in rejections(recording.samples) if one.rows.any()]
    if not found:
        return recording
    told = {f"{number}. {one.field}": one.words for number, one in enumerate(found, 1)}
    metadata = {**recording.metadata, REJECTED_METADATA: told}
    return replace(recording, samples=without(recording.samples, found), metadata=metadata)


def rejected(recording: Recording) -> list[str]:
    """What of a recording was taken as missing, and what its file leaves open, a line each,
    beginning with its name."""
    told = recording.metadata.get(REJECTED_METADATA, {})
    left_open = recording.metadata.get(UNCLEAR_METADATA, {})
    lines = [*(f"taken as missing: {line}" for line in told.values()), *left_open.values()]
    return [f"{recording.path.name}: {line}" for line in lines]


def rejections(samples: SampleBatch) -> list[Rejection]:
    """What is not believed of samples, field by field."""
    steps = np.diff(samples.ticks)
    usual_s = float(np.median(steps)) * samples.tick_s if len(steps) else 0.0
    least = max(STUCK_ROWS, round(STUCK_S / max(usual_s, 1e-6)))
    found: list[Rejection] = []
    for field, kind in KINDS.items():
        channels = [one for one in CHANNELS if one.field == field and one.is_in(samples)]
        if channels:
            no_value = [*_no_value(without(samples, found), field)]
            left = without(samples, no_value)
            there = [one for one in channels if one.is_in(left)]
            beyond = [*_beyond(left, field, kind, there)] or [*_overdriven(left, field)]
            found += [*no_value, *beyond]
            left = without(left, beyond)
            found += _motionless(left, field, least) if kind.moves else ()
    return [*found, *_frozen(samples, "gyro", least), *_frozen(samples, "accelerometer", least)]


def without(samples: SampleBatch, some: Sequence[Rejection]) -> SampleBatch:
    """Samples with what is rejected as missing (NaN)."""
    for one in some:
        values = getattr(samples, one.field).copy()
        values.reshape(len(values), -1)[one.rows] = np.nan
        samples = replace(samples, **{one.field: values})
    return samples


def _no_value(samples: SampleBatch, field: str) -> Iterator[Rejection]:
    """Numbers that stand for none, far from all others, and an attitude that stands while the craft
    turns."""
    for channel in CHANNELS if field in FAR else ():
        if channel.field != field or not channel.is_in(samples):
            continue
        values, scale = channel.of(samples).astype(np.float64), channel.scale
        low = LEAST_DUTY if field == "duty" else KINDS[field].low / scale
        bounds = (low, KINDS[field].high / scale)
        if channel.name == "yaw":  # counts turns
            bounds = -np.inf, np.inf
        for _ in range(KINDS_OF_IT):
            rows = _sentinel(values, FAR[field] / scale, bounds)
            if rows is None:
                break
            shown = f"{values[rows][0] * scale:.6g} {channel.unit}".removesuffix(" 1")
            yield Rejection(
                field,
                np.tile(rows[:, None], _table(samples, field).shape[1]),
                f"{channel.name} is exactly {shown} in {int(rows.sum())} of {len(rows)} samples,"
                " far from all others: it stands for no value",
            )
            values = np.where(rows, np.nan, values)
    if field == "attitude" and (stands := _standing(samples)) is not None:
        yield Rejection(field, *stands)


def _beyond(
    samples: SampleBatch, field: str, kind: Kind, channels: list[Channel]
) -> Iterator[Rejection]:
    """Values beyond what a kind can be, with what was extrapolated to there."""
    wrong = np.zeros(_table(samples, field).shape, np.bool_)
    worst, names = (0.0, 0.0, ""), []
    for channel in channels:
        least, most = kind.low, kind.high
        if channel.name == "yaw":
            least, most = -MOST_YAW_DEG, MOST_YAW_DEG
        shown = channel.shown(samples)
        low, high = float(np.nanmin(shown)), float(np.nanmax(shown))
        if low < least or high > most:
            wrong[:, channel.index or 0] = (shown < least) | (shown > most)
            worst = max(worst, (least - low, low, channel.unit), (high - most, high, channel.unit))
            names.append(channel.name)
    if not names:
        return
    value = f"{worst[1]:.4g} {worst[2]}".removesuffix(" 1")
    count = int(wrong.any(axis=1).sum())
    if field == "duty":
        wrong |= samples.duty > OVERDRIVEN
    rows, since = _with_extrapolated(samples, field, wrong, OTHER_UNIT)
    yield Rejection(
        field,
        rows,
        f"{', '.join(names)} up to {value}, which cannot be, in {count} of {len(samples)} samples"
        + (f", from {since:.1f} s on" if since is not None else ": check unit and scale"),
    )


def _overdriven(samples: SampleBatch, field: str) -> Iterator[Rejection]:
    """Duties beyond full: nothing was received, or controllers asked for more than there is."""
    beyond = samples.overdriven
    if field != "duty" or not beyond.any():
        return
    rows, since = _with_extrapolated(samples, field, samples.duty > OVERDRIVEN, OTHER_FULL)
    most = float(np.nanmax(samples.duty))
    yield Rejection(
        field,
        rows,
        f"a motor beyond full duty in {int(beyond.sum())} samples, up to {most:.4g}"
        + ("" if since is None else f", from {since:.1f} s on"),
    )


def _with_extrapolated(
    samples: SampleBatch, field: str, wrong: Mask, most: float
) -> tuple[Mask, float | None]:
    """What to reject around wrong values (n, k) of a field, in all its channels, and from when on
    (s after the start), None where not all is wrong from some moment on.

    A block of them reaches over the neighbours that are as smooth as no measurement is. Where the
    recording was sound for a while and is mostly wrong from then on, all from there is rejected;
    where more than ``most`` of the samples are wrong here and there, all of them.
    """
    values, turning = _table(samples, field).astype(np.float64), (samples.duty > 0.0).any(axis=1)
    rows: Mask = np.asarray(wrong.any(axis=1))
    extrapolated = np.zeros(len(wrong), np.bool_)
    for column in np.flatnonzero(wrong.any(axis=0)):
        extrapolated |= _extrapolated(values[:, column], wrong[:, column])
    out = rows | extrapolated
    first = int(np.argmax(out))
    judged = int(turning.sum()) if most == OTHER_FULL else len(rows)
    since = None
    if out[first:].mean() > 0.5 and _was_in_use(samples, field, first):
        since = float(samples.time_s[first] - samples.time_s[0])
        out[first:] = True
    elif (rows & ~extrapolated).sum() > most * judged:
        out[:] = True
    return np.tile(out[:, None], (1, wrong.shape[1])), since


def _extrapolated(values: Array, wrong: Mask) -> Mask:
    """Rows of a channel (n,) that reach, as smooth as no measurement is, into wrong ones.

    The slope of a measured channel changes from sample to sample, that of an extrapolated one
    hardly does.
    """
    bends = np.full(len(values), np.inf)
    if len(values) > 2:
        with np.errstate(invalid="ignore", over="ignore"):  # infinite values bend by no number
            bends[1:-1] = np.abs(np.diff(values, 2))
            bends[1:-1][np.diff(values)[1:] == 0.0] = np.inf  # what rests is no extrapolation
    usual = bends[~wrong & np.isfinite(bends)]
    smooth = bends < (SMOOTH * float(np.quantile(usual, 0.75)) if len(usual) else 0.0)
    out = np.zeros(len(values), np.bool_)
    for first, last in spans(smooth):
        if wrong[first:last].any():
            out[first:last] = True
    return out


def _was_in_use(samples: SampleBatch, field: str, first: int) -> bool:
    """Whether the rows before ``first`` are a part of the recording that shows a field at work: it
    changes, in flight where duties are known."""
    known = _table(samples, field)[:first]
    known = known[np.isfinite(known)]
    flown = (samples.duty[:first] > BARELY).all(axis=1).sum()
    used = flown if np.isfinite(samples.duty).any() else first
    return bool(len(known) and np.ptp(known) > 0.0 and used > OTHER_UNIT * len(samples))


def _motionless(samples: SampleBatch, field: str, least: int) -> Iterator[Rejection]:
    """Channels that keep one value while others of their kind change."""
    values = _table(samples, field)
    if not _stands(values, least):
        return
    parts = [renewals(values[:, k]) for k in range(values.shape[1])]
    channels = [one for one in CHANNELS if one.field == field]
    for index, (channel, rows) in enumerate(zip(channels, parts, strict=True)):
        others = [one for k, one in enumerate(parts) if k != index and len(one) > 1]
        if not len(rows) or not others:
            continue
        stuck = np.zeros(values.shape, np.bool_)
        value = float(channel.of(samples)[rows[0]]) * channel.scale
        if len(rows) == 1:
            if max(map(len, others)) > STUCK_ROWS:
                # A motor that is never driven is no fault of a log: told only.
                stuck[:, index] = field != "duty" or value > RESTS
                words = f"{channel.name} is {value:g} throughout while the others change: dead?"
                yield Rejection(field, stuck, words)
            continue
        longest = (0, 0)
        apart = np.diff(rows, append=len(samples))
        for first, long in zip(rows[apart >= least], apart[apart >= least], strict=True):
            there = np.isfinite(values[first : first + long, index]).mean() > 0.5
            if (
                long < least
                or not there
                or _may_rest(samples, field, index, slice(first, first + long))
            ):
                continue
            moved = min(np.count_nonzero((one >= first) & (one < first + long)) for one in others)
            if moved > OTHERS_MOVE * long:
                stuck[first : first + long, index] = True
                longest = max(longest, (int(long), int(first)))
        if longest[0]:
            yield Rejection(
                field,
                stuck,
                f"{channel.name} is stuck for {longest[0]} samples from number {longest[1] + 1} on,"
                " while the others change",
            )


def _may_rest(samples: SampleBatch, field: str, index: int, rows: slice) -> bool:
    """Whether a channel may keep its value in these rows: a motor that is off or saturated, a rotor
    that stands and is not driven."""
    value = float(getattr(samples, field)[rows.start, index])
    if field == "duty":
        return not RESTS < value < FULL
    driven = samples.duty[rows, index] > BARELY
    return bool(field == "rotor_rev_s" and value == 0.0 and driven.mean() < 0.5)


def _frozen(samples: SampleBatch, field: str, least: int) -> Iterator[Rejection]:
    """A sensor that repeats all three axes while the motors' settings change in flight."""
    values, duty = getattr(samples, field), samples.duty
    if not _stands(values, least) or not np.isfinite(duty).any():
        return
    same, changed = np.zeros(len(values), np.bool_), np.zeros(len(values), np.bool_)
    same[1:] = (values[1:] == values[:-1]).all(axis=1)
    changed[1:] = (duty[1:] != duty[:-1]).any(axis=1) & (duty[1:] > BARELY).all(axis=1)
    rows, longest = np.zeros(values.shape, np.bool_), (0, 0)
    for first, last in spans(same):
        long = last - first + 1
        if long >= least and changed[first:last].mean() > OTHERS_MOVE:
            rows[first:last] = True
            longest = max(longest, (long, first - 1))
    if longest[0]:
        yield Rejection(
            field,
            rows,
            f"the {field} is frozen for {longest[0]} samples from number {longest[1] + 1} on, while"
            " the motors change",
        )


def _stands(values: NDArray[np.float32], least: int) -> bool:
    """Whether any of the channels (n, k) may keep a value for ``least`` rows, by a few of them."""
    few = values[:: max(1, min(least, len(values) // 8) // 4)]
    same = few[1:] == few[:-1]
    return bool((same[2:] & same[1:-1] & same[:-2]).any())


def _table(samples: SampleBatch, field: str) -> NDArray[np.float32]:
    """A field as (n, k)."""
    values: NDArray[np.float32] = getattr(samples, field)
    return values if values.ndim == 2 else values[:, None]
