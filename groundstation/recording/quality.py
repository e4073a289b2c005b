"""What is in a recording and how good it is: rate, gaps, loss, clipping, a verdict."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.recording.column_map import (
    NO_CHANNEL,
    NOTES_METADATA,
    ROWS_METADATA,
    UNCLEAR_METADATA,
)
from groundstation.recording.session import CHANNELS, Channel, Recording
from groundstation.recording.soundness import (
    FASTEST_HZ,
    KINDS,
    SLOWEST_HZ,
    absent,
    contradictions,
    ranges_of,
    rejections,
    without,
)
from groundstation.telemetry.decoder import decode_all
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
    SETTINGS_HZ,
    RowSteps,
    SampleBatch,
    renewals,
    row_steps,
    rows_held,
    slower_than_rows,
)

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
    faults = [*_faults(report, samples), *_content(report, samples, renewed)]
    verdict = f"{_grade(report, faults)}: {'; '.join(faults) or _summary(report)}"
    report["verdict"] = f"being recorded, so far {verdict}" if recording.being_written else verdict
    return report


def _mark(event: dict[str, Any]) -> dict[str, Any]:
    """An event with all its keys: a file, another program's say, need not have them."""
    return {**event, **{key: str(event.get(key, "")) for key in ("link", "text")}}


def _count(text: str) -> int:
    """A count of a file's metadata, 0 where that is no number."""
    return int(text) if text.isdecimal() and len(text) < 20 else 0


def _grade(report: dict[str, Any], faults: list[str]) -> str:
    if _useless(report):
        return "bad"
    return "usable, with faults" if faults else "good"


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


def _content(
    report: dict[str, Any],
    samples: SampleBatch,
    renewed: Mapping[str, NDArray[np.intp]],
) -> Iterator[str]:
    """What cannot be in the numbers themselves, or does not agree with the rest."""
    if report["samples"] < FEW:
        return
    steps_hz = 1 / report["period_s"] if report["period_s"] > 0 else 0.0
    if steps_hz and not SLOWEST_HZ <= steps_hz <= FASTEST_HZ:
        yield (
            f"{steps_hz:.3g} samples a second, where telemetry of a flight has {SLOWEST_HZ:g} to"
            f" {FASTEST_HZ:g}: check the time's unit" + ", or log faster" * (steps_hz < SLOWEST_HZ)
        )
    ranges = {name: (one["min"], one["max"]) for name, one in report["ranges"].items()}
    known = {name: len(samples) - report["missing_values"].get(name, 0) for name in ranges}
    found = rejections(samples)
    yield from (one.words for one in found)
    yield from absent(without(samples, [one for one in found if one.rows.any()]), known, ranges)
    for name, what in RENEWED.items():
        hz = report["renewed_hz"].get(name, np.inf)
        if hz < SETTINGS_HZ and slower_than_rows(renewed[name]) > HELD:
            yield f"{what} {hz:.3g} times a second in {1 / report['period_s']:.3g} samples"
    yield from (said for field, said in report["unclear"].items() if field != NO_CHANNEL)
    yield from contradictions(samples)


def _summary(report: dict[str, Any]) -> str:
    lost, samples = report["lost_samples"], report["samples"]
    share = 100 * lost / (lost + samples)
    loss = f"{lost} samples lost ({share:.2g} %)" if lost else "nothing lost"
    stamped = ", stamped by a host" if report["clock"] == "host" else ""
    return f"{report['duration_s']:.3g} s at {report['rate_hz']:.4g} Hz{stamped}, {loss}"


