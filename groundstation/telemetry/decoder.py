"""From packets as received to samples (plausibility, deduplication, time), and a link's
statistics.
"""

from __future__ import annotations

import functools
import inspect
import math
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry import reassembly
from groundstation.telemetry.packet import PACKET_BYTES, Packets, encode
from groundstation.telemetry.samples import RawBatch, SampleBatch, samples_from_packets

# From packets as received to samples: plausibility, deduplication, time.
#
# ``Decoder`` is the only state between a link and everything else. It gives the same samples
# however the packets are cut into batches.


COMPILE_FROM = 4096
"""Recordings at least this large are worth the wait for the compiled kernel."""
CHUNK = 1 << 18
"""Packets handled at a time: bounds the memory of a bulk call."""
MOTOR_LOW_BITS = tuple(
    encode(0, 0, [[7, 7, 7, 7]], [[0] * 3], [[0] * 3], [[0] * 3], 0).view(np.uint64)[0, :2]
)
"""The three lowest bits of each motor in a packet's first two 64-bit words."""
BATTERY_MOST_MV = 6000
"""One lithium cell cannot show more: such a packet is not ours."""


@dataclass(frozen=True, slots=True)
class DecoderCounts:
    """Totals since the decoder was made.

    packets: arrived. malformed: not a telemetry packet (shifted or foreign bytes).
    samples: given out. lost: missing on the 2 ms grid (``reassembly.emit``; of a craft's own log
    ``LogRows._count``, of a file ``samples.row_steps``), in ``bursts``, the longest of
    ``longest_burst``. duplicates: further copies of samples that were given out. disagreeing:
    copies that contradicted the majority. damaged: packets whose stamp fits nowhere. late: arrived
    after a newer sample. slips: jumps of the grid without a restart. restarts: of the device.
    """

    packets: int = 0
    malformed: int = 0
    samples: int = 0
    lost: int = 0
    bursts: int = 0
    longest_burst: int = 0
    duplicates: int = 0
    disagreeing: int = 0
    damaged: int = 0
    late: int = 0
    slips: int = 0
    restarts: int = 0

    def as_dict(self) -> dict[str, int]:
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Decoded:
    """What one call gave: samples, and how late each was against the lower envelope (ns)."""

    samples: SampleBatch
    lateness_ns: NDArray[np.float64]


