"""A flight made ready for the search: what is airborne, which rows are real, where it rested."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.discrepancy.attitude_rows import AttitudeRows, Gaps, attitude_rows
from groundstation.discrepancy.recordings import without_gaps
from groundstation.dynamics.effects.height import heights_of, low_at_the_end, rise_of
from groundstation.dynamics.rotations import rotation_matrix
from groundstation.errors import BadInputError
from groundstation.identification.runs import Run
from groundstation.spans import spans

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

TURNING = 0.1
"""Duty from which a motor turns."""
SETTLE_S = 0.5
"""A flight that is recorded from the air on loses this: the motors forget their unknown start."""
CLEAR_M, LANDING_CLEAR_M = 0.02, 0.05
"""Height from which the ground carries nothing any more; at a landing it is less well known."""
CONTACT_S = 1.0
"""Left out at the start where height cannot be told; the ground may carry part of the torque."""
REST_S = 0.2
TOUCH_DOWN_S = 0.6
"""From when the motors stop until the craft lies still: it may fall the last bit."""
LEAST_AIR_S = 4.0
FOLLOW_S = 40.0
"""How slowly the attitude that the gyro carries follows the one reported."""


@dataclass(frozen=True, slots=True)
class Flight:
    """One uninterrupted airborne stretch with everything around it.

    run: all rows, missing ones filled in. known: (n,) rows that were received. first, last: the
    airborne rows. attitude: on the rows on which it was new, within the stretch. height_m: (n,)
    above the take-off point where it can be told, otherwise infinite. whole: the airborne rows,
    from rest and to rest where the flight began or ended on the ground; rests says whether it
    did. rotor_measured: rotor speeds were recorded. gaps: rows of the stretch that were lost. up:
    mean over ``whole`` of the vertical in sensor axes (3,) and of the specific force along it,
    None without accelerometer or attitude. carried: (n, 3) attitude that owes little to the
    accelerometer, None without attitude.
    """

    run: Run
    known: Flags
    first: int
    last: int
    attitude: AttitudeRows | None
    height_m: Array
    whole: slice
    rests: tuple[bool, bool]
    has_accelerometer: bool
    rotor_measured: bool
    gaps: Gaps
    up: tuple[Array, float] | None
    carried: Array | None

    @property
    def period_s(self) -> float:
        return self.run.period_s

    @property
    def rows(self) -> slice:
        return slice(self.first, self.last)


def prepare(runs: Sequence[Run], least_s: float = LEAST_AIR_S) -> list[Flight]:
    """The airborne stretches of runs, at least ``least_s`` long each.

    Raises BadInputError where the gyro is missing or nothing is left.
    """
    found = [flight for run in runs for flight in _flights(run, least_s)]
    if not found:
        names = ", ".join(sorted({run.name for run in runs})) or "recordings"
        raise BadInputError(
            f"{names}: no {least_s:.0f} s of uninterrupted flight after take-off;"
            " fly and record longer"
        )
    return found


def _flights(raw: Run, least_s: float) -> list[Flight]:
    known: Flags = np.asarray(np.isfinite(raw.gyro).all(axis=1), np.bool_)
    if not known.any():
        raise BadInputError(
            f"{raw.name}: the gyro is missing; without body rates no effect can be told"
        )
    measured = bool(np.isfinite(raw.rotor_rev_s).any())
    if not measured and not (np.isfinite(raw.duty).any() and np.isfinite(raw.supply_v).any()):
        raise BadInputError(f"{raw.name}: PWM or battery voltage is missing; the motors need both")
    has_accelerometer = bool(np.isfinite(raw.accelerometer).any())
    has_attitude = bool(np.isfinite(raw.attitude).any())
    run = without_gaps(raw)
    turning = (run.rotor_rev_s > 20.0 if measured else run.duty > TURNING).all(axis=1)
    period = run.period_s
    flights = []
    for start, stop in spans(turning):
        if (stop - start) * period < least_s:
            continue
        rests = (start * period > REST_S, (len(run) - stop) * period > TOUCH_DOWN_S)
        height, maybe_low = np.full(len(run), np.inf), 0
        if has_accelerometer:
            level = run.attitude if has_attitude else np.zeros((len(run), 3))
            rise = rise_of(level, run.accelerometer)
            driven = run.rotor_rev_s if measured else run.duty
            still = np.asarray((driven <= 0.0).all(axis=1))
            height[start:stop] = heights_of(rise, still, start, stop, period)
            maybe_low = low_at_the_end(rise, still, start, stop, period)
        first, last = _airborne(run, start, stop, rests, height)
        if not rests[1]:
            last -= maybe_low
        if (last - first) * period < least_s:
            continue
        attitude = attitude_rows(run, known, first, last) if has_attitude else None
        settled = min(stop + round(TOUCH_DOWN_S / period), len(run))
        whole = slice(start if rests[0] else first, settled if rests[1] else last)
        flights.append(
            Flight(
                run,
                known,
                first,
                last,
                attitude,
                height,
                whole,
                rests,
                has_accelerometer,
                measured,
                Gaps(~known[first:last]),
                _mean_up(run, whole) if has_accelerometer and attitude is not None else None,
                None if attitude is None else _carried(run, attitude, start),
            )
        )
    return flights


def _mean_up(run: Run, rows: slice) -> tuple[Array, float]:
    up = rotation_matrix(run.attitude[rows])[:, 2]
    return up.mean(axis=0), float(np.einsum("ni,ni->n", up, run.accelerometer[rows]).mean())


def _carried(run: Run, rows: AttitudeRows, start: int) -> Array:
    """The attitude as the gyro carries it, less the gyro's bias.

    The bias is what the gyro shows at rest before row ``start``, or else beyond the mean rate by
    which the attitude turned.
    """
    from groundstation.discrepancy.kernels import carried_attitude

    if start * run.period_s > 1.0 + REST_S:
        bias = run.gyro[: start - round(REST_S / run.period_s)].mean(axis=0)
    else:
        turned = np.linalg.solve(rows.to_euler, rows.rate[..., None])[..., 0]
        bias = (rows.gyro - turned).mean(axis=0)
    out = np.empty_like(run.attitude)
    attitude, gyro = (np.ascontiguousarray(part) for part in (run.attitude, run.gyro - bias))
    carried_attitude(attitude, gyro, run.period_s, FOLLOW_S, out)
    return out


def _airborne(
    run: Run, start: int, stop: int, rests: tuple[bool, bool], height: Array
) -> tuple[int, int]:
    """From where the ground carries nothing to where it begins to.

    What is low after the take-off may be a low hover; it ends no flight.
    """
    period = run.period_s
    first, last = start, stop
    if not rests[0]:
        first += round(SETTLE_S / period)
    else:
        clear = np.flatnonzero(height[start:stop] > CLEAR_M)
        known = np.isfinite(height[start])
        first += int(clear[0]) if len(clear) and known else round(1.5 / period)
    if rests[1]:
        clear = np.flatnonzero(height[first:stop] > LANDING_CLEAR_M)
        known = np.isfinite(height[stop - 1])
        last = first + int(clear[-1]) + 1 if len(clear) and known else stop
        if not known:
            last -= round(CONTACT_S / period)
    return first, last
