"""When a disagreement is more than chance: a sequential test for every regime and channel.

Each block of half a second gives each signal a score: the innovations' projection on what that
disturbance would make of them, in standard deviations of the noise. Summed over the last 1 to 20
seconds, weighted by what each block could show, the scores are standard normal where the model
is right, whatever is flown; a sum beyond ``LIMIT`` in any window is an event. A block counts for
at most ``MOST``, so that one blow is none; what a flight's first seconds cannot tell (the noise)
is waited for, and nothing of them is lost.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.arrays import Array
from groundstation.twin.rolling import Block
from groundstation.twin.signals import KINDS, SHARED, Place

LIMIT = 7.0
"""Standard deviations. Chance: see docs/twin.md for the rate that was measured."""
RETURNED = 0.5
"""Share of the limit below which the sums must stay for the disagreement to be over."""
WINDOWS = (2, 4, 10, 20, 40)
"""Blocks that are summed."""
MOST = 4.0
"""Standard deviations that one block can count for."""
HOLD = 2
"""Blocks between the first sign and the event: the strongest place by then is named."""
NAMED = 0.6
"""Share of a family's largest sum from which a signal can be the one that is named: of those, the
one that explains most when blocks count in full and nothing is taken off."""
FLOOR_BLOCKS = 6
"""Whole blocks in flight that the noise is judged from at first."""
MEMORY_BLOCKS = 60
LANDED_BLOCKS = 6
"""Without settled flight for so long, a flight has ended."""
LEAST_WINDOWS = 10
"""Of the 31 in a block, that must be in settled flight."""
CLEAR = 1e-3
"""A signal of which the shared ones explain all but this share says nothing of its own."""
SPREAD = 0.4549
"""Median of a squared standard normal number."""

FAMILIES = {
    "gyro_x": "roll",
    "roll": "roll",
    "gyro_y": "pitch",
    "pitch": "pitch",
    "gyro_z": "yaw",
    "yaw": "yaw",
    "accelerometer_x": "accelerometer_x",
    "accelerometer_y": "accelerometer_y",
    "accelerometer_z": "accelerometer_z",
}
"""An angle and its rate disagree together: one event."""


@dataclass(frozen=True, slots=True)
class Episode:
    """A disagreement. statistic: the largest sum of scores so far, in standard deviations.
    begin_s: start of the stretch that tells of it; noticed_s: when it was more than chance;
    end_s: when it was over, None while it lasts. Device time."""

    place: Place
    statistic: float
    begin_s: float
    noticed_s: float
    segment: int
    host_ns: int
    end_s: float | None = None
    why: str = ""


@dataclass
class _Open:
    """What is known of a family whose sums are, or were lately, beyond the limit."""

    kind: int
    statistic: float
    begin_s: float
    needed: float
    waited: int = 0
    told: Episode | None = None
    quiet: float = 0.0


@dataclass
class _Past:
    """One block's part of every sum: pull (s,), its variance energy (s,), and with the shared
    signals meant, mixed (m, s)."""

    first_s: float
    pull: Array
    energy: Array
    meant: Array
    mixed: Array


class Judge:
    """Watches blocks; tells of disagreements that begin and end.

    allowances: standard deviation (len(KINDS),) of what a good model leaves of each signal.
    """

    def __init__(self, allowances: Array, limit: float = LIMIT) -> None:
        self._limit = limit
        self._own = np.square(allowances)
        self._own[list(SHARED)] = 0.0
        self._allowed = np.square(allowances[list(SHARED)])
        self._doubt = np.diag(1.0 / self._allowed)
        self._squares: deque[Array] = deque(maxlen=MEMORY_BLOCKS)
        self._waiting: list[Block] = []
        self._past: deque[_Past] = deque(maxlen=MEMORY_BLOCKS)
        # of the shared signals with all, summed over each window
        self._meant = np.zeros((len(WINDOWS), len(SHARED), len(KINDS)))
        self._mixed = np.zeros_like(self._meant)
        self._open: dict[str, _Open] = {}
        self._away = 0  # blocks without a window
        self._until = (0.0, 0)  # device time and arrival of the last row judged
        self.floor: Array | None = None
        """Variance (9,) of the innovations, None until it is known."""

    def take(self, block: Block) -> list[Episode]:
        """Episodes that this block begins (``end_s`` None) or ends."""
        told: list[Episode] = []
        if block.begins:
            told += self.interrupt("the flight was interrupted")
        self._away = 0 if block.windows else self._away + 1
        if self._away == LANDED_BLOCKS:
            told += self.interrupt("the flight has ended")
        if block.windows < LEAST_WINDOWS or not _is_finite(block):
            return told
        self._until = (block.last_s, block.host_ns)
        self._squares.append(block.square)
        if len(self._squares) < FLOOR_BLOCKS:
            self._waiting.append(block)
            return told
        self.floor = np.nanmedian(np.stack(self._squares), axis=0)
        for each in (*self._waiting, block):
            told += self._judge(each)
        self._waiting = []
        return told

    def interrupt(self, why: str) -> list[Episode]:
        """Nothing after this belongs to what came before: landing, restart, silence."""
        ended = [
            self._ended(one, self._until[0], self._until[1], why)
            for one in self._open.values()
            if one.told is not None
        ]
        self._open, self._waiting = {}, []
        self._past.clear()
        self._meant[:], self._mixed[:] = 0.0, 0.0
        return ended

    @property
    def episodes(self) -> list[Episode]:
        """Those that last."""
        return [one.told for one in self._open.values() if one.told is not None]

    def _judge(self, block: Block) -> list[Episode]:
        assert self.floor is not None
        weight = 1.0 / self.floor
        meant, mixed = (np.einsum("c,cms->ms", weight, each) for each in (block.meant, block.mixed))
        self._past.append(
            _Past(block.first_s, weight @ block.total, weight @ block.energy, meant, mixed)
        )
        for k, count in enumerate(WINDOWS):
            self._meant[k] += meant
            self._mixed[k] += mixed
            if count < len(self._past):
                self._meant[k] -= self._past[-1 - count].meant
                self._mixed[k] -= self._past[-1 - count].mixed
        sums, whole, windows = self._sums()
        told = []
        families = np.array([FAMILIES[kind.place.channel] for kind in KINDS])
        for family in dict.fromkeys(families.tolist()):
            mine = np.flatnonzero(families == family)
            clear = np.abs(sums[mine]) >= NAMED * np.abs(sums[mine]).max()
            best = int(mine[np.argmax(np.where(clear, np.abs(whole[mine]), -1.0))])
            episode = self._follow(
                family,
                best,
                float(np.abs(sums[mine]).max()),
                float(max(abs(whole[best]), abs(sums[best]))),
                int(windows[best]),
                block,
            )
            if episode is not None:
                told.append(episode)
        return told

    def _sums(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """(largest sum (s,), the same with blocks at their full weight and nothing taken off,
        blocks it is over (s,)).

        What the shared signals may hold is marginalised: a signal's sum is taken of what they,
        within their allowances, cannot explain.
        """
        pull = np.stack([one.pull for one in self._past])
        energy = np.stack([one.energy for one in self._past])
        spread = _spread(pull, energy)
        most = MOST * np.sqrt(spread * energy)
        clipped = np.clip(pull, -most, most)
        used = [k for k, count in enumerate(WINDOWS) if count <= len(pull) or k == 0]
        meant, mixed = self._meant[used], self._mixed[used]  # (windows, m, s)
        counts = [WINDOWS[k] for k in used]
        total, plain, known = (
            np.stack([each[-count:].sum(axis=0) for count in counts])
            for each in (clipped, pull, energy)
        )
        shared = list(SHARED)
        # c (windows, m, s): so much of each shared signal's own sum is taken off a signal's.
        own = meant[:, :, shared] + self._doubt
        c = np.linalg.solve(own.transpose(0, 2, 1), meant)
        c[:, np.arange(len(shared))[:, None], shared] *= 1.0 - np.eye(len(shared))
        value = total - (total[:, None, shared] @ c)[:, 0]
        left = meant - meant[:, :, shared] @ c
        noise = known + np.sum(c * (mixed[:, :, shared] @ c - 2.0 * mixed), axis=1)
        size = spread * noise + self._allowed @ np.square(left) + self._own * noise**2
        clear = noise > CLEAR * known
        value = np.where(clear, value / np.sqrt(np.where(clear, size, 1.0)), 0.0)
        whole = plain / np.sqrt(spread * np.where(known > 0.0, known, 1.0))
        best = np.argmax(np.abs(value), axis=0)
        each = np.arange(len(KINDS))
        return value[best, each], whole[best, each], np.array(counts)[best]

    def _follow(
        self, family: str, kind: int, value: float, whole: float, window: int, block: Block
    ) -> Episode | None:
        """What there is to tell of a family after a block."""
        one = self._open.get(family)
        if one is None:
            if value > self._limit:
                first = self._past[max(len(self._past) - window, 0)].first_s
                self._open[family] = _Open(kind, whole, first, self._shown(kind, window))
            return None
        if whole > one.statistic:
            one.statistic = whole
            if one.told is None:
                one.kind = kind
        if one.told is None:
            one.waited += 1
            if one.waited < HOLD:
                return None
            if value < RETURNED * self._limit:
                del self._open[family]
                return None
            one.told = Episode(
                KINDS[one.kind].place,
                one.statistic,
                one.begin_s,
                block.last_s,
                block.segment,
                block.host_ns,
            )
            return one.told
        if value >= RETURNED * self._limit:
            one.quiet = 0.0
            return None
        # Over only when as much was flown without it as it took to notice it.
        one.quiet += float(self._past[-1].energy[one.kind])
        if one.quiet < one.needed:
            return None
        del self._open[family]
        return self._ended(one, block.last_s, block.host_ns, "the model predicts it again")

    def _shown(self, kind: int, window: int) -> float:
        parts = list(self._past)[-window:]
        return float(sum(part.energy[kind] for part in parts))

    def _ended(self, one: _Open, end_s: float, host_ns: int, why: str) -> Episode:
        told = one.told
        assert told is not None
        return Episode(
            told.place,
            one.statistic,
            told.begin_s,
            told.noticed_s,
            told.segment,
            host_ns,
            end_s,
            why,
        )


def _is_finite(block: Block) -> bool:
    """A number that is none would stay in every sum."""
    parts = (block.square, block.total, block.energy, block.meant, block.mixed)
    return all(bool(np.isfinite(each).all()) for each in parts)


def _spread(pull: Array, energy: Array) -> Array:
    """Variance (s,) of the scores of blocks around their own mean effect, at least 1."""
    if len(pull) < FLOOR_BLOCKS:
        return np.ones(pull.shape[1])
    known = energy.sum(axis=0)
    size = pull.sum(axis=0) / np.where(known > 0.0, known, 1.0)
    left = (pull - size * energy) ** 2 / np.where(energy > 0.0, energy, np.inf)
    return np.maximum(np.median(left, axis=0) / SPREAD, 1.0)
