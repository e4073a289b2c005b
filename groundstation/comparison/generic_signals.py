"""Generic signals of a flight: what a predictor that knows no physics of the craft may look at.

Rotor squares and their past, rotor speeds and slopes, rates and their products, leaky velocity,
tilt, closeness to the ground. Nothing here knows the named effects or their parameters. No signal
holds anything measured in the present row or later: that would know the noise it is to predict.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from groundstation.comparison.regimes import Motion
from groundstation.dynamics.simulation import armature_mv
from groundstation.dynamics.vehicle import MIXERS, Configuration
from groundstation.identification.flight import LEAK_S, velocity_of
from groundstation.identification.runs import Run
from groundstation.telemetry.arrays import AXES, Array

LAGS = (1, 2, 3, 4, 6, 8, 12, 18, 26)
"""Rows by which inputs may act later than the base model has it."""
PAST_ROWS = 4
PULL_S = 0.1
MOTOR_S = 0.05
"""A small motor with its propeller settles within about this time."""
GROUND_S = (0.4,)
MIXED = (*AXES, "collective")


@dataclass(frozen=True, slots=True)
class Signals:
    """names: (p,) in words. values: (n, p)."""

    names: tuple[str, ...]
    values: Array


Kind = Literal["torque", "force", "attitude"]
"""What one-step errors are of."""


def signals_of(run: Run, motion: Motion, configuration: Configuration, kind: Kind) -> Signals:
    """Candidates for the one-step errors of a kind."""
    mixer = MIXERS[configuration]
    common = _Collected()
    speed = np.sqrt(motion.squares.end)
    slope = _change(speed, run.period_s)
    # The mean over the recording makes it a deviation; the voltage itself is the battery's word.
    charge = (run.supply_v - np.mean(run.supply_v))[:, None]
    common.add("rotor speed", MIXED, _mixed(speed, mixer))
    common.add("rotor acceleration", MIXED, _mixed(slope, mixer))
    common.add("rotors slowing down", MIXED, _mixed(np.minimum(slope, 0.0), mixer))
    lost = speed * _leaky(np.minimum(slope, 0.0), MOTOR_S, run.period_s)
    common.add("rotors that slowed down", MIXED, _mixed(lost, mixer))
    common.add("thrust by battery voltage", MIXED, _mixed(motion.squares.end * charge, mixer))
    common.add("motor voltage", MIXED, _mixed(armature_mv(run.duty, run.supply_v), mixer))
    past = _past_mean(run.gyro)
    p, q, r = past.T
    common.add("rate", AXES, past)
    common.add("rate times its magnitude", AXES, past * np.abs(past))
    common.add("rate products", ("pq", "qr", "pr"), np.column_stack([p * q, q * r, p * r]))
    common.add("squared rate", AXES, past**2)
    spin = motion.spin[:, None]
    common.add("rate by rotor momentum", AXES[:2], spin * past[:, :2])
    common.add("rotor momentum", ("change",), _change(spin, run.period_s))
    common.add("offset", ("constant",), np.ones((len(run), 1)))
    attitude = np.sin(np.nan_to_num(run.attitude[:, :2]))
    common.add("tilt", AXES[:2], _late(attitude, 4))
    pull = np.nan_to_num(run.accelerometer[:, :2])
    force = _late(_leaky(pull, PULL_S, run.period_s) / PULL_S, 1)
    common.add("specific force in the plane", ("forward", "left"), force)
    ways = ("forward", "left", "up")
    # A second leak beside the usual one: together they bend to the craft's own speed.
    slow = _late(velocity_of(run, LEAK_S), 1)
    common.add("slow velocity", ways, slow)
    velocity = _late(motion.velocity, 1)
    common.add("velocity", ways, velocity)
    common.add("velocity times its magnitude", ways, velocity * np.abs(velocity))
    squares = motion.squares.end if kind == "force" else motion.squares.square
    own = _mixed(squares, mixer)
    if kind == "attitude":
        inputs = _lagged(own[:, :3], AXES)
    else:
        inputs, ground = _lagged(own, MIXED), _ground(motion)
        for column in range(ground.shape[1]):
            inputs.add("rotor squares near the ground", MIXED, own * ground[:, [column]])
    names = (*inputs.names, *common.names)
    return Signals(names, np.hstack([*inputs.columns, *common.columns]))


class _Collected:
    """Columns and their names, as they come."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.columns: list[Array] = []

    def add(self, what: str, parts: tuple[str, ...], values: Array) -> None:
        self.names += [f"{what}, {part}" for part in parts]
        self.columns.append(values)


def _lagged(own: Array, parts: tuple[str, ...]) -> _Collected:
    inputs = _Collected()
    for lag in (0, *LAGS):
        when = f" {lag} rows before" if lag else ""
        inputs.add(f"rotor squares{when}", parts, _late(own, lag))
    return inputs


def _mixed(values: Array, mixer: Array) -> Array:
    """Roll, pitch, yaw and collective part of one value per rotor."""
    return np.hstack([values @ mixer.T, values.sum(axis=1, keepdims=True)])


def _late(values: Array, rows: int) -> Array:
    """Values of so many rows before, the first one held."""
    return np.vstack([np.repeat(values[:1], rows, axis=0), values[: len(values) - rows]])


def _leaky(values: Array, fade_s: float, period_s: float) -> Array:
    """Leaky integral over time."""
    from scipy.signal import lfilter

    keep = float(np.exp(-period_s / fade_s))
    return lfilter([period_s], [1.0, -keep], values, axis=0)


def _change(values: Array, period_s: float) -> Array:
    """Slope over the period that ends with the row."""
    return np.diff(values, axis=0, prepend=values[:1]) / period_s


def _past_mean(values: Array) -> Array:
    """Mean of the ``PAST_ROWS`` rows before each row."""
    total = np.cumsum(np.vstack([np.repeat(values[:1], PAST_ROWS + 1, axis=0), values]), axis=0)
    count = len(values)
    return (total[PAST_ROWS : PAST_ROWS + count] - total[:count]) / PAST_ROWS


def _ground(motion: Motion) -> Array:
    """Fading closeness to take-off and landing, (n, 2)."""
    columns = []
    for away in (motion.since_start_s, motion.before_end_s):
        columns += [np.exp(-np.clip(away, 0.0, None) / fade) for fade in GROUND_S]
    return np.column_stack(columns)
