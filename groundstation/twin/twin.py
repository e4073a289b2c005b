"""The live model check: rolling predictions, alarms, and what is told of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.gap import HORIZONS_S
from groundstation.dynamics.model import Model, model_vehicle, require_body
from groundstation.dynamics.sensors import sensors_of_model
from groundstation.errors import BadInputError
from groundstation.prediction.drive import LANDED, TURNING, Drive, drive_run, fresh_rows
from groundstation.prediction.observer import Gains, Noise, gains_of, integrating_force
from groundstation.prediction.prediction import SETTLE_S, fly_ahead, noise_of, observe_part
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S, STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch, empty_samples
from groundstation.twin.signals import (
    KINDS,
    RHYTHM_ROWS,
    SHARED,
    Memory,
    Piece,
    Place,
    Rows,
    allowances,
    drives,
    entries,
    period_of,
    unbroken,
)

# The rolling predictor: samples in, in pieces of any size; predictions and their errors out.
#
# Every half second the observer goes on over the rows that have come (``observe_part``), the model
# flies 20 and 50 ms ahead from them on the recorded inputs (``fly_ahead``), and the innovations are
# correlated with what each kind of disturbance would make of them. Live and fast time run through
# this same code: what comes out does not depend on how the samples were cut.


Mask = NDArray[np.bool_]

BLOCK_S = 0.5
HISTORY_S = 1.0
"""Rows before a block that its motors start from: they forget a wrong start in half of it."""
AFTER_S = 0.6
"""A row is judged when so much has come after it: motors that stop meanwhile say that it may
have been a landing."""
STRIDE_S = 0.01
LEAST_ROWS = 50
"""New attitudes from which a block's variance is told."""
MOSTLY = 0.7
"""Share of a block in settled flight where the noise is learnt."""
LEARN_S = (3.0, 12.0)
"""Settled flight from which the noise is learnt, and learnt again; nothing is judged before."""
LIFT_OFF_S = 0.3
"""Left out after a take-off."""
LOST_S = 0.05
"""Left out after lost rows: what drove the motors meanwhile was not known."""
STILL_S, STILL_RATE = 0.2, 0.012
"""A craft whose rates (rad/s) stay below this for so long lies on something."""


@dataclass(frozen=True, slots=True)
class Block:
    """Half a second of a stretch.

    begins: the first after a silence, a restart or a take-off: nothing before belongs to it.
    first_s, last_s: device time; segment: of the device; host_ns: of its last row.
    square: (9,) variance of the innovations at low frequency, from ``windows``; NaN without.
    total, energy: (9, len(KINDS)), meant, mixed: (9, len(SHARED), len(KINDS)), see
    ``kernels.score``.
    time_s: (m,) of the rows that were predicted; measured, predicted: (m, 9) there, the latter
    from the longest of ``HORIZONS_S`` before, NaN on the ground. error: (horizons, 9) mean squared
    prediction errors in settled flight. step: (9,) variance of the innovations there. leaves:
    (horizons, 9, 9) mean squared errors by channel that white innovations of unit variance in
    each would leave.
    """

    begins: bool
    first_s: float
    last_s: float
    segment: int
    host_ns: int
    square: Array
    windows: int
    total: Array
    energy: Array
    meant: Array
    mixed: Array
    time_s: Array
    measured: Array
    predicted: Array
    error: Array
    step: Array
    leaves: Array


class Rolling:
    """A model beside a stream. Raises BadInputError for a model that cannot fly."""

    def __init__(self, model: Model) -> None:
        gains_of(model, 0.002)  # a model that cannot fly says so now
        self.model = model
        self._lean = bool(sensors_of_model(model)[0]["gains"][0] > 0.0)
        self._configuration = model_vehicle(model).configuration
        self.noise: Noise | None = None
        self._last: SampleBatch | None = None
        self._early: list[SampleBatch] = []
        self._stretch: _Stretch | None = None

    def feed(self, samples: SampleBatch) -> Iterator[Block]:
        """Every block that is complete with these samples.

        Raises BadInputError where they lack what a model needs or are not inertial telemetry.
        """
        if not len(samples):
            return
        for new, part in unbroken(samples, self._last):
            if new:
                self._stretch, self._early = None, []
            self._last = part[-1:]
            if self._stretch is None:
                self._early.append(part)
                early = SampleBatch.concatenate(self._early)
                if len(early) < RHYTHM_ROWS:
                    continue
                _require_inputs(early)
                rows = Rows(period_of(early), early.tick_s)
                self._stretch = _Stretch(self, rows, int(early.segment[0]))
                part, self._early = early, []
            self._stretch.rows.append(part)
            yield from self._stretch.blocks()


