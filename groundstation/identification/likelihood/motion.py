"""How a craft moves, row by row, as far as rows before it tell: what laws are evaluated on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from groundstation.dynamics.effect import FAR_M, Body, Craft, rotor_wrench
from groundstation.identification.flight import Flight, quaternion_rows
from groundstation.identification.likelihood.laws import Acting
from groundstation.identification.likelihood.rotors import Rotors
from groundstation.identification.velocity import LEAK_S, LEANING_LEAK_S, velocity_in
from groundstation.telemetry.arrays import Array

Rows = tuple[Any, ...]
"""Arrays (n,), one for each axis or rotor; a plain number where it is the same in every row."""

BodyRows = Any
"""A ``law.Body`` of arrays (n,)."""

STILL, _FOUR = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Inputs:
    """Rotor speeds behind the rows, rev/s, each four of (n,), as late as the measurements are.

    mean: root of the mean square over the period before a row; last: at the row.
    rotor, slope: mean speed over the period, and its slope in rev/s^2.
    """

    mean: Rows
    last: Rows
    rotor: Rows
    slope: Rows

    @classmethod
    def of(cls, rotors: Rotors, delay_s: float, period_s: float) -> Inputs:
        """Between rows speeds and the integrals of their squares are cubic."""
        from groundstation.identification.likelihood.kernels import late_rotors

        rows = np.empty((4, *rotors.end.T.shape))
        late_rotors(rotors.end, rotors.square, delay_s / period_s, period_s, *rows)
        return cls(*map(tuple, rows))

    @classmethod
    def of_halves(cls, halves: Rotors, delay_s: float, period_s: float) -> tuple[Inputs, Inputs]:
        """Of the first and the second half of each row's period."""
        both = cls.of(halves, delay_s, 0.5 * period_s)
        fields = (both.mean, both.last, both.rotor, both.slope)
        first, second = (
            cls(*(_rows(np.column_stack(rows)[half::2]) for rows in fields)) for half in (0, 1)
        )
        return first, second


