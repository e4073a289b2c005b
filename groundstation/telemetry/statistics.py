"""Link statistics: loss, bursts, duplicates, latency, jitter and clocks, apart and defined."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.decoder import Decoded, DecoderCounts
from groundstation.telemetry.samples import SampleBatch

CLOCK_SPAN_S = 20.0
"""The clocks are compared once this much device time has passed."""
ENVELOPE_WINDOWS = 30
"""Clocks drift apart by a tenth of a millisecond meanwhile."""
CLOCK_POINTS = 600
"""Windows remembered for comparing the clocks: ten minutes of one second."""


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
        if self._fastest is not None:
            self._clock.append(self._fastest)
        statistics = LinkStatistics(
            time_ns=now_ns,
            window_s=window_s,
            rate_hz=self._samples / window_s,
            packets_hz=packets / window_s,
            loss_pct=100.0 * lost / sent if sent else 0.0,
            copies=self._copies / self._samples if self._copies else None,
            latency_ms=_percentile(lateness_ms, 50),
            latency_p99_ms=_percentile(lateness_ms, 99),
            jitter_ms=_spread(lateness_ms),
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


def _percentile(values: NDArray[np.float64] | None, q: float) -> float | None:
    return None if values is None else float(np.percentile(values, q))


def _spread(values: NDArray[np.float64] | None) -> float | None:
    if values is None:
        return None
    low, high = np.percentile(values, [25, 75])
    return float(high - low)
