"""Frames of the USB bus as a clock, and how many of them nobody saw.

The bus counts milliseconds: frame k of a stream ends at ``offset + k ms``. A program sees a frame
at its end or later, so the lowest (time seen - k ms) is the offset. A stamp made from it is right
even when the program was blocked while the transfers filled.

A queue that ran dry leaves no error anywhere, only an offset that is whole milliseconds higher
afterwards: that number is the frames lost.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from groundstation.telemetry.packet import FRAME_NS

LEAK_NS = 200
"""Rise of the offset with each frame: the bus may be slower than the host's clock by 200 ppm."""
MARGIN_NS = 1_500_000
"""A queue that came this close to its end may have run dry."""
SETTLE_BLOCKS = 32


class FrameClock:
    """When frames ended, and how many are missing between those that were seen.

    lost: frames that passed without a transfer to hold them, as far as it is settled.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._frames = 0
        self._offset_ns: int | None = None
        self._before_ns: int | None = None
        self._blocks = 0
        self._breaks: deque[int] = deque()

    def anchor(self, frames: int, seen_ns: Sequence[int]) -> None:
        """Blocks of ``frames`` frames that ``see`` will be given next: the one that was looked at
        most promptly tells when all of them ended. A program is busy when a stream begins.
        """
        for number, seen in enumerate(seen_ns, 1):
            ahead = number * frames
            offset_ns = seen - (self._frames + ahead) * FRAME_NS + ahead * LEAK_NS
            self._offset_ns = min(
                offset_ns, offset_ns if self._offset_ns is None else self._offset_ns
            )

    def see(self, frames: int, seen_ns: int, queued: int) -> int:
        """The next ``frames`` frames were seen at ``seen_ns``; when the last of them ended (ns).

        queued: frames in transfers behind this one, at that moment: they hold what comes next.
        The result may be late, never early, and never after ``seen_ns``.
        """
        if self._breaks and self._frames >= self._breaks[0]:
            self.interrupt()
        self._frames += frames
        self._leak(frames)
        at_ns = self._frames * FRAME_NS
        offset_ns = seen_ns - at_ns
        self._offset_ns = offset_ns if self._offset_ns is None else min(offset_ns, self._offset_ns)
        self._blocks += 1
        if self._blocks >= SETTLE_BLOCKS:
            self.settle()
        if seen_ns > self._offset_ns + at_ns + queued * FRAME_NS - MARGIN_NS:
            self._breaks.append(self._frames + queued)
        return self._offset_ns + at_ns

    def skip(self, frames: int) -> None:
        """Frames that were received and dropped unread."""
        self._frames += frames
        self._leak(frames)

    def interrupt(self) -> None:
        """What comes next need not follow what came last."""
        while self._breaks and self._breaks[0] <= self._frames:
            self._breaks.popleft()
        if self._before_ns is None:
            self._before_ns = self._offset_ns
        self._offset_ns = None
        self._blocks = 0

    def settle(self) -> None:
        """Count what an interruption cost, with the frames seen since."""
        if self._before_ns is not None and self._offset_ns is not None:
            self.lost += max(0, round((self._offset_ns - self._before_ns) / FRAME_NS))
            self._before_ns = None

    def _leak(self, frames: int) -> None:
        rise = frames * LEAK_NS
        if self._offset_ns is not None:
            self._offset_ns += rise
        if self._before_ns is not None:
            self._before_ns += rise