class _OpenPredictions:
    """The windows of ``kernels.score`` that are open, and the errors behind them."""

    def __init__(self, errors: int) -> None:
        from groundstation.twin.kernels import POLES

        self.place = 0
        self.error = np.zeros((errors, len(KINDS)))
        self.bad = np.ones(2, np.int64)
        self.felt = np.zeros((2, 9))
        self.smooth = np.zeros((POLES, 9, len(KINDS)))


class _Stretch:
    """What goes on from block to block."""

    def __init__(self, owner: Rolling, rows: Rows, segment: int) -> None:
        period = rows.period_s
        self.rows = rows
        self._owner = owner
        self._segment = segment
        self._horizons = np.array([round(each / period) for each in HORIZONS_S])
        self._block, self._history, self._after, self._stride = (
            round(seconds / period) for seconds in (BLOCK_S, HISTORY_S, AFTER_S, STRIDE_S)
        )
        self._learn = [] if owner.noise is not None else [round(each / period) for each in LEARN_S]
        self._tuned = False
        self._steady = 0  # rows of settled flight without a break
        self._set_gains(owner.noise)
        self._enters, self._seen_at = entries(period, owner._lean, len(self._advance))
        self._done = 0  # observed up to this row
        self._carry: Array | None = None
        self._open = _OpenPredictions(len(self._advance))
        self._memory = Memory()
        self._flying: bool | None = None  # at row ``done``; None: not known yet
        self._settled_from = round((SETTLE_S + HISTORY_S) / period)
        self._lifted = round(-1e4 / period)  # row of the last take-off that was seen
        self._known_from = 0  # rows since the last that were lost
        self._begins = True

    def blocks(self) -> Iterator[Block]:
        while self.rows.count > self._done + self._block + self._after:
            yield self._next()

    def _next(self) -> Block:
        done, count = self._done, self._block
        start = max(done - self._history, 0)
        window = self.rows.piece(start, done + count + self._after + 1)
        drive = drive_run(self._owner.model, window).since(done - start)
        fresh = fresh_rows(window.attitude)[done - start :]
        piece = window.since(done - start)
        flying, judged = self._flown(piece, drive)
        height = np.where(flying, np.inf, 0.0)
        seen, self._carry = observe_part(
            piece, drive, self._gains, flying, fresh, height_m=height, carry=self._carry
        )
        rows = np.arange(done, done + count + 1)
        since_lift = np.asarray((rows - self._lifted) * self.rows.period_s, np.float64)
        driven = drives(seen, self._owner._configuration, since_lift, self._memory)
        square, scores = self._score(
            driven, seen.innovations[1:], fresh[1 : count + 1], flying, judged
        )
        starts = np.arange(0, count, self._stride)
        ahead = fly_ahead(piece, seen, starts, self._horizons)
        errors = ahead.errors(piece)
        good = judged[starts]
        mean = np.full((len(self._horizons), 9), np.nan)
        known = np.isfinite(errors[good]).all(axis=(1, 2))
        if known.any():
            mean = np.mean(np.square(errors[good][known]), axis=0)
        targets = starts + int(self._horizons[-1])
        step = np.full(9, np.nan)
        new = judged & fresh[1 : count + 1]
        if new.sum() > LEAST_ROWS:
            step[:6] = np.var(seen.innovations[1:][judged, :6], axis=0)
            step[6:] = np.var(seen.innovations[1:][new, 6:], axis=0)
        time_s = self.rows.time_s(done, done + count + int(self._horizons[-1]) + 1)
        block = Block(
            self._begins,
            float(time_s[0]),
            float(time_s[count]),
            self._segment,
            self.rows.host_ns(done + count),
            square[:9] / square[9] if square[9] else np.full(9, np.nan),
            int(square[9]),
            *scores,
            time_s[targets],
            np.hstack([piece.gyro[targets], piece.accelerometer[targets], piece.attitude[targets]]),
            np.where(
                flying[starts, None],
                np.hstack([ahead.gyro[:, -1], ahead.accelerometer[:, -1], ahead.attitude[:, -1]]),
                np.nan,
            ),
            mean,
            step,
            self._expected,
        )
        self._begins = False
        self._done = done + count
        self._tune()
        self.rows.forget(self._done - max([self._history, *self._learn]))
        return block

    def _score(
        self, signals: Array, innovations: Array, fresh: Mask, flying: Mask, judged: Mask
    ) -> tuple[Array, tuple[Array, Array, Array, Array]]:
        """See ``kernels.score``: square, (total, energy, meant, mixed)."""
        from groundstation.twin.kernels import WINDOW_ROWS, score

        square, two, three = np.zeros(10), (9, len(KINDS)), (9, len(SHARED), len(KINDS))
        scores = np.zeros(two), np.zeros(two), np.zeros(three), np.zeros(three)
        if not flying[1:].any():
            self._open = _OpenPredictions(len(self._advance))
            return square, scores
        one = self._open
        one.place = score(
            np.ascontiguousarray(np.where(flying[1:, None], signals, 0.0)),
            self._enters,
            self._seen_at,
            self._advance,
            self._shown,
            self._gains.fresh,
            self._gains.stale,
            np.ascontiguousarray(fresh),
            judged & self._tuned,
            np.ascontiguousarray(innovations),
            one.error,
            one.smooth,
            one.place,
            one.bad,
            one.felt,
            np.array(SHARED),
            square,
            *scores,
        )
        share = np.array([1.0] * 6 + [float(fresh.mean())] * 3)
        square[:9] /= WINDOW_ROWS * share
        return square, scores

    def _tune(self) -> None:
        """Gains that suit the craft's vibration and the air, once seconds of flight can tell."""
        if not self._learn or self._steady < self._learn[0]:
            return
        first = self._done - self._learn.pop(0)
        noise = noise_of(self._owner.model, self.rows.piece(first, self._done))
        if not self._learn:  # for the flights that follow
            self._owner.noise = noise
        self._set_gains(noise)

    def _set_gains(self, noise: Noise | None) -> None:
        period, lean = self.rows.period_s, self._owner._lean
        self._gains = gains_of(self._owner.model, period, noise)
        self._advance, self._shown = _error_dynamics(self._gains, period, lean)
        self._expected = _expected(
            self._gains, self._advance, self._shown, self._horizons, period, lean
        )
        self._tuned = noise is not None

    def _flown(self, piece: Piece, drive: Drive) -> tuple[Mask, Mask]:
        """(in the air (block + 1,), judged (block,): rows 1 to the end of the block)."""
        count, period = self._block, piece.period_s
        one = drive.craft[0]
        lift, low_lift = (drive.push[::2, i] / one["gravity"] for i in (0, 1))
        turning = np.asarray(
            (piece.duty > TURNING).any(axis=1)
        )  # one may rest for a moment in a yaw step
        carried = _later(lift > LANDED, self._after)  # thrust is not gone for good
        flying = np.zeros(count + 1, np.bool_)
        known = np.asarray(np.isfinite(np.hstack([piece.gyro, piece.accelerometer])).all(axis=1))
        settled = np.zeros(count + 1, np.bool_)
        now = self._flying
        if now is None:
            now = bool(turning[0] and lift[0] > LANDED)
        for row in range(count + 1):
            if not (turning[row] and carried[row]):
                now = False
            elif not now and low_lift[row] > 1.0:
                now = True
                self._lifted = self._done + row
                self._settled_from = self._lifted + round(LIFT_OFF_S / period)
                self._begins = True
            flying[row] = now
            if not known[row]:
                self._known_from = self._done + row + round(LOST_S / period)
            settled[row] = self._done + row >= self._settled_from
            known[row] &= self._done + row >= self._known_from
        self._flying = now
        stays = ~_later(~turning, self._after)[: count + 1]
        quick = np.abs(piece.gyro).max(axis=1) > STILL_RATE
        moves = _later(quick, round(STILL_S / period))[: count + 1]
        settled &= flying & stays & moves
        self._steady = self._steady + count if settled[1:].mean() > MOSTLY else 0
        return flying, np.ascontiguousarray((settled & known[: count + 1])[1:])