class Decoder:
    """Streaming decoder of one link.

    start_ticks: unwrapped device time of the first sample, where it is known.
    compiled: run the kernel compiled. Its first use in a process loads it, for seconds, and on
        a machine's first run compiles it: see ``compile_kernel``. A live link is served
        interpreted, with time to spare.
    """

    def __init__(self, start_ticks: int | None = None, *, compiled: bool = False) -> None:
        self._state = reassembly.new_state()
        if start_ticks is not None:
            self._state.n[reassembly.HINT] = start_ticks
        self._compiled = compiled
        self._origin_ns: int | None = None
        self._packets = 0
        self._malformed = 0
        self._samples = 0

    def decode(self, batch: RawBatch) -> Decoded:
        """Feed packets in order of arrival; samples that are complete come back.

        A sample is complete when one three periods newer has arrived (6 ms). After a gap that
        only the host's clock can measure, samples wait up to 250 ms.
        """
        if len(batch) <= CHUNK:
            return self._decode(batch.packets, batch.host_time_ns)
        parts = [
            self._decode(batch.packets[at : at + CHUNK], batch.host_time_ns[at : at + CHUNK])
            for at in range(0, len(batch), CHUNK)
        ]
        return Decoded(
            SampleBatch.concatenate([part.samples for part in parts]),
            np.concatenate([part.lateness_ns for part in parts]),
        )

    def idle(self, host_time_ns: int) -> Decoded:
        """Nothing has arrived up to ``host_time_ns``: give out what only waited for its turn."""
        now = host_time_ns - (self._origin_ns or 0)
        return self._run(lambda out: reassembly.idle(self._state, out, now), 0)

    def finish(self) -> Decoded:
        """The stream ends, or the link reconnects: give out everything."""
        return self._run(lambda out: reassembly.finish(self._state, out), 0)

    def reconnected(self) -> Decoded:
        """The link was closed and opened again: what follows is a new segment."""
        rest = self.finish()
        state = self._state
        if state.n[reassembly.MAIN]:
            state.n[reassembly.MAIN] = 0
            state.n[reassembly.FORCED] = 1
        return rest

    def counts(self) -> DecoderCounts:
        state, n = self._state, self._state.n
        slots = np.concatenate(
            [
                state.buffer[: n[reassembly.BUFFERED]],
                state.pending[: n[reassembly.PENDING]],
                state.orphans[: n[reassembly.ORPHANS]],
            ]
        )
        valid = np.arange(reassembly.VARIANTS) < state.variants[slots][:, None]
        waiting = int((state.votes[slots] * valid).sum())
        disagreed, damaged, late = (
            int(n[place]) for place in (reassembly.DISAGREED, reassembly.DAMAGED, reassembly.LATE)
        )
        settled = int(n[reassembly.COPIES]) - disagreed - damaged - late
        return DecoderCounts(
            packets=self._packets,
            malformed=self._malformed,
            samples=self._samples,
            lost=int(n[reassembly.LOST]),
            bursts=int(n[reassembly.BURSTS]),
            longest_burst=int(n[reassembly.LONGEST]),
            duplicates=max(0, settled - waiting - self._samples),
            disagreeing=disagreed,
            damaged=damaged,
            late=late,
            slips=int(n[reassembly.SLIPS]),
            restarts=int(n[reassembly.RESTARTS]),
        )

    def _decode(self, packets: Packets, host_time_ns: NDArray[np.int64]) -> Decoded:
        self._packets += len(packets)
        if len(packets) and self._origin_ns is None:
            self._origin_ns = int(host_time_ns[0])
        words = np.ascontiguousarray(packets, np.uint8).view(np.uint64).reshape(-1, 4)
        first = np.ones(len(words), np.bool_)
        first[1:] = (words[1:] != words[:-1]).any(axis=1)
        starts = np.flatnonzero(first)
        contents, host = words[starts], host_time_ns[starts] - (self._origin_ns or 0)
        ends = np.append(starts[1:], len(words))
        counts = ends - starts
        plausible = _is_plausible(contents)
        if not plausible.all():
            self._malformed += int(counts[~plausible].sum())
            contents, host, counts = contents[plausible], host[plausible], counts[plausible]
        stamps = (contents[:, 0] & np.uint64(0xFFFF)).astype(np.int64)
        reassemble = _compiled() if self._compiled else reassembly.reassemble
        return self._run(
            lambda out: reassemble(self._state, out, contents, stamps, counts, host), len(stamps)
        )

    def _run(self, step: Callable[[reassembly.Output], None], incoming: int) -> Decoded:
        n = self._state.n
        rows = (
            incoming
            + int(n[reassembly.PENDING] + n[reassembly.BUFFERED] + n[reassembly.ORPHANS])
            + 1
        )
        out = reassembly.Output(
            words=np.empty((rows, 4), np.uint64),
            ticks=np.empty(rows, np.int64),
            host=np.empty(rows, np.int64),
            segment=np.empty(rows, np.int64),
            copies=np.empty(rows, np.int64),
            lateness=np.empty(rows),
        )
        n[reassembly.OUT] = 0
        step(out)
        used = int(n[reassembly.OUT])
        self._samples += used
        samples = samples_from_packets(
            out.words[:used].view(np.uint8).reshape(used, PACKET_BYTES),
            ticks=out.ticks[:used],
            host_time_ns=out.host[:used] + (self._origin_ns or 0),
            segment=out.segment[:used].astype(np.int32),
            copies=out.copies[:used].astype(np.uint8),
        )
        return Decoded(samples, out.lateness[:used])


