"""The rolling predictor: samples in, in pieces of any size; predictions and their errors out.

Every half second the observer goes on over the rows that have come (``observe_part``), the model
flies 20 and 50 ms ahead from them on the recorded inputs (``fly_ahead``), and the innovations are
correlated with what each kind of disturbance would make of them. Live and fast time run through
this same code: what comes out does not depend on how the samples were cut.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.gap import HORIZONS_S
from groundstation.dynamics.model import Model, model_vehicle
from groundstation.dynamics.sensors import sensors_of_model
from groundstation.errors import BadInputError
from groundstation.prediction.drive import LANDED, TURNING, Drive, drive_run, fresh_rows
from groundstation.prediction.observer import Gains, Noise, gains_of, integrating_force
from groundstation.prediction.prediction import SETTLE_S, fly_ahead, noise_of, observe_part
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch
from groundstation.twin.rows import RHYTHM_ROWS, Piece, Rows, period_of, unbroken
from groundstation.twin.signals import KINDS, SHARED, Drives, Memory, entries

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


class _Open:
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
        self._open = _Open(len(self._advance))
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
        drives = Drives(seen, self._owner._configuration, since_lift, self._memory)
        square, scores = self._score(
            drives.columns(), seen.innovations[1:], fresh[1 : count + 1], flying, judged
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

        count = len(KINDS)
        square = np.zeros(10)
        scores = (
            np.zeros((9, count)),
            np.zeros((9, count)),
            np.zeros((9, len(SHARED), count)),
            np.zeros((9, len(SHARED), count)),
        )
        if not flying[1:].any():
            self._open = _Open(len(self._advance))
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
    lacking = [
        what
        for name, what in (
            ("duty", "motors"),
            ("battery_v", "battery voltage"),
            ("gyro", "gyro"),
            ("accelerometer", "accelerometer"),
            ("attitude", "attitude"),
        )
        if np.isnan(getattr(samples, name)).all()
    ]
    if lacking:
        raise BadInputError(f"the twin cannot fly: the telemetry has no {', '.join(lacking)}")