def _later(mask: Mask, rows: int) -> Mask:
    """Rows at which, or at most ``rows`` after which, the mask holds."""
    count = np.concatenate([[0], np.cumsum(mask)])
    last = np.minimum(np.arange(len(mask)) + rows + 1, len(mask))
    return count[last] > count[: len(mask)]


def _error_dynamics(gains: Gains, period_s: float, lean: bool) -> tuple[Array, Array]:
    """((e, e) the observer's error over a row, (12, e) what is measured of it)."""
    advance = integrating_force(gains.transition, period_s, STANDARD_GRAVITY)
    shown = gains.shown.copy()
    if lean:
        shown[6:9] = 0.0  # the report follows the filter, not the attitude
    return advance, shown


def _expected(
    gains: Gains,
    advance: Array,
    shown: Array,
    horizons: NDArray[np.int64],
    period_s: float,
    lean: bool,
) -> Array:
    """(horizons, 9, 9): mean squared prediction error by channel that white innovations of unit
    variance in each channel leave."""
    found = np.zeros((len(horizons), 9, 9))
    reached = gains.fresh[:, :9].copy()
    turned = period_s * np.eye(9)[:3]  # a firmware's filter adds up what the gyro shows
    total = np.eye(9)
    for ahead in range(1, int(horizons[-1]) + 1):
        if lean:
            total[6:] = total[6:] if ahead > 1 else 0.0
            total[6:] += np.square(turned)
        for place in np.flatnonzero(horizons == ahead):
            found[place] = total
        step = (shown @ advance @ reached)[:9]
        turned = turned + period_s * step[:3]
        if lean:
            step[6:] = 0.0
        total = total + np.square(step)
        reached = advance @ reached
    return found