def decode_all(
    batch: RawBatch, start_ticks: int | None = None
) -> tuple[SampleBatch, DecoderCounts]:
    """Decode a whole recording's packets at once, compiled where that pays."""
    decoder = Decoder(start_ticks, compiled=len(batch) >= COMPILE_FROM)
    parts = [decoder.decode(batch).samples, decoder.finish().samples]
    return SampleBatch.concatenate(parts), decoder.counts()


def compile_kernel() -> None:
    """Have the compiled kernel ready: what its first use costs, at a time of one's choice.

    Takes seconds, on a machine's first run 10 to 20. May run in a thread.
    """
    nothing = RawBatch(np.zeros((0, PACKET_BYTES), np.uint8), np.zeros(0, np.int64))
    Decoder(compiled=True).decode(nothing)


def _is_plausible(words: NDArray[np.uint64]) -> NDArray[np.bool_]:
    """Whether each row of (n, 4) words, a packet's bytes, can be a telemetry packet at all.

    The packet has no checksum. Its twelve always-zero bits (motors are multiples of eight) and
    the battery's range refuse shifted or foreign bytes with odds of 45,000 to 1.
    """
    zero_bits = (words[:, 0] & MOTOR_LOW_BITS[0]) | (words[:, 1] & MOTOR_LOW_BITS[1])
    battery_mv = (words[:, 0] >> np.uint64(16)) & np.uint64(0xFFFF)
    return (zero_bits == 0) & (battery_mv <= BATTERY_MOST_MV) & words.any(axis=1)


@functools.cache
def _compiled() -> Callable[..., Any]:
    from numba.extending import register_jitable

    from groundstation.compiled import kernel

    for helper in vars(reassembly).values():
        if inspect.isfunction(helper) and helper.__module__ == reassembly.__name__:
            register_jitable(helper)
    compiled: Callable[..., Any] = kernel(reassembly.reassemble)
    return compiled


# Link statistics: loss, bursts, duplicates, latency, jitter and clocks, apart and defined.


CLOCK_SPAN_S = 20.0
"""The clocks are compared once this much device time has passed."""
ENVELOPE_WINDOWS = 30
"""Clocks drift apart by a tenth of a millisecond meanwhile."""
CLOCK_POINTS = 600
"""Windows remembered for comparing the clocks: ten minutes of one second."""
LATENESS = (25, 50, 75, 99)
"""Percentiles of a window's lateness."""


@dataclass(frozen=True, slots=True)
class LinkStatistics:
    """One window of a link (a second, usually), and totals since it was opened.

    Window:
    rate_hz: samples per second. packets_hz: packets per second, copies included.
    loss_pct: samples missing on the 2 ms grid, of those sent. copies: mean agreeing copies a
    sample. latency_ms, latency_p99_ms: median and 99th percentile of how much later packets
    were seen than the fastest one lately (the way itself cannot be measured from one end).
    jitter_ms: interquartile range of the same. None without samples in the window.

    Totals: as ``DecoderCounts``.

    clock_ppm: device clock against host clock, positive when the device is fast; None until
    20 s have passed.
    """

    time_ns: int
    window_s: float
    rate_hz: float
    packets_hz: float
    loss_pct: float
    copies: float | None
    latency_ms: float | None
    latency_p99_ms: float | None
    jitter_ms: float | None
    clock_ppm: float | None
    packets: int
    samples: int
    lost: int
    bursts: int
    longest_burst: int
    duplicates: int
    disagreeing: int
    damaged: int
    malformed: int
    late: int
    slips: int
    restarts: int

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    def gauges(self) -> dict[str, float]:
        """Every value that is known, as numbers: what a plot wants."""
        values = {key: value for key, value in asdict(self).items() if key != "time_ns"}
        return {key: float(value) for key, value in values.items() if value is not None}


