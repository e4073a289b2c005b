"""The noise of recorded rotor speeds beside their motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.identification.flight import Flight
from groundstation.telemetry.arrays import Array

NOISE_FROM = 0.6
"""Share of half the rate of fresh readings from which a motor does nothing that is seen: what is
left there is noise, if that is beyond ``NO_MOTOR_HZ``."""
NO_MOTOR_HZ = 60.0
"""A motor of 30 ms shows a hundredth of the power that it is given there."""


@dataclass(frozen=True, slots=True)
class SpeedSpectrum:
    """Of a flight's recorded speeds, all rotors together.

    hz, power: (m,), the power up to a factor. noise: of the sensor, in each bin, None where its
    readings are so rare that it cannot be told from motion.
    """

    hz: Array
    power: Array
    noise: float | None


def speed_spectrum(flight: Flight) -> SpeedSpectrum:
    """The noise is read near half the rate of fresh readings; readings that were joined by straight
    lines hide it."""
    speeds = flight.run.rotor_rev_s[flight.rows]
    fresh = float(np.mean(np.diff(speeds, axis=0) != 0.0))
    top = fresh * 0.5 / flight.period_s
    hz = np.asarray(np.fft.rfftfreq(len(speeds), flight.period_s), np.float64)
    window = np.hanning(len(speeds))[:, None]
    power = np.abs(np.fft.rfft((speeds - speeds.mean(axis=0)) * window, axis=0)) ** 2
    noise = None
    if NOISE_FROM * top >= NO_MOTOR_HZ:
        floor = (hz > NOISE_FROM * top) & (hz < top)
        noise = float(np.median(power[floor], axis=0).sum() / np.log(2.0))
    return SpeedSpectrum(hz, power.sum(axis=1), noise)
