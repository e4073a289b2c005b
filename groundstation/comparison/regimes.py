"""Regimes of a flight: which rows hover, turn fast, climb, saturate. A row can be in several."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.effect import SPIN
from groundstation.dynamics.model import Model, model_vehicle, rotor_motors
from groundstation.dynamics.simulation import REVOLUTION
from groundstation.identification.flight import flights_in, velocity_of
from groundstation.identification.runs import SATURATED, RotorSquares, Run, rotor_squares
from groundstation.telemetry.arrays import Array

Mask = NDArray[np.bool_]

WHOLE = "whole flight"
STRONGEST = 0.85
"""A motion is strong in the rows above this quantile of its size in the flight."""
NEAR_GROUND_S = 1.5
AFTER_S = 0.3
LOW_BATTERY_V = 3.3


@dataclass(frozen=True, slots=True)
class Motion:
    """What a run did, as the base model and the sensors have it.

    squares: rotors behind the run. torque: (n, 3) modelled angular acceleration, rad/s^2.
    thrust: (n,) modelled specific force along z, m/s^2. velocity: (n, 3) forward, left, up in the
    body, m/s (``identification.velocity``: steady speed is forgotten); zero without accelerometer
    or attitude. spin: (n,) -n1+n2-n3+n4 in rad/s. flown: (n,) airborne.
    since_start_s, before_end_s: (n,) time to the ends of the flight, infinite where the recording
    does not show them.
    """

    squares: RotorSquares
    torque: Array
    thrust: Array
    velocity: Array
    spin: Array
    flown: Mask
    since_start_s: Array
    before_end_s: Array


def motion_of(run: Run, model: Model) -> Motion:
    """The motion of a run under the model's motors and body.

    Raises BadInputError where PWM or battery voltage are missing, ValueError where the model has
    no body.
    """
    body = model.body
    if body is None:
        raise ValueError("the model has no body constants")
    squares = rotor_squares(run, rotor_motors(model))
    mixed = squares.mixed(model_vehicle(model).configuration)
    torque = mixed * [body.c0, body.c1, body.c2]
    thrust = np.asarray(body.thrust_per_mass * squares.end.sum(axis=1), np.float64)
    spin = np.asarray(REVOLUTION * np.sqrt(squares.end) @ SPIN, np.float64)
    flown = np.zeros(len(run), np.bool_)
    since, before = np.full(len(run), np.inf), np.full(len(run), np.inf)
    for one in flights_in(run):
        flown[one.first : one.last] = True
        rows = np.arange(one.start, one.stop)
        if one.rests[0]:
            since[rows] = (rows - one.first) * run.period_s
        if one.rests[1]:
            before[rows] = (one.last - rows) * run.period_s
    return Motion(squares, torque, thrust, velocity_of(run), spin, flown, since, before)


def regimes_of(run: Run, motion: Motion) -> dict[str, Mask]:
    """Regime -> rows (n,) in which it holds; all within the flown rows.

    A regime that needs a channel the run lacks, or never occurs, has no row.
    """
    flown = motion.flown
    rate, torque = run.gyro, motion.torque
    tilt = np.hypot(run.attitude[:, 0], run.attitude[:, 1])
    speed = np.hypot(motion.velocity[:, 0], motion.velocity[:, 1])
    slope = np.gradient(motion.thrust, run.period_s)
    spin_up = np.gradient(motion.spin, run.period_s)
    slowing = -np.gradient(np.sqrt(motion.squares.end), run.period_s, axis=0).min(axis=1)
    fast_tilt = np.hypot(rate[:, 0], rate[:, 1])
    torque_tilt = np.hypot(torque[:, 0], torque[:, 1])
    ground = np.minimum(motion.since_start_s, motion.before_end_s) < NEAR_GROUND_S
    duty = run.duty
    with np.errstate(invalid="ignore"):
        masks = {
            "hover": (fast_tilt < 0.35)
            & (np.abs(rate[:, 2]) < 0.35)
            & (tilt < 0.07)
            & (np.abs(motion.velocity[:, 2]) < 0.15)
            & ~ground,
            "high roll or pitch rate": _strong(fast_tilt, flown, 0.4),
            "high yaw rate": _strong(np.abs(rate[:, 2]), flown, 0.3),
            "turning about several axes": _strong(fast_tilt * np.abs(rate[:, 2]), flown, 0.2),
            "roll or pitch torque": _strong(torque_tilt, flown, 4.0),
            "after yaw commands": _after(_strong(np.abs(torque[:, 2]), flown, 0.5), run),
            "rotor acceleration": _strong(np.abs(spin_up), flown, 300.0),
            "rotors slowing down": _strong(slowing, flown, 60.0),
            "thrust change": _strong(np.abs(_smooth(slope, 5)), flown, 2.0),
            "high thrust": _above(motion.thrust, flown, 1.06),
            "low thrust": _above(-motion.thrust, flown, -0.94),
            "tilted": _strong(tilt, flown, 0.08),
            "translation": _strong(speed, flown, 0.25),
            "climb": _strong(np.maximum(motion.velocity[:, 2], 0.0), flown, 0.1),
            "descent": _strong(np.maximum(-motion.velocity[:, 2], 0.0), flown, 0.1),
            "near ground": ground,
            "saturation": ((duty >= SATURATED) | (duty <= 0.01)).any(axis=1),
            "low battery": run.supply_v < LOW_BATTERY_V,
        }
    return {WHOLE: flown.copy()} | {name: mask & flown for name, mask in masks.items()}


def _strong(size: Array, flown: Mask, least: float) -> Mask:
    """Rows in which a size (n,) is among its largest in flight, and worth the name at all."""
    if not flown.any() or not np.isfinite(size).all():
        return np.zeros(len(size), bool)
    return size > max(least, float(np.quantile(size[flown], STRONGEST)))


def _above(thrust: Array, flown: Mask, share: float) -> Mask:
    """Rows whose thrust is beyond a share of the flight's median, in the sign of ``share``."""
    if not flown.any():
        return np.zeros(len(thrust), bool)
    usual = float(np.median(np.abs(thrust[flown])))
    return _strong(thrust, flown, share * usual)


def _after(strong: Mask, run: Run) -> Mask:
    """Rows at most 0.3 s after the given ones."""
    rows = round(AFTER_S / run.period_s)
    count = np.cumsum(np.concatenate([[0], strong.astype(np.int64)]))
    index = np.arange(1, len(strong) + 1)
    return count[index] > count[np.maximum(index - rows, 0)]


def _smooth(signal: Array, rows: int) -> Array:
    """Centred mean over ``2 rows + 1`` rows."""
    return np.convolve(signal, np.full(2 * rows + 1, 1.0 / (2 * rows + 1)), mode="same")
