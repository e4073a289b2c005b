"""Roll and pitch gain by the crudest consistent estimate: complex, in a band, Whittle.

From the mixer's torque (squared rotor speeds, or their static value behind a first-order motor
where only PWM and battery are known) to the derivative of the rate, between 4 and 18 Hz (PWM: 2
and 20), where neither slow moments nor vibration and the sensors' lags hide the physics. One real
gain per axis; a delay and a lead (or the motor's lag) on a grid; the noise spectrum is each
flight's own, smoothed over 2 Hz, and found in turn with the gain. Shares no code with the program's
likelihood.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.vehicle import Vehicle
from groundstation.recording.formats import open_recording

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

BAND_HZ, PWM_BAND_HZ = (4.0, 18.0), (2.0, 20.0)
SMOOTHED_HZ = 2.0
MIXER_X = {
    "roll": np.array([-1.0, -1.0, 1.0, 1.0]),
    "pitch": np.array([-1.0, 1.0, 1.0, -1.0]),
    "yaw": np.array([-1.0, 1.0, -1.0, 1.0]),
}
"""Signs of the rotors in X, M1 front right, clockwise from above; pitch nose down positive."""
AXES = tuple(MIXER_X)
LEADS_S = (0.0, 0.004, 0.008, 0.012)
LAGS_S = (0.03, 0.04, 0.05, 0.06, 0.07, 0.08)
MOST_DELAY_S = 0.03
ROUNDS = 8
GROUND_S = 2.0
"""Left out after the motors start and before they stop: lift-off and landing."""
FLYING_DUTY = 0.25


@dataclass(frozen=True)
class Flight:
    """A flight on an even grid, airborne rows only.

    gyro: (n, 3) rad/s. square: (n, 4) squared rotor speeds, (rev/s)^2, measured, or what the
    vehicle's motor settles at. drive_v: (n, 4) PWM x battery.
    """

    name: str
    period_s: float
    gyro: Array
    square: Array
    drive_v: Array
    measured: bool

    @cached_property
    def hz(self) -> Array:
        return np.asarray(np.fft.rfftfreq(len(self.gyro), self.period_s))

    def spectrum(self, values: Array) -> Complex:
        """Of a tapered series (n,), its mean removed."""
        window = np.hanning(len(values))
        return np.asarray(np.fft.rfft((values - values.mean()) * window))

    def acceleration(self, axis: str) -> Complex:
        rate = self.spectrum(self.gyro[:, AXES.index(axis)])
        return np.asarray(2j * np.pi * self.hz * rate)

    @property
    def band(self) -> NDArray[np.bool_]:
        return self.within(*(BAND_HZ if self.measured else PWM_BAND_HZ))

    def within(self, low: float, high: float) -> NDArray[np.bool_]:
        """Bins of a band, Hz."""
        return (self.hz >= low) & (self.hz <= high)


@dataclass(frozen=True, slots=True)
class Gain:
    """gain: (rad/s^2)/(rev/s)^2. shape_s: lead (measured speeds) or motor lag (PWM)."""

    gain: float
    stderr: float
    delay_s: float
    shape_s: float
    explained: float
    """Share of the rate from 4 to 18 Hz, on the flights themselves."""


def read_flight(path: Path, vehicle: Vehicle, measured: bool) -> Flight:
    """A recording's airborne part; short gaps are bridged on straight lines."""
    samples = open_recording(path).samples
    time, period = samples.time_s, float(np.median(np.diff(samples.time_s)))
    rows = np.flatnonzero((samples.duty > FLYING_DUTY).all(axis=1))
    grid = np.arange(time[rows[0]] + GROUND_S * (not measured), time[rows[-1]], period)
    if not measured:
        grid = grid[grid < time[rows[-1]] - GROUND_S]

    def even(values: Any) -> Array:
        columns = [
            np.interp(grid, time[np.isfinite(one)], one[np.isfinite(one)]) for one in values.T
        ]
        return np.column_stack(columns).astype(np.float64)

    drive = even(samples.duty * samples.battery_v[:, None])
    if measured:
        speed = even(samples.rotor_rev_s)
    else:
        settle = np.vectorize(vehicle.motor.steady_rev_s)
        speed = settle(1e3 * drive)
    return Flight(path.name, period, even(samples.gyro), speed**2, drive, measured)


