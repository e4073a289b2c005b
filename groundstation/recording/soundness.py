"""Which samples are believed: the one judgement of them, for ``inspect`` and for every later step.

What a channel cannot hold, what was extrapolated there, and what a dead sensor repeats is rejected:
``inspect`` tells it, and whatever analyses a recording takes it as missing (``sound``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.recording.channels import CHANNELS, Channel
from groundstation.recording.column_map import UNCLEAR_METADATA
from groundstation.recording.no_value import sentinels, standing
from groundstation.recording.plausibility import BARELY, KINDS, Kind
from groundstation.recording.session import Recording
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import OVERDRIVEN, SampleBatch, renewals, spans

Mask = NDArray[np.bool_]

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
    """rows: samples of a field that are not believed, (n, k) for its k channels or (n,); none where
    it is told only. words: why, for people."""

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
        values[one.rows] = np.nan
        samples = replace(samples, **{one.field: values})
    return samples


def _no_value(samples: SampleBatch, field: str) -> Iterator[Rejection]:
    """Numbers that stand for none, and an attitude that stands while the craft turns."""
    for rows, words in sentinels(samples, field):
        every = np.repeat(rows[:, None], _table(samples, field).shape[1], axis=1)
        yield Rejection(field, _shaped(samples, field, every), words)
    if field == "attitude" and (stands := standing(samples)) is not None:
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
        _shaped(samples, field, rows),
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


def _shaped(samples: SampleBatch, field: str, rows: Mask) -> Mask:
    """Rows (n, k) in the shape of the field."""
    return rows.reshape(getattr(samples, field).shape)