def _require_inputs(samples: SampleBatch) -> None:
    channels = {"duty": "motors", "battery_v": "battery voltage"}
    channels |= {name: name for name in ("gyro", "accelerometer", "attitude")}
    lacking = [what for name, what in channels.items() if np.isnan(getattr(samples, name)).all()]
    if lacking:
        raise BadInputError(f"the twin cannot fly: the telemetry has no {', '.join(lacking)}")


# When a disagreement is more than chance: a sequential test for every regime and channel.
#
# Each block of half a second gives each signal a score: the innovations' projection on what that
# disturbance would make of them, in standard deviations of the noise. Summed over the last 1 to 20
# seconds, weighted by what each block could show, the scores are standard normal where the model
# is right, whatever is flown; a sum beyond ``LIMIT`` in any window is an event. A block counts for
# at most ``MOST``, so that one blow is none; what a flight's first seconds cannot tell (the noise)
# is waited for, and nothing of them is lost.


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
        lasting = (one for one in self._open.values() if one.told is not None)
        ended = [self._ended(one, *self._until, why) for one in lasting]
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
                parts = list(self._past)[-window:]
                needed = float(sum(part.energy[kind] for part in parts))
                self._open[family] = _Open(kind, whole, parts[0].first_s, needed)
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

    def _ended(self, one: _Open, end_s: float, host_ns: int, why: str) -> Episode:
        assert one.told is not None
        return replace(one.told, statistic=one.statistic, host_ns=host_ns, end_s=end_s, why=why)


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


# The live twin: samples in, what to show and what to tell out.


QUIET = 0.35
"""Quantile of the blocks' variances that counts as noise: a disagreement shows in some blocks
more than in others."""
NOISE_BLOCKS, LEAST_BLOCKS = 60, 6