def reference_gain(flights: Sequence[Flight], axis: str, lag_s: float | None = None) -> Gain:
    """The gain of one axis over all flights, delay and shape where the likelihood is highest.

    lag_s: of the motors, where it is not searched. From PWM gain and lag go together, the band
    hardly tells them apart (gain over lag it does): give the lag that the other estimate has.
    """
    best: tuple[float, Gain] | None = None
    for delay, shape in _grid(flights[0], lag_s):
        likelihood, gain = _fitted(flights, axis, delay, shape)
        if best is None or likelihood > best[0]:
            best = likelihood, gain
    assert best is not None
    return best[1]


def explained(
    flights: Sequence[Flight], axis: str, gain: float, delay: float, shape: float
) -> float:
    """Share of the rate from 4 to 18 Hz that a gain explains, whatever drives the rotors.

    Of the rate, not of its derivative: noise of the acceleration grows with frequency, and what
    a controller needs foretold is the rate.
    """
    left, whole = 0.0, 0.0
    for flight in flights:
        band = flight.within(*BAND_HZ)
        integral = (2.0 * np.pi * flight.hz[band]) ** -2.0
        made = flight.acceleration(axis)[band]
        error = made - gain * _torque(flight, axis, delay, shape)[band]
        left += float(np.sum(np.abs(error) ** 2 * integral))
        whole += float(np.sum(np.abs(made) ** 2 * integral))
    return 1.0 - left / whole


def _grid(flight: Flight, lag_s: float | None) -> Iterator[tuple[float, float]]:
    step = flight.period_s if flight.measured else flight.period_s / 2
    delays = np.arange(-2, round(MOST_DELAY_S / step)) * step
    shapes = LEADS_S if flight.measured else LAGS_S if lag_s is None else (lag_s,)
    yield from itertools.product(delays.tolist(), shapes)


def _torque(flight: Flight, axis: str, delay: float, shape: float) -> Complex:
    turn = 2j * np.pi * flight.hz
    made = flight.spectrum(flight.square @ MIXER_X[axis]) * np.exp(-turn * delay)
    return np.asarray(made * (1 + turn * shape) if flight.measured else made / (1 + turn * shape))


def _fitted(flights: Sequence[Flight], axis: str, delay: float, shape: float) -> tuple[float, Gain]:
    parts = []
    for flight in flights:
        band, width = flight.band, max(1, round(SMOOTHED_HZ / (flight.hz[1] - flight.hz[0])))
        made, torque = flight.acceleration(axis), _torque(flight, axis, delay, shape)
        parts.append((made, torque, band, np.ones(width) / width))
    noise = [np.ones(len(made)) for made, *_ in parts]
    gain, information = 0.0, 1.0
    for _ in range(ROUNDS):
        top = information = 0.0
        for (made, torque, band, _), spectrum in zip(parts, noise, strict=True):
            weighted = torque[band].conj() / spectrum[band]
            top += float(np.sum(weighted * made[band]).real)
            information += float(np.sum(weighted * torque[band]).real)
        gain = top / information
        noise = [
            np.convolve(np.abs(made - gain * torque) ** 2, kernel, "same")
            for made, torque, _, kernel in parts
        ]
    likelihood = -sum(
        float(np.sum(np.log(spectrum[band])))
        for (_, _, band, _), spectrum in zip(parts, noise, strict=True)
    )
    share = explained(flights, axis, gain, delay, shape)
    # a Hann window leaves two thirds of the bins independent
    stderr = (1.5 / (2 * information)) ** 0.5
    return likelihood, Gain(gain, stderr, delay, shape, share)