class LinkMeter:
    """Accumulates what the decoder gives and closes a window on demand."""

    def __init__(self, start_ns: int) -> None:
        self._window_start_ns = start_ns
        self._lateness: list[NDArray[np.float64]] = []
        self._copies = 0
        self._samples = 0
        self._before: DecoderCounts | None = None
        self._segment = -1
        self._clock: deque[tuple[float, float]] = deque(maxlen=CLOCK_POINTS)
        self._fastest: tuple[float, float] | None = None

    def add(self, decoded: Decoded) -> None:
        """Take in one call's samples."""
        samples = decoded.samples
        if len(samples) == 0:
            return
        self._lateness.append(decoded.lateness_ns)
        self._copies += int(samples.copies.sum(dtype=np.int64))
        self._samples += len(samples)
        self._watch_clock(samples)

    def add_samples(self, samples: SampleBatch, *, live: bool) -> None:
        """Samples of a source without packets. live: host stamps are when they came, so lateness
        can be told: against the fastest of the last ``ENVELOPE_WINDOWS`` windows."""
        self._samples += len(samples)
        if not live or len(samples) == 0:
            return
        self._watch_clock(samples)
        assert self._fastest is not None
        recent = [offset for _, offset in list(self._clock)[-ENVELOPE_WINDOWS:]]
        offset_s = samples.host_time_ns * 1e-9 - samples.time_s
        late_s = offset_s - min([self._fastest[1], *recent])
        self._lateness.append(1e9 * np.maximum(late_s, 0.0))

    def _watch_clock(self, samples: SampleBatch) -> None:
        if int(samples.segment[-1]) != self._segment:
            self._segment = int(samples.segment[-1])
            self._clock.clear()
            self._fastest = None
        time_s = samples.time_s
        offset_s = (samples.host_time_ns - self._window_start_ns) * 1e-9 - time_s
        best = int(np.argmin(offset_s))
        absolute = float(offset_s[best]) + self._window_start_ns * 1e-9
        if self._fastest is None or absolute < self._fastest[1]:
            self._fastest = (float(time_s[best]), absolute)

    def close_window(self, now_ns: int, counts: DecoderCounts) -> LinkStatistics:
        """Statistics since the last call; ``counts`` are the decoder's totals now."""
        window_s = max((now_ns - self._window_start_ns) * 1e-9, 1e-9)
        before = self._before
        lost = counts.lost - (before.lost if before else 0)
        packets = counts.packets - (before.packets if before else 0)
        sent = self._samples + lost
        lateness_ms = np.concatenate(self._lateness) * 1e-6 if self._lateness else None
        late = (None,) * 4 if lateness_ms is None else np.percentile(lateness_ms, LATENESS).tolist()
        low_ms, median_ms, high_ms, most_ms = late
        if self._fastest is not None:
            self._clock.append(self._fastest)
        statistics = LinkStatistics(
            time_ns=now_ns,
            window_s=window_s,
            rate_hz=self._samples / window_s,
            packets_hz=packets / window_s,
            loss_pct=100.0 * lost / sent if sent else 0.0,
            copies=self._copies / self._samples if self._copies else None,
            latency_ms=median_ms,
            latency_p99_ms=most_ms,
            jitter_ms=None if low_ms is None else high_ms - low_ms,
            clock_ppm=self._clock_ppm(),
            **counts.as_dict(),
        )
        self._window_start_ns = now_ns
        self._before = counts
        self._lateness = []
        self._copies = self._samples = 0
        self._fastest = None
        return statistics

    def _clock_ppm(self) -> float | None:
        """Slope of the fastest arrivals' offset (host minus device) over device time."""
        if len(self._clock) < 3 or self._clock[-1][0] - self._clock[0][0] < CLOCK_SPAN_S:
            return None
        points = np.array(self._clock)
        time_s, offset_s = (points - points[0]).T
        slope = float(np.polyfit(time_s, offset_s, 1)[0])
        return -slope * 1e6 if math.isfinite(slope) else None