_CHANNELS = {
    "gyro_x": "roll rate",
    "gyro_y": "pitch rate",
    "gyro_z": "yaw rate",
    "accelerometer_x": "forward force",
    "accelerometer_y": "sideways force",
    "accelerometer_z": "vertical force",
    "roll": "roll angle",
    "pitch": "pitch angle",
    "yaw": "yaw angle",
}
_REGIMES = {
    "whole flight": "throughout",
    "roll or pitch torque": "after roll or pitch torque",
    "after yaw commands": "after yaw commands",
    "high roll or pitch rate": "at high roll or pitch rate",
    "high yaw rate": "at high yaw rate",
    "turning about several axes": "turning about several axes",
    "rotor acceleration": "after rotor acceleration",
    "rotors slowing down": "when rotors slow down",
    "translation": "in translation",
    "high thrust": "with thrust",
    "climb": "in climb and descent",
    "thrust change": "after thrust changes",
    "near ground": "near the ground",
    "tilted": "when tilted",
}


@dataclass(frozen=True, slots=True)
class Shown:
    """Half a second for the eye.

    segment, time_s: (m,) of the device. measured, predicted: (m, 9) SI, in the order of
    ``gap.CHANNELS``, the latter from 50 ms before. gap: (9,) prediction error
    20 and 50 ms ahead over what the noise of quiet stretches leaves; NaN where it was not judged.
    """

    segment: int
    time_s: Array
    measured: Array
    predicted: Array
    gap: Array


class Twin:
    """A model that flies beside a stream of samples, cut in any way.

    Raises BadInputError for a model without a body.
    """

    def __init__(self, model: Model) -> None:
        require_body(model)
        self._rolling = Rolling(model)
        self._judge = Judge(allowances(model, SAMPLE_PERIOD_S))
        self._steps: deque[Array] = deque(maxlen=NOISE_BLOCKS)

    def feed(self, samples: SampleBatch) -> Iterator[tuple[Shown, list[Episode]]]:
        """What each completed half second shows and tells.

        Raises BadInputError where samples lack what the model needs.
        """
        for block in self._rolling.feed(samples):
            told = self._judge.take(block)
            yield self._shown(block), told

    def interrupt(self, why: str) -> list[Episode]:
        """End what lasts: nothing after this belongs to it."""
        return self._judge.interrupt(why)

    def _shown(self, block: Block) -> Shown:
        if np.isfinite(block.step).all():
            self._steps.append(block.step)
        gap = np.full(9, np.nan)
        if len(self._steps) >= LEAST_BLOCKS and np.isfinite(block.error).all():
            quiet = np.quantile(np.stack(self._steps), QUIET, axis=0)
            gap = np.sqrt(block.error.sum(axis=0) / (block.leaves.sum(axis=0) @ quiet))
        return Shown(block.segment, block.time_s, block.measured, block.predicted, gap)

    @property
    def learnt(self) -> bool:
        """Whether the noise is known, so that disagreements can be told."""
        return self._judge.floor is not None

    @property
    def episodes(self) -> list[Episode]:
        """Disagreements that last."""
        return self._judge.episodes


def episodes_of(model: Model, pieces: Sequence[SampleBatch]) -> list[Episode]:
    """Fast time: what the twin would have told of a flight."""
    twin = Twin(model)
    return [told for piece in pieces for _, tell in twin.feed(piece) for told in tell]


def in_words(episode: Episode) -> str:
    """``yaw rate disagrees after rotor acceleration``, and how surely."""
    channel = _CHANNELS[episode.place.channel]
    regime = _REGIMES[episode.place.regime]
    if episode.end_s is None:
        return (
            f"{channel} disagrees {regime}: {episode.statistic:.1f} standard deviations"
            f" beyond the model since {episode.begin_s:.1f} s"
        )
    return f"{channel} no longer disagrees {regime}: {episode.why} ({episode.end_s:.1f} s)"


def warm_up(model: Model) -> None:
    """Compile, or load from the cache, what a twin runs: by half a second of made hover."""
    rows = round(2.0 / SAMPLE_PERIOD_S)
    made = empty_samples(rows, SAMPLE_PERIOD_S)
    made.ticks[:] = np.arange(rows)
    made.duty[:], made.battery_v[:] = 0.6, 3.8
    made.gyro[:], made.accelerometer[:], made.attitude[:] = 0.0, 9.8, 0.0
    for _ in Twin(model).feed(made):
        pass
