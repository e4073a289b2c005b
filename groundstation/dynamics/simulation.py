"""Fly a craft's model from armature voltages: one craft, or a batch of them.

Three models of the body are at hand (``BodyModel``). They share the motors, the state vector in
``state.py`` and the integrator, a classical Runge-Kutta step; inputs are held over each period,
as PWM is.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.craft import Crafts
from groundstation.dynamics.rotations import (
    attitude_of_quaternion,
    body_rates,
    euler_rates,
    quaternion_of_attitude,
)
from groundstation.dynamics.state import QUATERNION, RATE, ROTOR, STATES
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

Array = NDArray[np.float64]


class BodyModel(IntEnum):
    """Which equations of motion."""

    NEWTON_EULER = 0
    """Body frame (thesis 3.11), attitude as a quaternion: no singularity. The default."""
    EULER_LAGRANGE = 1
    """Inertial frame (thesis 3.10). Singular at a pitch of +-90 deg; always has coupling."""
    SIMPLIFIED = 2
    """Thesis 3.12: angular accelerations taken as Euler accelerations, for small angles."""


def simulate(
    craft: Crafts,
    initial: ArrayLike,
    voltage_mv: ArrayLike,
    *,
    model: BodyModel = BodyModel.NEWTON_EULER,
    period_s: float = SAMPLE_PERIOD_S,
    substeps: int = 1,
    disturbance: ArrayLike | None = None,
    supply_mv: ArrayLike | None = None,
) -> Array:
    """States (k + 1, 17) of one craft, the initial one first.

    craft: record of shape (1,). initial: (17,). voltage_mv: (k, 4), row i acts from sample i to
    i + 1. disturbance: (k, 6), accelerations about the body axes (rad/s^2) and along the inertial
    axes (m/s^2). substeps: integration steps per period; one of 2 ms leaves an error of
    1e-9 rad over a second of ordinary flight. supply_mv: (k,) from which the voltages were made,
    needed where the craft has supply_sag.

    Raises ValueError for shapes that do not fit.
    """
    return simulate_batch(
        craft,
        np.asarray(initial)[None],
        voltage_mv,
        model=model,
        period_s=period_s,
        substeps=substeps,
        disturbance=None if disturbance is None else np.asarray(disturbance)[None],
        supply_mv=supply_mv,
    )[0]


def simulate_batch(
    crafts: Crafts,
    initial: ArrayLike,
    voltage_mv: ArrayLike,
    *,
    model: BodyModel = BodyModel.NEWTON_EULER,
    period_s: float = SAMPLE_PERIOD_S,
    substeps: int = 1,
    disturbance: ArrayLike | None = None,
    supply_mv: ArrayLike | None = None,
) -> Array:
    """States (m, k + 1, 17) of m flights, over parameters and over seeds, on every core.

    crafts: (m,) or (1,); initial: (m, 17) or (1, 17); voltage_mv: (m, k, 4), (1, k, 4) or
    (k, 4); disturbance: (m, k, 6), from as many seeds as wanted. What has length 1 is shared.
    supply_mv: (k,), shared by all.
    """
    from groundstation.dynamics.kernels import fly

    starts = np.atleast_2d(np.asarray(initial, np.float64))
    voltage = np.asarray(voltage_mv, np.float64)
    voltage = np.ascontiguousarray(voltage[None] if voltage.ndim == 2 else voltage)
    push = np.zeros((1, 1, 6)) if disturbance is None else np.asarray(disturbance, np.float64)
    supply = np.zeros(0) if supply_mv is None else np.asarray(supply_mv, np.float64)
    _require_shapes(crafts, starts, voltage, push)
    if (crafts["sag_ohm"] != 0.0).any() and len(supply) != voltage.shape[1]:
        raise ValueError("a craft with supply_sag needs supply_mv, one for each row of voltage_mv")
    if model is not BodyModel.NEWTON_EULER and any(map(_beyond_rigid, crafts)):
        raise ValueError(f"{model.name} knows the rigid body only; fly effects on NEWTON_EULER")
    runs = max(len(crafts), len(starts), len(voltage), len(push))
    steps = voltage.shape[1]
    if model is not BodyModel.NEWTON_EULER:
        starts = _to_euler(starts)
    states = np.empty((runs, steps + 1, starts.shape[1]))

    def run(index: int) -> None:
        fly(
            int(model),
            crafts[index % len(crafts)],
            starts[index % len(starts)],
            voltage[index % len(voltage)],
            supply,
            push[index % len(push)],
            period_s,
            substeps,
            states[index],
        )

    if runs == 1:
        run(0)
    else:
        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            list(pool.map(run, range(runs)))
    return states if model is BodyModel.NEWTON_EULER else _from_euler(states)


def specific_force(craft: Crafts, states: ArrayLike) -> Array:
    """What an accelerometer at the centre of gravity feels, (..., 3) m/s^2 in body axes.

    Thrust along z (thesis eq. 3.14), and what the craft's named effects add.
    """
    from groundstation.dynamics.kernels import specific_forces

    state = np.asarray(states, np.float64)
    rows = np.ascontiguousarray(state.reshape(-1, STATES))
    force = np.empty((len(rows), 3))
    specific_forces(craft[0], rows, force)
    return force.reshape(*state.shape[:-1], 3)


def _beyond_rigid(craft: np.void) -> bool:
    """Whether an effect acts that only Newton-Euler has."""
    names = ("rate_damping", "quadratic_damping", "yaw_damping", "gravity_x", "gravity_y")
    return any(craft[name] != 0.0 for name in (*names, "air", "ground_gain", "law"))


def _require_shapes(crafts: Crafts, starts: Array, voltage: Array, push: Array) -> None:
    if crafts.ndim != 1 or starts.shape[-1] != STATES:
        raise ValueError(f"crafts {crafts.shape} and initial {starts.shape}: need (m,) and (m, 17)")
    if voltage.ndim != 3 or voltage.shape[2] != 4:
        raise ValueError(f"voltage_mv has shape {voltage.shape}, expected (m, k, 4) or (k, 4)")
    if push.ndim != 3 or push.shape[2] != 6 or push.shape[1] not in (1, voltage.shape[1]):
        raise ValueError(f"disturbance has shape {push.shape}, expected (m, k, 6) with k steps")
    lengths = {len(array) for array in (crafts, starts, voltage, push)} - {1}
    if len(lengths) > 1:
        raise ValueError(f"batch lengths {sorted(lengths)} differ; each must be m or 1")


def _to_euler(states: Array) -> Array:
    attitude = attitude_of_quaternion(states[..., QUATERNION])
    parts = (
        states[..., :6],
        attitude,
        euler_rates(attitude, states[..., RATE]),
        states[..., ROTOR],
    )
    return np.ascontiguousarray(np.concatenate(parts, axis=-1))


def _from_euler(states: Array) -> Array:
    attitude = states[..., 6:9]
    return np.concatenate(
        [
            states[..., :6],
            quaternion_of_attitude(attitude),
            body_rates(attitude, states[..., 9:12]),
            states[..., 12:16],
        ],
        axis=-1,
    )
