"""Fly a craft from armature voltages: its state, its motors, and the speeds at which it is in
balance.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike

from groundstation.dynamics.craft import Crafts
from groundstation.dynamics.effect import FAR_M
from groundstation.dynamics.rotations import attitude_of_quaternion, quaternion_of_attitude
from groundstation.dynamics.vehicle import MotorConstants, Motors
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

# The one state vector of a craft, 17 numbers, and what can be read from it.
#
# | slice | quantity | unit |
# |---|---|---|
# | POSITION | x east, y north, z up | m |
# | VELOCITY | the same, inertial frame | m/s |
# | QUATERNION | w, x, y, z, body to inertial | |
# | RATE | p, q, r in the body frame | rad/s |
# | ROTOR | M1..M4 | rev/s |


POSITION, VELOCITY, QUATERNION = slice(0, 3), slice(3, 6), slice(6, 10)
RATE, ROTOR = slice(10, 13), slice(13, 17)
STATES = 17


def craft_state(
    position_m: ArrayLike = 0.0,
    velocity_m_s: ArrayLike = 0.0,
    attitude: ArrayLike = (0.0, 0.0, 0.0),
    rates: ArrayLike = 0.0,
    rotor_rev_s: ArrayLike = 0.0,
) -> Array:
    """One state, shape (17,), from its parts; ``attitude`` is roll, pitch, yaw in rad."""
    state = np.zeros(STATES)
    state[POSITION], state[VELOCITY] = position_m, velocity_m_s
    state[QUATERNION] = quaternion_of_attitude(attitude)
    state[RATE], state[ROTOR] = rates, rotor_rev_s
    return state


def attitude_of(states: ArrayLike) -> Array:
    """Roll, pitch, yaw in rad, (..., 17) to (..., 3)."""
    return attitude_of_quaternion(np.asarray(states, np.float64)[..., QUATERNION])


# The brushed motor with its propeller (thesis 3.15): constants, and speed from voltage.


REVOLUTION = 2 * math.pi


def armature_mv(duty: ArrayLike, supply_v: ArrayLike) -> Array:
    """Mean motor voltage in mV of a PWM-driven switch (thesis eq. 3.83-3.84).

    duty: (..., motors) 0..1; supply_v: (...) in V.
    """
    supply_mv = 1000.0 * np.asarray(supply_v, np.float64)
    return np.asarray(duty, np.float64) * supply_mv[..., None]


def simulate_motor(
    motor: MotorConstants | Motors,
    voltage_mv: ArrayLike,
    period_s: float,
    initial_rev_s: ArrayLike | None = None,
    substeps: int = 2,
    effects: Mapping[str, Mapping[str, float]] | None = None,
) -> tuple[Array, Array]:
    """Rotor speeds driven by voltages that are held over each period (thesis eq. 3.82).

    motor: one for all, or each rotor's. voltage_mv: (k, motors), row i acts from sample i to
    i + 1. effects: listed ones of the motors by name, with their parameters.
    initial_rev_s: (motors,), default: at rest at the first voltage's steady speed.

    Returns speeds (k + 1, motors) in rev/s at the samples, and the mean of the squared speed over
    each period (k, motors) in (rev/s)^2, which is what torques are made of.
    """
    from groundstation.dynamics.craft import craft_of_motors
    from groundstation.dynamics.kernels import run_motors

    voltage = np.ascontiguousarray(voltage_mv, np.float64)
    if voltage.ndim != 2 or len(voltage) == 0:
        raise ValueError(f"voltage_mv has shape {voltage.shape}, expected (samples, motors)")
    start = np.empty(voltage.shape[1])
    start[:] = steady_rev_s(motor, voltage[0]) if initial_rev_s is None else initial_rev_s
    speed = np.empty((len(voltage) + 1, voltage.shape[1]))
    square = np.empty_like(voltage)
    craft = craft_of_motors(motor, effects or {})
    run_motors(craft[0], voltage, np.zeros(0), period_s, substeps, start, speed, square)
    return speed, square


def each_motor(motor: MotorConstants | Motors, count: int = 4) -> tuple[MotorConstants, ...]:
    """A motor for each of ``count`` rotors, of one for all or of four."""
    return (motor,) * count if isinstance(motor, MotorConstants) else motor


def steady_rev_s(motor: MotorConstants | Motors, armature_mv: Array) -> Array:
    """Speeds (motors,) at which constant armature voltages (motors,) settle."""
    motors = each_motor(motor, len(armature_mv))
    return np.array([one.steady_rev_s(mv) for one, mv in zip(motors, armature_mv, strict=True)])


# Fly a craft from armature voltages: one craft, or a batch of them.
#
# Newton-Euler in the body frame (thesis 3.11), attitude as a quaternion; inputs are held over each
# period, as PWM is.


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


# Steady states: the speed that carries a craft, the duty for it, the speed that a duty gives.


HOVER_ROUNDS = 3
"""Thrust goes with the square of the speed but for what effects add to it: each round leaves less
than a hundredth of the error."""


def hover_rev_s(craft: Crafts) -> float:
    """Rotor speed that carries the craft far from the ground, all rotors alike."""
    one = craft[0]
    speed = float(np.sqrt(one["mass"] * one["gravity"] / one["thrust"] / 4.0))
    for _ in range(HOVER_ROUNDS):
        lift = specific_force(craft, craft_state((0.0, 0.0, FAR_M), rotor_rev_s=speed))[2]
        speed *= float(np.sqrt(one["gravity"] / lift))
    return speed


def hover_duty(craft: Crafts, rotor_rev_s: float, supply_mv: ArrayLike) -> Array:
    """Duty 0..1 (k,), mean of the rotors, that holds a speed at reported supplies (k,) in mV."""
    still = np.zeros(4)
    voltages, place = np.unique(np.asarray(supply_mv, np.float64), return_inverse=True)
    speed = np.full(4, rotor_rev_s)
    found = [duties_for(craft, speed, still, float(voltage)).mean() for voltage in voltages]
    return np.array(found)[place]


def duties_for(craft: Crafts, rotor_rev_s: Array, slope: Array, supply_mv: float) -> Array:
    """Duties (4,), within 0..1, that give rotors at a speed (4,) a slope (4,) in rev/s^2."""
    from groundstation.dynamics.kernels import duties

    duty = np.empty(4)
    duties(craft[0], rotor_rev_s, slope, supply_mv, duty)
    return duty


def settled_rev_s(craft: Crafts, duty: Array, supply_mv: float) -> Array:
    """Rotor speeds (4,) that a constant duty (4,) at a reported voltage settles at."""
    from groundstation.dynamics.kernels import settle

    speed = np.empty(4)
    settle(craft[0], duty, supply_mv, speed)
    return speed