def _faults(report: dict[str, Any], samples: SampleBatch) -> Iterator[str]:
    """What a user should know before trusting the recording, worst first."""
    if report["damage"]:
        more = len(report["damage"]) - 1
        yield report["damage"][0] + (f" (and {more} more)" if more else "")
    if useless := _useless(report):
        yield useless
    if report["samples"] == 0:
        return
    if report["samples"] < FEW:
        yield f"only {report['samples']} samples: nothing can be told of the craft"
    lost = report["lost_samples"]
    longest = max(report["gaps"], key=lambda gap: gap["duration_s"], default=None)
    if longest and lost > LOSS_TOLERATED * (lost + report["samples"]):
        share = 100 * lost / (lost + report["samples"])
        yield (
            f"{lost} samples lost ({share:.2g} %), gaps: {report['gap_count']}, "
            f"the longest {longest['duration_s']:.3g} s"
        )
    elif longest and longest["duration_s"] > GAP_TOLERATED_S:
        yield f"a gap of {longest['duration_s']:.3g} s at {longest['start_s']:.3f} s"
    if report["out_of_order"]:
        yield f"{report['out_of_order']} samples were out of order, and sorted"
    if report["row_copies"]:
        yield f"{report['row_copies']} rows were copies of others, and left out"
    if 0 < report["repeated_times"] <= STANDS * report["samples"]:
        yield f"{report['repeated_times']} samples repeat the time of the one before"
    if report["segments"] > 1:
        yield f"restarts of the device: {report['segments'] - 1}"
    if samples.tick_s == TICK_S and report["period_s"] != SAMPLE_PERIOD_S:
        yield f"a sample every {report['period_s'] * 1e3:.3g} ms where the telemetry has 2 ms"
    for channel, count in report["clipping"].items():
        yield f"{channel} at its limit in {count} samples"
    specific_force = np.linalg.norm(samples.accelerometer.astype(np.float64), axis=1)
    specific_force_g = specific_force[np.isfinite(specific_force)] / STANDARD_GRAVITY
    if len(specific_force_g):
        mean_g = float(specific_force_g.mean())
        if not 0.5 < mean_g < 2:
            yield f"the accelerometer's mean is {mean_g:.3g} g: check its unit"
    least_v = report["ranges"].get("battery", {}).get("min", LOW_BATTERY_V)
    if KINDS["battery_v"].low <= least_v < LOW_BATTERY_V:
        yield f"the battery went down to {least_v:.2f} V"


def _gaps(samples: SampleBatch, steps: RowSteps) -> list[dict[str, Any]]:
    """The longest gaps in order of time; ``start_s`` counts from the segment's first sample."""
    where = np.flatnonzero(steps.lost)
    if len(where) > GAPS_LISTED:
        where = np.sort(where[np.argsort(-steps.step_s[where], kind="stable")[:GAPS_LISTED]])
    gaps = []
    for step in where:
        row = steps.rows[step]
        first = int(np.searchsorted(samples.segment, samples.segment[row]))
        elapsed = int(samples.ticks[row] - samples.ticks[first])
        gaps.append(
            {
                "start_s": elapsed * samples.tick_s,
                "duration_s": float(steps.step_s[step]),
                "lost": int(steps.lost[step]),
                "segment": int(samples.segment[row]),
            }
        )
    return gaps


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
    counts = decode_all(raw)[1]
    return {
        "duplicates": counts.duplicates,
        "malformed": counts.malformed,
        "damaged": counts.damaged + counts.disagreeing,
    }


def _channels(
    samples: SampleBatch, renewed: Mapping[str, NDArray[np.intp]], period_s: float
) -> dict[str, Any]:
    """What each channel holds, how often it is renewed, and which there are none of."""
    ranges, known = ranges_of(samples)
    held = {name: rows_held(rows) for name, rows in renewed.items()}
    return {
        "clipping": _clipping(samples),
        "ranges": ranges,
        "missing_values": {
            name: len(samples) - count for name, count in known.items() if count < len(samples)
        },
        "renewed_hz": {
            name: 1 / (hold * period_s)
            for name, hold in held.items()
            if period_s > 0 and np.isfinite(hold)
        },
        "missing": [
            channel.name
            for channel in CHANNELS
            if channel.field != "duty_step" and not channel.is_in(samples)
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
