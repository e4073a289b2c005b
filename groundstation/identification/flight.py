"""A flight made ready for the search: what is airborne, which rows are real, where it rested."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.rotations import (
    attitude_of_matrix,
    quaternion_of_attitude,
    rotation_matrix,
)
from groundstation.errors import BadInputError
from groundstation.identification.airborne import REST_S, TOUCH_DOWN_S, flights_in
from groundstation.identification.attitude_rows import AttitudeRows, Gaps, attitude_rows
from groundstation.identification.read_between import force_read_between
from groundstation.identification.recordings import without_gaps
from groundstation.identification.runs import Run, require_known
from groundstation.identification.torque import RotorSquares, measured_squares
from groundstation.telemetry.arrays import Array

Flags = NDArray[np.bool_]

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
    did. rotor_measured: speeds of all rotors were recorded throughout. gaps: rows of the stretch
    that were lost. up: mean over ``whole`` of the vertical in sensor axes (3,) and of the specific
    force along it, None without accelerometer or attitude. carried: (n, 3) attitude that owes
    little to the accelerometer, None without attitude. force_between: rows of the accelerometer are
    means of readings half a row before and half a row after. orientation, carried_orientation:
    (4, n) quaternions of the reported attitude and of ``carried`` (or else of the reported one),
    and upward: (last - first, 3) the vertical in sensor axes; level without attitude. rotors:
    measured speeds, squared, None where they are not.
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
    force_between: bool
    orientation: Array = field(init=False)
    carried_orientation: Array = field(init=False)
    upward: Array = field(init=False)
    rotors: RotorSquares | None = field(init=False)

    def __post_init__(self) -> None:
        angles = np.zeros_like(self.run.gyro) if self.attitude is None else self.run.attitude
        reported = quaternion_rows(angles)
        carried = reported if self.carried is None else quaternion_rows(self.carried)
        object.__setattr__(self, "orientation", reported)
        object.__setattr__(self, "carried_orientation", carried)
        object.__setattr__(self, "upward", rotation_matrix(angles[self.rows])[:, 2])
        told = measured_squares(self.run) if self.rotor_measured else None
        object.__setattr__(self, "rotors", told)

    @property
    def period_s(self) -> float:
        return self.run.period_s

    @property
    def rows(self) -> slice:
        return slice(self.first, self.last)


def quaternion_rows(attitude: Array) -> Array:
    """Quaternions (4, n) of angles (n, 3) in rad."""
    return np.ascontiguousarray(quaternion_of_attitude(attitude).T)


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
    run = without_gaps(raw)
    measured = bool(np.isfinite(run.rotor_rev_s).all())
    for name in () if measured else ("duty", "supply_v"):
        if not np.isfinite(getattr(raw, name)).any():
            require_known(raw, (name,), "the motors need it")
    has_accelerometer = bool(np.isfinite(raw.accelerometer).any())
    has_attitude = bool(np.isfinite(raw.attitude).any())
    period, flights = run.period_s, []
    for air in flights_in(run):
        first, last, rests = air.first, air.last - air.maybe_low, air.rests
        if (last - first) * period < least_s:
            continue
        attitude = attitude_rows(run, known, first, last) if has_attitude else None
        settled = min(air.stop + round(TOUCH_DOWN_S / period), len(run))
        whole = slice(air.start if rests[0] else first, settled if rests[1] else last)
        flights.append(
            Flight(
                run,
                known,
                first,
                last,
                attitude,
                air.height_m,
                whole,
                rests,
                has_accelerometer,
                measured,
                Gaps(~known[first:last]),
                _mean_up(run, whole) if has_accelerometer and attitude is not None else None,
                None if attitude is None else _carried(run, attitude, air.start),
                is_force_between(run, attitude, first, last),
            )
        )
    return flights


def is_force_between(run: Run, attitude: AttitudeRows | None, first: int, last: int) -> bool:
    """Whether rows of the accelerometer are means of two readings. Only where the angles are: what
    shakes a craft can look like that."""
    there = attitude is not None and attitude.between
    return there and force_read_between(run.accelerometer[first:last])


def _mean_up(run: Run, rows: slice) -> tuple[Array, float]:
    up = rotation_matrix(run.attitude[rows])[:, 2]
    return up.mean(axis=0), float(np.einsum("ni,ni->n", up, run.accelerometer[rows]).mean())


def _carried(run: Run, rows: AttitudeRows, start: int) -> Array:
    """The attitude as the gyro carries it, less the gyro's bias.

    The bias is what the gyro shows at rest before row ``start``, or else beyond the mean rate by
    which the attitude turned.
    """
    from groundstation.identification.likelihood.kernels import carried_rotation

    if start * run.period_s > 1.0 + REST_S:
        bias = run.gyro[: start - round(REST_S / run.period_s)].mean(axis=0)
    else:
        turned = np.linalg.solve(rows.to_euler, rows.rate[..., None])[..., 0]
        bias = (rows.gyro - turned).mean(axis=0)
    reported = rotation_matrix(run.attitude)
    carried = np.empty_like(reported)
    gyro = np.ascontiguousarray(run.gyro - bias)
    carried_rotation(reported, gyro, run.period_s, FOLLOW_S, carried)
    return attitude_of_matrix(carried)
