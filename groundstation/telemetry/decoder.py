"""From packets as received to samples: plausibility, deduplication, time.

``Decoder`` is the only state between a link and everything else. It gives the same samples
however the packets are cut into batches.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry import copies, device_time, main_chain, pending_chain, silence
from groundstation.telemetry import reassembly as kernel
from groundstation.telemetry import reassembly_state as layout
from groundstation.telemetry.packet import PACKET_BYTES, Packets, encode
from groundstation.telemetry.samples import RawBatch, SampleBatch, samples_from_packets

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
    samples: given out. lost: missing on the 2 ms grid, in ``bursts`` bursts, the longest
    ``longest_burst`` samples. duplicates: further copies of samples that were given out.
    disagreeing: copies whose content contradicted the majority. damaged: packets whose stamp
    fits nowhere. late: arrived after a newer sample had been given out. slips: jumps of the
    grid without a restart. restarts: restarts of the device.
    """

    packets: int
    malformed: int
    samples: int
    lost: int
    bursts: int
    longest_burst: int
    duplicates: int
    disagreeing: int
    damaged: int
    late: int
    slips: int
    restarts: int

    def as_dict(self) -> dict[str, int]:
        return {f.name: getattr(self, f.name) for f in fields(self)}


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
        self._state = layout.new_state()
        if start_ticks is not None:
            self._state.n[layout.HINT] = start_ticks
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
        return self._run(lambda out: kernel.idle(self._state, out, now), 0)

    def finish(self) -> Decoded:
        """The stream ends, or the link reconnects: give out everything."""
        return self._run(lambda out: kernel.finish(self._state, out), 0)

    def reconnected(self) -> Decoded:
        """The link was closed and opened again: what follows is a new segment."""
        rest = self.finish()
        state = self._state
        if state.n[layout.MAIN]:
            state.n[layout.MAIN] = 0
            state.n[layout.FORCED] = 1
        return rest

    def counts(self) -> DecoderCounts:
        n = self._state.n
        settled = int(n[layout.COPIES] - n[layout.DISAGREED] - n[layout.DAMAGED] - n[layout.LATE])
        waiting = self._waiting_copies()
        return DecoderCounts(
            packets=self._packets,
            malformed=self._malformed,
            samples=self._samples,
            lost=int(n[layout.LOST]),
            bursts=int(n[layout.BURSTS]),
            longest_burst=int(n[layout.LONGEST]),
            duplicates=max(0, settled - waiting - self._samples),
            disagreeing=int(n[layout.DISAGREED]),
            damaged=int(n[layout.DAMAGED]),
            late=int(n[layout.LATE]),
            slips=int(n[layout.SLIPS]),
            restarts=int(n[layout.RESTARTS]),
        )

    def _waiting_copies(self) -> int:
        state = self._state
        slots = np.concatenate(
            [
                state.buffer[: state.n[layout.BUFFERED]],
                state.pending[: state.n[layout.PENDING]],
                state.orphans[: state.n[layout.ORPHANS]],
            ]
        )
        valid = np.arange(layout.VARIANTS) < state.variants[slots][:, None]
        return int((state.votes[slots] * valid).sum())

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
        reassemble = _compiled() if self._compiled else kernel.reassemble
        return self._run(
            lambda out: reassemble(self._state, out, contents, stamps, counts, host), len(stamps)
        )

    def _run(self, step: Callable[[layout.Output], None], incoming: int) -> Decoded:
        n = self._state.n
        rows = incoming + int(n[layout.PENDING] + n[layout.BUFFERED] + n[layout.ORPHANS]) + 1
        out = layout.Output(
            words=np.empty((rows, 4), np.uint64),
            ticks=np.empty(rows, np.int64),
            host=np.empty(rows, np.int64),
            segment=np.empty(rows, np.int64),
            copies=np.empty(rows, np.int64),
            lateness=np.empty(rows),
        )
        n[layout.OUT] = 0
        step(out)
        used = int(n[layout.OUT])
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

    from groundstation.compiled import kernel as compile_entry

    for module in (copies, device_time, main_chain, pending_chain, silence, kernel, layout):
        for helper in vars(module).values():
            if inspect.isfunction(helper) and helper.__module__ == module.__name__:
                register_jitable(helper)
    compiled: Callable[..., Any] = compile_entry(kernel.reassemble)
    return compiled