class Motion:
    """Velocity, height and attitude of a flight, and its rates as predicted from earlier rows.

    news: (n, 3) rad/s^2, what the rows' own measurement says of a disturbance.
    """

    def __init__(
        self, flight: Flight, force: Array, turn: Array, true: Array | None, leaning: bool
    ) -> None:
        """force: (n, 3) specific force in body axes. turn: (3, 3), sensor to body axes. leaning:
        reported angles follow the accelerometer. true: (n, 3) rad, the angles behind those that an
        estimator turns; None: they are the reported ones."""
        run, count = flight.run, len(flight.run)
        self.flight, self.period = flight, run.period_s
        self._rates, self.news = np.zeros((count, 3)), np.zeros((count, 3))
        self.velocity = np.zeros((count, 3))
        attitude, orientation = run.attitude, flight.orientation
        if true is not None:
            attitude, orientation = true, quaternion_rows(true)
        if flight.up is not None:
            sensed = self._velocity(force @ turn, attitude, orientation, leaning)
            self.velocity = sensed @ turn.T
        height = np.where(np.isfinite(flight.height_m), flight.height_m, FAR_M)
        rows: Any = (
            np.minimum(height, FAR_M),
            tuple(orientation),
            _rows(self.velocity),
            STILL,
            _FOUR,
            _FOUR,
            0.0,
            STILL,
            STILL,
        )
        self._still: BodyRows = Body(*rows)

    def _velocity(self, sensed: Array, attitude: Array, orientation: Array, leaning: bool) -> Array:
        # A lean turns the attitude until no acceleration is felt, and a filter that takes every
        # second row of the gyro folds vibration into it: over seconds the gyro knows better.
        flight = self.flight
        if leaning and flight.carried is not None:
            attitude, orientation = flight.carried, flight.carried_orientation
        leak = LEANING_LEAK_S if leaning else LEAK_S
        return velocity_in(flight, attitude, orientation, sensed, leak)

    def follow(self, gyro: Array) -> None:
        """Take the last row's rate for the next one's."""
        self._rates[1:] = gyro[:-1]
        self._still = self._still._replace(rate=_rows(self._rates))

    def with_rates_of(self, other: Motion) -> Motion:
        """The rates that another predicted, in place of its own."""
        self._rates, self.news = other._rates, other.news
        self._still = self._still._replace(rate=other._still.rate)
        return self

    def predict(
        self, gyro: Array, angular: Array, gain: tuple[float, float, float], ahead: Array
    ) -> tuple[float, float, float]:
        """Predict the rates from a modelled angular acceleration; the mean squared error (3,).

        ahead: (3, 3) s, how far the true rate is ahead of the gyro.
        """
        from groundstation.identification.likelihood.kernels import predict_rates

        found: tuple[float, float, float] = predict_rates(
            gyro,
            self.flight.known,
            angular,
            self.period,
            np.array(gain),
            max(self.flight.first - 1, 0),
            self._rates,
            self.news,
        )
        # The share of an innovation that is torque, not sensor noise, in a filter with this gain.
        self.news *= np.array(gain) ** 2 / self.period
        rates = self._rates + angular @ ahead.T if ahead.any() else self._rates
        self._still = self._still._replace(rate=_rows(rates))
        return found

    def thrust(self, craft: Craft, inputs: Inputs, *, mean: bool) -> Rows:
        """What equal rotors do: thrust and torques, rows of N and N m."""
        return rotor_wrench(craft, inputs.mean if mean else inputs.last)

    def body(
        self,
        craft: Craft,
        inputs: Inputs,
        wrench: Rows,
        rotor: tuple[Acting, ...],
        body: tuple[Acting, ...],
        *,
        mean: bool,
    ) -> BodyRows:
        """Rows of the craft with its accelerations, by the laws of rotors and body.

        wrench: what equal rotors do, over the period before each row (mean) or at the row.
        """
        speed = inputs.mean if mean else inputs.last
        now = self._still._replace(rotor=speed, rotor_slope=inputs.slope, thrust=wrench[0])
        for one in rotor:
            wrench = one.law(craft, now, wrench)
        (ixx, iyy, izz), (thrust, roll, pitch, yaw) = craft.inertia, wrench
        angular, force = (roll / ixx, pitch / iyy, yaw / izz), (0.0, 0.0, thrust / craft.mass)
        now = now._replace(rotor=inputs.rotor, thrust=thrust, angular=angular, force=force)
        for one in body:
            if one.effect.order > 0:
                now = now._replace(angular=angular, force=force)
            more, push = one.body_law(craft, now, self.period, mean)
            angular, force = added(angular, more), added(force, push)
        return now._replace(angular=angular, force=force)

    def turning(self, body: BodyRows) -> BodyRows:
        """A body with the rates as they are predicted now."""
        return body._replace(rate=self._still.rate)

    def at_rows(self, row: BodyRows) -> BodyRows:
        """A body as sensors have it at the row itself, of one by the thrust there.

        The accelerometer has no part in the gyro's noise, so what the present row says of a
        disturbance may be used here.
        """
        half = 0.5 * self.period
        news = _rows(self.news)
        rate = tuple(r + half * a for r, a in zip(row.rate, row.angular, strict=True))
        return row._replace(rate=rate, angular=added(row.angular, news))


def added(one: Rows, other: Rows) -> Rows:
    return tuple(_sum(a, b) for a, b in zip(one, other, strict=True))


def _sum(one: Any, other: Any) -> Any:
    if np.ndim(one) == 0 and one == 0.0:
        return other
    return one if np.ndim(other) == 0 and other == 0.0 else one + other


def one_before(values: Any) -> Any:
    """Rows (n,), or a tuple of them, moved on by one; numbers stay."""
    if isinstance(values, tuple):
        return tuple(map(one_before, values))
    if np.ndim(values) == 0:
        return values
    moved = np.empty_like(values)
    moved[0], moved[1:] = values[0], values[:-1]
    return moved


def stacked(rows: Rows, count: int) -> Array:
    """(n, axes) of rows; plain numbers are spread."""
    found = np.empty((count, len(rows)))
    for i, values in enumerate(rows):
        found[:, i] = values
    return found


def _rows(values: Array) -> Rows:
    return tuple(np.ascontiguousarray(values.T))
