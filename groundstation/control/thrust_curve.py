"""What a firmware makes of thrust, as flights show it: releases differ by -6 to +28 % at hover.

The controller's output ``stabilizer.thrust`` stands beside the duty and the battery of the same
moment. A flight stays near its hover, where the level and the slope of the curve count: they are
measured, and its bend is the profile's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from groundstation.control.firmwares import Curve, Firmware
from groundstation.dynamics.craft import craft_of_model
from groundstation.dynamics.model import Model
from groundstation.dynamics.simulation import hover_rev_s
from groundstation.recording.session import Recording
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import FULL_16_BIT
from groundstation.telemetry.samples import SampleBatch

THRUST = "stabilizer.thrust"
"""The log variable, in units of 16 bits; in any table of a recording."""
LEAST_THRUST = 0.15
"""Of full thrust, below which a craft stands, or falls."""
NEAR_S = 0.02
"""A row of telemetry so near says what the motors did then."""
LEAST_ROWS = 200
TRIMS, OUTSIDE, LEAST_KEPT = 4, 6.0, 0.6
"""Rows so many times the median error off are left out, and the rest is fitted again: motors that
idle, are limited or stand. Where too many are, it is no curve."""
LEAST_R2 = 0.9
"""Of the thrust that is left, the share that the voltage has to explain: the firmware reckons one
from the other without noise, a table of another meaning explains none."""
FURTHEST = 2.0
"""Times the profile's slope: no release is further from another."""


def flown_curve(recordings: Sequence[Recording], firmware: Firmware) -> Curve | None:
    """The curve of ``Firmware.curve``'s kind that these flights show; None where no thrust was
    logged, or it does not tell."""
    pairs = [pair for one in recordings for pair in _pairs(one)]
    if not firmware.is_today or sum(len(thrust) for thrust, _ in pairs) < LEAST_ROWS:
        return None
    thrust, volts = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    newtons = thrust * firmware.most_n
    shape = np.polynomial.polynomial.polyval(volts, firmware.curve)
    kept, slope, level = np.ones(len(shape), bool), 1.0, 0.0
    for _ in range(TRIMS):
        slope, level = np.polyfit(shape[kept], newtons[kept], 1).tolist()
        left = np.abs(newtons - level - slope * shape)
        kept = left <= OUTSIDE * np.median(left)
    if not 1.0 / FURTHEST <= slope <= FURTHEST or kept.sum() < LEAST_KEPT * len(kept):
        return None
    if np.corrcoef(shape[kept], newtons[kept])[0, 1] ** 2 < LEAST_R2:
        return None
    first, *others = (slope * factor for factor in firmware.curve)
    return (first + level, others[0], others[1], others[2])


def against(curve: Curve, firmware: Firmware, model: Model) -> str:
    """How steep a curve is at a model's hover beside that of its profile, in words."""
    volts = model.motor.armature_mv(hover_rev_s(craft_of_model(model))) / 1000.0
    flown, assumed = (
        1e6 * one.volts_per_thrust(volts) for one in (replace(firmware, curve=curve), firmware)
    )
    return (
        f"The firmware's thrust curve, as flown: {flown:.1f} µV a unit of thrust at hover, where"
        f" the profile's has {assumed:.1f} ({100.0 * (flown / assumed - 1.0):+.0f} %); designs use"
        " the flown one."
    )


def _pairs(recording: Recording) -> list[tuple[Array, Array]]:
    """Thrust, as a share of the full one, and the motors' mean voltage (V) while it flew."""
    found = []
    for table in recording.tables.values():
        if THRUST not in table.columns:
            continue
        thrust = np.asarray(table.columns[THRUST], np.float64) / FULL_16_BIT
        volts = _volts(recording.samples, np.asarray(table.time_s, np.float64))
        flies = np.isfinite(thrust) & np.isfinite(volts) & (thrust > LEAST_THRUST) & (thrust < 1.0)
        found.append((thrust[flies], volts[flies]))
    return found


def _volts(samples: SampleBatch, time_s: Array) -> Array:
    """Mean voltage (V) of the motors at moments of the device's clock; NaN where no row is near, or
    one of them is at its limit."""
    rows = np.searchsorted(samples.time_s, time_s).clip(1, max(len(samples) - 1, 1))
    if len(samples) < 2:
        return np.full(len(time_s), np.nan)
    rows -= time_s - samples.time_s[rows - 1] < samples.time_s[rows] - time_s
    duty = samples.duty[rows]
    free = (duty.min(axis=1) > 0.0) & (duty.max(axis=1) < 1.0)
    free &= np.abs(samples.time_s[rows] - time_s) <= NEAR_S
    return np.where(free, duty.mean(axis=1) * samples.battery_v[rows], np.nan)
