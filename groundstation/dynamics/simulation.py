"""Fly a craft from armature voltages: one craft, or a batch of them.

Newton-Euler in the body frame (thesis 3.11), attitude as a quaternion, with the state vector of
``state.py``; inputs are held over each period, as PWM is.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike

from groundstation.dynamics.craft import Crafts
from groundstation.dynamics.state import STATES
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S


def simulate(
    craft: Crafts,
    initial: ArrayLike,
    voltage_mv: ArrayLike,
    *,
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
    needed where an effect of the supply acts.

    Where effects have states, these follow the 17, and ``initial`` may hold them.

    Raises ValueError for shapes that do not fit.
    """
    return simulate_batch(
        craft,
        np.asarray(initial)[None],
        voltage_mv,
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

    starts = with_states(crafts, np.atleast_2d(np.asarray(initial, np.float64)))
    voltage = np.asarray(voltage_mv, np.float64)
    voltage = np.ascontiguousarray(voltage[None] if voltage.ndim == 2 else voltage)
    push = np.zeros((1, 1, 6)) if disturbance is None else np.asarray(disturbance, np.float64)
    supply = np.zeros(0) if supply_mv is None else np.asarray(supply_mv, np.float64)
    _require_shapes(crafts, starts, voltage, push)
    if crafts["acts_supply"].any() and len(supply) != voltage.shape[1]:
        raise ValueError("an effect of the supply needs supply_mv, one for each row of voltage_mv")
    runs = max(len(crafts), len(starts), len(voltage), len(push))
    states = np.empty((runs, voltage.shape[1] + 1, starts.shape[1]))

    def run(index: int) -> None:
        states[index, 0] = starts[index % len(starts)]
        fly(
            crafts[index % len(crafts)],
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
    return states


def with_states(crafts: Crafts, starts: Array, made: bool = False) -> Array:
    """Body states (m, 17) followed by those of the crafts' effects, where these have any; made: of
    a flight that is no recorded one (``effect.State``)."""
    count = int(crafts["body_states"].max())
    if count == 0 or starts.shape[-1] != STATES:
        return starts
    begin = crafts["body_made" if made else "body_initial"]
    extra = np.broadcast_to(begin[:, :count], (len(crafts), count))
    rows = max(len(starts), len(crafts))
    return np.hstack([np.broadcast_to(one, (rows, one.shape[1])) for one in (starts, extra)])


def accelerations(
    craft: Crafts,
    states: ArrayLike,
    rotor_slopes: ArrayLike | None = None,
    period_s: float = SAMPLE_PERIOD_S,
) -> Array:
    """Angular acceleration in rad/s^2 and specific force in m/s^2, (..., 6), both in body axes.

    What every flight, prediction and fit of this craft is made of. states: (..., 17);
    rotor_slopes: (..., 4) rev/s^2, zero by default. What effects remember is followed along the
    rows, ``period_s`` apart.
    """
    from groundstation.dynamics import kernels

    state = np.asarray(states, np.float64)
    rows = np.ascontiguousarray(state.reshape(-1, state.shape[-1])[:, :STATES])
    slopes = np.zeros((len(rows), 4)) if rotor_slopes is None else np.asarray(rotor_slopes)
    slopes = np.ascontiguousarray(slopes.reshape(-1, 4), np.float64)
    found = np.empty((len(rows), 6))
    kernels.accelerations(craft[0], rows, slopes, period_s, found)
    return found.reshape(*state.shape[:-1], 6)


def specific_force(craft: Crafts, states: ArrayLike) -> Array:
    """What an accelerometer at the centre of gravity feels, (..., 3) m/s^2 in body axes.

    Thrust along z (thesis eq. 3.14), and what the craft's named effects add.
    """
    return accelerations(craft, states)[..., 3:]


def _require_shapes(crafts: Crafts, starts: Array, voltage: Array, push: Array) -> None:
    if crafts.ndim != 1 or starts.shape[-1] != STATES + crafts["body_states"].max():
        raise ValueError(f"crafts {crafts.shape} and initial {starts.shape}: need (m,) and (m, 17)")
    if voltage.ndim != 3 or voltage.shape[2] != 4:
        raise ValueError(f"voltage_mv has shape {voltage.shape}, expected (m, k, 4) or (k, 4)")
    if push.ndim != 3 or push.shape[2] != 6 or push.shape[1] not in (1, voltage.shape[1]):
        raise ValueError(f"disturbance has shape {push.shape}, expected (m, k, 6) with k steps")
    lengths = {len(array) for array in (crafts, starts, voltage, push)} - {1}
    if len(lengths) > 1:
        raise ValueError(f"batch lengths {sorted(lengths)} differ; each must be m or 1")
