"""What a model leaves unexplained in a flight, row by row, and what each unknown would add to it.

One-step residuals, not free runs (docs/discrepancy.md has the equations):

- gyro: mean angular acceleration between two rows, measured less modelled, rad/s^2;
- accelerometer: specific force, m/s^2;
- attitude, on its fresh rows: Euler rate less the kinematics of the measured gyro, rad/s;
- vertical: a flight's mean vertical specific force less 1 g, one number.

Whatever multiplies a rate or a velocity uses one that was predicted from earlier rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.discrepancy.attitude_rows import AttitudeRows
from groundstation.discrepancy.flight import Flight
from groundstation.discrepancy.own_candidates import OwnEffect
from groundstation.discrepancy.unknowns import ABSENT, LOW_PASS, MOTOR_KEYS, TIMING
from groundstation.dynamics.mixer import MIXERS
from groundstation.dynamics.motor import REVOLUTION
from groundstation.dynamics.rotations import quaternion_of_attitude, rotation_matrix
from groundstation.dynamics.state import POSITION, QUATERNION, RATE, ROTOR, STATES, VELOCITY
from groundstation.dynamics.vehicle import MotorConstants, Vehicle, lever_arm_m
from groundstation.identification.torque import rotor_squares
from groundstation.telemetry.packet import STANDARD_GRAVITY

Array = NDArray[np.float64]
Columns = dict[int, Array]
"""Channel (0..8 as in ``findings.CHANNELS``) -> rows."""

GYRO, ACCELEROMETER, ATTITUDE = 0, 3, 6
SPIN = np.array([-1.0, 1.0, -1.0, 1.0])
SUBSTEPS = 2
FAR_M = 10.0
"""Height that a user's law sees where it is not known: far from the ground."""
LEAK_S, LEANING_LEAK_S = 16.0, 4.0
"""Velocity is known over times shorter than this; an attitude that leans and is carried by the
gyro instead leaves less."""
VOLTAGE_KEYS = (
    "motor_dead_voltage.voltage_mv",
    "motor_braking_asymmetry.factor",
    "supply_sag.resistance_ohm",
    "battery_reading_lag.time_constant_s",
)
STEPS = {
    "a0": 1e-3,
    "a1": 1e-3,
    "a2": 1e-2,
    "motor_dead_voltage.voltage_mv": 5.0,
    "motor_braking_asymmetry.factor": -0.02,
    "supply_sag.resistance_ohm": 0.005,
    "battery_reading_lag.time_constant_s": 0.03,
}
"""Steps of the finite differences through the motors; relative for a0, a1, a2."""


@dataclass(frozen=True, slots=True)
class Frame:
    """What stays fixed in a search: the craft's configuration and scale, filter gains, and the
    user's own effects."""

    vehicle: Vehicle
    rate_gain: tuple[float, float, float] = (0.5, 0.5, 0.5)
    own: tuple[OwnEffect, ...] = ()


@dataclass(slots=True)
class Series:
    """Residuals and columns of one flight at one point.

    residual: channel -> rows. columns: key -> channel -> rows, d model / d key. vertical, lift:
    (residual, {key: derivative}) of the flight's mean vertical specific force less 1 g, as
    measured and as modelled, None without accelerometer or attitude. rate_error: (3,)
    mean squared one-step prediction error of the rates in rad/s.
    """

    residual: Columns
    columns: dict[str, Columns]
    vertical: tuple[float, dict[str, float]] | None
    lift: tuple[float, dict[str, float]] | None
    rate_error: tuple[float, float, float]


@dataclass(slots=True)
class Rotors:
    """end: (n, 4) rev/s at the rows. square: (n, 4) mean square over the period before."""

    end: Array
    square: Array


def value(point: Mapping[str, float], key: str) -> float:
    return point.get(key, ABSENT.get(key, 0.0))


def evaluate(
    flight: Flight, frame: Frame, point: Mapping[str, float], keys: Sequence[str]
) -> Series:
    """Residuals of a flight at ``point`` and the columns of ``keys``."""
    return _Evaluation(flight, frame, point).series(keys)


def rate_errors(
    flight: Flight, frame: Frame, point: Mapping[str, float], gains: Sequence[float]
) -> Array:
    """Mean squared one-step prediction errors (gains, 3) of the rates, (rad/s)^2."""
    evaluation = _Evaluation(flight, frame, point)
    return np.array([evaluation.find_rates((gain, gain, gain)) for gain in gains])


def generic_signals(flight: Flight, frame: Frame, point: Mapping[str, float]) -> dict[str, Array]:
    """Signals (n,) that something unknown may go with: words -> values at every row."""
    return _Evaluation(flight, frame, point).generic()


def spin_rotors(flight: Flight, point: Mapping[str, float], vehicle: Vehicle) -> Rotors:
    """Rotor speeds of a flight: measured, or simulated with the point's motor effects."""
    run = flight.run
    motor = MotorConstants(*(point[key] for key in MOTOR_KEYS))
    if flight.rotor_measured:
        squares = rotor_squares(run, motor, measured=True)
        return Rotors(np.sqrt(squares.end), squares.square)
    from groundstation.discrepancy.kernels import rotor_run

    dead, braking, sag, lag = (value(point, key) for key in VOLTAGE_KEYS)
    constants = np.array([motor.a0, motor.a1, motor.a2, dead, braking, sag / vehicle.winding_ohm])
    supply = 1000.0 * run.supply_v
    start = np.array([motor.steady_rev_s(u) for u in run.duty[0] * supply[0]])
    end, square = np.empty_like(run.duty), np.empty_like(run.duty)
    duty = np.ascontiguousarray(run.duty)
    if lag > 0.0:
        rotor_run(constants, duty, supply, run.period_s, 1, start, end, square)
        supply = supply + _lost_by_lag(flight, supply, end, lag, motor)
    rotor_run(constants, duty, supply, run.period_s, SUBSTEPS, start, end, square)
    return Rotors(end, square)


def _lost_by_lag(
    flight: Flight, supply_mv: Array, speed: Array, lag_s: float, motor: MotorConstants
) -> Array:
    """Real less reported voltage (n,) mV when the report lags by ``lag_s``.

    The reading itself cannot be differentiated: its steps of a millivolt would be amplified. The
    cell can be modelled: E(t) - A sum d^2 V + B sum d n, lagged, is fitted to the report, which
    is what ``identification/supply.py`` does on a bench; E is linear between knots.
    """
    run = flight.run
    load = (run.duty**2).sum(axis=1) * supply_mv
    back = (run.duty * speed).sum(axis=1) * (motor.a1 / motor.a0)
    rows = len(run)
    knots = np.linspace(0, rows - 1, max(2, round(rows * run.period_s / 10.0)) + 1)
    hats = np.maximum(0.0, 1.0 - np.abs(np.arange(rows)[:, None] - knots) / (knots[1] - knots[0]))
    plain = np.column_stack([hats, -load, back])
    lagged = _lagged(plain, lag_s, run.period_s)
    first = min(flight.first, rows // 4)
    normal = lagged[first:].T @ lagged[first:]
    scale = np.sqrt(np.diag(normal)) + 1e-12
    weights = np.linalg.lstsq(
        normal / np.outer(scale, scale), lagged[first:].T @ supply_mv[first:] / scale, rcond=1e-10
    )[0]
    return np.asarray((plain - lagged) @ (weights / scale))


def _lagged(signals: Array, lag_s: float, period_s: float) -> Array:
    from groundstation.discrepancy.kernels import first_order

    out = np.empty_like(signals)
    first_order(np.ascontiguousarray(signals), float(np.exp(-period_s / lag_s)), out)
    return out


class _Evaluation:
    """One flight at one point; every array here covers all rows of the run."""

    def __init__(self, flight: Flight, frame: Frame, point: Mapping[str, float]) -> None:
        self.flight, self.frame, self.point = flight, frame, point
        run, vehicle = flight.run, frame.vehicle
        self.period = run.period_s
        self.mixer = MIXERS[vehicle.configuration]
        self.c = np.array([point["c0"], point["c1"], point["c2"]])
        self.lift = point["thrust_per_mass"]
        lever = lever_arm_m(vehicle)
        thrust = vehicle.mass_kg * self.lift
        ixx, iyy = thrust * lever / self.c[0], thrust * lever / self.c[1]
        px, py, pz = vehicle.inertia_kg_m2
        self.inertia = np.array([ixx, iyy, pz / (px + py) * (ixx + iyy)])
        self.lever = lever
        self.delay = value(point, "dead_time.delay_s")
        self.lag = value(point, LOW_PASS)
        angles = np.radians([value(point, f"imu_misalignment.{a}_deg") for a in ANGLES])
        self.mount = rotation_matrix(angles)
        bias = np.radians([value(point, f"gyro_bias.{a}_dps") for a in AXES])
        offset = STANDARD_GRAVITY * np.array(
            [value(point, f"accelerometer_bias.{a}_g") for a in AXES]
        )
        self.sensed_gyro = run.gyro - bias
        self.gyro = self.sensed_gyro @ self.mount.T
        self.sensed_force = run.accelerometer - offset
        self.force = self.sensed_force @ self.mount.T
        self.height = self._ground_share(value(point, "ground_effect.height_m"))
        self.rotors = spin_rotors(flight, point, vehicle)
        self._mixed: tuple[Array, Array, Array, Array] | None = None
        self.rates, self.news = np.zeros_like(run.gyro), np.zeros_like(run.gyro)
        self.velocity = np.zeros_like(run.gyro)
        if flight.up is not None:
            self._find_velocity()
        # Rates need the model's acceleration and the model needs rates: the first pass takes
        # the last row's, the second the filter's.
        self.rates[1:] = self.gyro[:-1]
        self.gyro_model, self.force_model = self.body(self.rotors)
        self.rate_error = self.find_rates(frame.rate_gain)
        theirs = any(one.present(point) for one in frame.own)
        if theirs or any(value(point, key) for key in RATE_KEYS):
            self.gyro_model, _ = self.body(self.rotors)
            self.find_rates(frame.rate_gain)
            self.gyro_model, self.force_model = self.body(self.rotors)

    # What the past tells.

    def _find_velocity(self) -> None:
        from groundstation.discrepancy.kernels import body_velocity

        # A lean turns the attitude until no acceleration is felt, and a filter that takes every
        # second row of the gyro folds vibration into it: over seconds the gyro knows better.
        leaning = value(self.point, "attitude_filter_lean.strength") > 0.0
        attitude = self.flight.run.attitude
        if leaning and self.flight.carried is not None:
            attitude = self.flight.carried
        body_velocity(
            np.ascontiguousarray(attitude),
            np.ascontiguousarray(self.sensed_force),
            STANDARD_GRAVITY,
            self.period,
            LEANING_LEAK_S if leaning else LEAK_S,
            self.flight.first,
            self.velocity,
        )
        self.velocity = self.velocity @ self.mount.T

    def find_rates(self, gain: tuple[float, float, float]) -> tuple[float, float, float]:
        """Fill ``rates`` and ``news``; returns the mean squared prediction error (3,)."""
        from groundstation.discrepancy.kernels import predict_rates

        found: tuple[float, float, float] = predict_rates(
            self.gyro,
            self.flight.known,
            self.gyro_model,
            self.period,
            np.array(gain),
            max(self.flight.first - 1, 0),
            self.rates,
            self.news,
        )
        # The share of an innovation that is torque, not sensor noise, in a filter with this gain.
        self.news *= np.array(gain) ** 2 / self.period
        # Behind a lag of the gyro the true rate is ahead of it.
        self.rates += self.lag * self.gyro_model
        return found

    # The model.

    def _ground_share(self, scale_m: float) -> Array:
        return np.exp(-np.maximum(self.flight.height_m, 0.0) / scale_m)

    def shift_end(self, values: Array) -> Array:
        """Values at the rows, as they were ``delay`` before."""
        if self.delay == 0.0:
            return values
        at = np.arange(len(values), dtype=np.float64) - self.delay / self.period
        return _linear(values, at)

    def shift_mean(self, means: Array, ends: Array) -> Array:
        """Means over the periods before the rows, as they were ``delay`` before."""
        if self.delay == 0.0:
            return means
        at = np.arange(-1.0, len(means)) - self.delay / self.period
        integral = _hermite(np.cumsum(means, axis=0), ends, at)
        return np.diff(integral, axis=0)

    def lagged(self, values: Array) -> Array:
        """What the gyro shows of an angular acceleration."""
        if self.lag <= 0.0:
            return values
        return _low_pass(values, self.lag, self.period, max(self.flight.first - 1, 0))

    def torques(self, rotors: Rotors) -> tuple[Array, Array, Array, Array]:
        """Shifted by the delay: u' as mean (n, 3) and at the row (n, 3), sums of squares."""
        if rotors is self.rotors and self._mixed is not None:
            return self._mixed
        from groundstation.discrepancy.kernels import mix_squares

        strength = 1.0 + np.array([value(self.point, f"rotor_mismatch.{i}") for i in (1, 2, 3, 4)])
        mean, last = np.empty_like(rotors.square), np.empty_like(rotors.square)
        mix_squares(rotors.end, rotors.square, strength, self.mixer, mean, last)
        mean, last = self.shift_mean(mean, last), self.shift_end(last)
        mixed = mean[:, :3], last[:, :3], mean[:, 3], last[:, 3]
        if rotors is self.rotors:
            self._mixed = mixed
        return mixed

    def body(self, rotors: Rotors) -> tuple[Array, Array]:
        """Modelled angular acceleration that the gyro shows (mean over the period before each
        row) and specific force at each row, (n, 3) both, in the body frame."""
        mean, last, mean_sum, last_sum = self.torques(rotors)
        plain = self.extra(rotors)
        gain = value(self.point, "ground_effect.gain")
        ground = 1.0 + gain * self.height
        forward = value(self.point, "centre_of_gravity_offset.x_m") / self.lever
        left = value(self.point, "centre_of_gravity_offset.y_m") / self.lever
        twist = np.empty_like(mean)
        for target, torque, total in ((twist, mean, mean_sum),):
            target[:, 0] = self.c[0] * ground * (torque[:, 0] - left * total)
            target[:, 1] = self.c[1] * ground * (torque[:, 1] + forward * total)
            target[:, 2] = self.c[2] * torque[:, 2]
        angular = self.lagged(twist + plain)
        force = np.zeros_like(mean)
        force[:, 2] = self.lift * ground * last_sum
        self._add_forces(force, last, last_sum, ground, plain, forward, left)
        return angular, force

    def _add_forces(
        self,
        force: Array,
        last: Array,
        last_sum: Array,
        ground: Array,
        plain: Array,
        forward: float,
        left: float,
    ) -> None:
        point, v = self.point, self.velocity
        drag = value(point, "rotor_drag.drag_n_s_m") / self.frame.vehicle.mass_kg
        if drag:
            force[:, :2] -= drag * v[:, :2]
        inflow = STANDARD_GRAVITY * value(point, "climb_inflow.loss_g_per_m_s")
        if inflow:
            force[:, 2] -= inflow * v[:, 2]
        self.alpha = plain + self.c * last
        self.alpha[:, 0] = plain[:, 0] + self.c[0] * ground * (last[:, 0] - left * last_sum)
        self.alpha[:, 1] = plain[:, 1] + self.c[1] * ground * (last[:, 1] + forward * last_sum)
        for one in self.frame.own:
            if one.present(point):
                force += one.acceleration(point, *self.states(self.rotors))[:, 3:]
        for axis, name in enumerate(AXES):
            arm = value(point, f"imu_lever_arm.{name}_m")
            if arm:
                force += arm * self.lever_column(axis)

    def lever_column(self, axis: int) -> Array:
        """Specific force (n, 3) per metre of lever arm along an axis.

        The accelerometer has no part in the gyro's noise, so what the present row says of a
        disturbance may be used here.
        """
        alpha = self.alpha + self.news
        rate = self.rates + 0.5 * self.period * self.alpha
        unit = np.zeros(3)
        unit[axis] = 1.0
        square = (rate**2).sum(axis=1)
        column: Array = np.cross(alpha, unit) + rate * rate[:, axis : axis + 1]
        column[:, axis] -= square
        return column

    def spin_of(self, rotors: Rotors) -> tuple[Array, Array]:
        """Mean of w = -n1+n2-n3+n4 (rad/s) over each period and its slope, (n,) both."""
        w = self.shift_end((REVOLUTION * rotors.end @ SPIN)[:, None])[:, 0]
        before = np.concatenate([w[:1], w[:-1]])
        return 0.5 * (w + before), (w - before) / self.period

    def extra(self, rotors: Rotors) -> Array:
        """Angular acceleration (n, 3) of the accepted effects that come from rates and rotors."""
        total = np.zeros((len(self.gyro), 3))
        for key in BODY_EFFECTS:
            size = value(self.point, key)
            if size:
                total += size * self.body_column(key, rotors)
        for one in self.frame.own:
            if one.present(self.point):
                total += one.acceleration(self.point, *self.states(rotors))[:, :3]
        return total

    def states(self, rotors: Rotors) -> tuple[Array, Array]:
        """States (n, 17) as a user's law wants them, and rotor slopes (n, 4), in the middle of the
        period before each row. Of the position only a height near the ground is known; elsewhere
        it is ``FAR_M``."""
        flight = self.flight
        rows = len(self.rates)
        attitude = flight.run.attitude if flight.attitude is not None else np.zeros((rows, 3))
        ends = self.shift_end(rotors.end)
        before = np.concatenate([ends[:1], ends[:-1]])
        height = np.where(np.isfinite(flight.height_m), flight.height_m, FAR_M)
        states = np.zeros((rows, STATES))
        states[:, POSITION.stop - 1] = np.minimum(height, FAR_M)
        states[:, VELOCITY] = np.einsum("nij,nj->ni", rotation_matrix(attitude), self.velocity)
        states[:, QUATERNION] = quaternion_of_attitude(attitude)
        states[:, RATE], states[:, ROTOR] = self.rates, 0.5 * (ends + before)
        return states, (ends - before) / self.period

    def body_column(self, key: str, rotors: Rotors) -> Array:
        """Angular acceleration (n, 3) per unit of an effect that is linear in it."""
        p, q, r = self.rates.T
        ixx, iyy, izz = self.inertia
        out = np.zeros((len(p), 3))
        if key == "rotor_gyroscopic_torque.rotor_inertia_kg_m2":
            w, _ = self.spin_of(rotors)
            out[:, 0], out[:, 1] = q * w / ixx, -p * w / iyy
        elif key == "rotor_acceleration_torque.rotor_inertia_kg_m2":
            out[:, 2] = self.spin_of(rotors)[1] / izz
        elif key == "inertia_coupling.fraction":
            out[:, 0] = (iyy - izz) / ixx * q * r
            out[:, 1] = (izz - ixx) / iyy * p * r
            out[:, 2] = (ixx - iyy) / izz * p * q
        elif key == "rate_damping.damping_n_m_s":
            out[:, 0], out[:, 1] = -p / ixx, -q / iyy
        elif key == "quadratic_rate_damping.damping_n_m_s2":
            out[:, 0], out[:, 1] = -p * np.abs(p) / ixx, -q * np.abs(q) / iyy
        elif key == "yaw_damping.damping_n_m_s":
            out[:, 2] = -r / izz
        elif key == "velocity_moment.moment":
            out[:, 0], out[:, 1] = self.velocity[:, 1], -self.velocity[:, 0]
        return out

    def generic(self) -> dict[str, Array]:
        """See ``generic_signals``."""
        p, q, r = self.rates.T
        mean, _, total, _ = self.torques(self.rotors)
        w, spun = self.spin_of(self.rotors)
        found = {"a constant": np.ones(len(p))}
        for name, rate in zip(ANGLES, (p, q, r), strict=True):
            found[f"the {name} rate"] = rate
            found[f"the {name} rate times its magnitude"] = rate * np.abs(rate)
        found["pitch rate times yaw rate"] = q * r
        found["roll rate times yaw rate"] = p * r
        found["roll rate times pitch rate"] = p * q
        for name, torque in zip(ANGLES, mean.T, strict=True):
            found[f"the {name} torque"] = torque
        found["the total thrust"] = total
        found["the change of thrust"] = np.diff(total, prepend=total[:1])
        found["the rotors' acceleration"] = spun
        found["pitch rate times rotor speeds"] = q * w
        found["roll rate times rotor speeds"] = p * w
        if self.flight.up is not None:
            for name, speed in zip(("forward", "leftward", "upward"), self.velocity.T, strict=True):
                found[f"the {name} velocity"] = speed
            found["the roll angle"] = np.sin(self.flight.run.attitude[:, 0])
            found["the pitch angle"] = np.sin(self.flight.run.attitude[:, 1])
        return found

    # Residuals and columns.

    def series(self, keys: Sequence[str]) -> Series:
        flight, run = self.flight, self.flight.run
        residual: Columns = {}
        measured = np.diff(self.gyro, axis=0, prepend=self.gyro[:1]) / self.period
        self._put_gyro(residual, measured - self.gyro_model)
        if flight.has_accelerometer:
            self._put_force(residual, self.force - self.force_model)
        if flight.attitude is not None:
            euler = self._euler_residual(flight.attitude)
            residual.update({ATTITUDE + i: euler[:, i] for i in range(3)})
        columns: dict[str, Columns] = {}
        for key in keys:
            column: Columns = {}
            self._column(key, column)
            columns[key] = column
        vertical = None
        if flight.up is not None:
            up, mean = flight.up
            offset = run.accelerometer[0] - self.sensed_force[0]
            slopes = (STANDARD_GRAVITY * up).tolist()
            names = (f"accelerometer_bias.{a}_g" for a in AXES)
            vertical = (
                mean - float(up @ offset) - STANDARD_GRAVITY,
                dict(zip(names, slopes, strict=True)),
            )
        return Series(residual, columns, vertical, self._lift(columns), self.rate_error)

    def _lift(self, columns: Mapping[str, Columns]) -> tuple[float, dict[str, float]] | None:
        """1 g less what the model says of the mean vertical force while airborne."""
        if self.flight.up is None:
            return None
        rows = self.flight.rows
        up = rotation_matrix(self.flight.run.attitude[rows])[:, 2] @ self.mount.T
        mean = float(np.einsum("ni,ni->n", up, self.force_model[rows]).mean())
        lifting = {*LIFTING, *(one.effect.name for one in self.frame.own)}
        slopes = {
            key: float(sum((up[:, c - 3] * v).mean() for c, v in column.items() if 3 <= c < 6))
            for key, column in columns.items()
            if key.partition(".")[0] in lifting
        }
        return STANDARD_GRAVITY - mean, slopes

    def _put_gyro(self, out: Columns, values: Array) -> None:
        part = self.flight.gaps.spread(values[self.flight.rows])
        for axis in range(3):
            if part[:1000, axis].any() or part[:, axis].any():
                out[GYRO + axis] = part[:, axis]

    def _put_force(self, out: Columns, values: Array) -> None:
        part = self.flight.gaps.bridge(values[self.flight.rows])
        for axis in range(3):
            if part[:, axis].any():
                out[ACCELEROMETER + axis] = part[:, axis]

    def _column(self, key: str, out: Columns) -> None:
        effect, _, parameter = key.partition(".")
        rows = self.flight.attitude
        theirs = next((one for one in self.frame.own if key in one.keys), None)
        if theirs is not None:
            added = theirs.column(key, self.point, *self.states(self.rotors))
            self._put_gyro(out, self.lagged(added[:, :3]))
            if self.flight.has_accelerometer:
                self._put_force(out, added[:, 3:])
        elif key in ("c0", "c1", "c2"):
            self._constant(int(key[1]), out)
        elif key == "thrust_per_mass":
            if self.flight.has_accelerometer:
                force = np.zeros_like(self.force_model)
                force[:, 2] = self.force_model[:, 2] / self.lift
                self._put_force(out, force)
            self._put_gyro(out, self.lagged(-self.by_inertia() / self.lift))
        elif key in MOTOR_KEYS or key in VOLTAGE_KEYS:
            if not self.flight.rotor_measured:
                self._motor_column(key, out)
        elif key == TIMING:
            self._put_attitude(out, rows.timing if rows else None)
        elif key in BODY_EFFECTS:
            column = self.body_column(key, self.rotors)
            self._put_gyro(out, self.lagged(column))
        elif effect == "dead_time":
            self._delay_column(out)
        elif effect == "gyro_low_pass":
            self._lag_column(out)
        elif effect in ("centre_of_gravity_offset", "rotor_mismatch", "ground_effect"):
            self._thrust_column(effect, parameter, out)
        elif effect == "gyro_bias":
            unit = np.zeros(3)
            unit[AXES.index(parameter[0])] = -np.pi / 180.0
            if rows is not None:
                self._put_attitude(out, np.broadcast_to(unit, rows.rate.shape))
        elif effect == "imu_misalignment":
            self._mount_column(ANGLES.index(parameter.removesuffix("_deg")), out)
        elif effect == "attitude_filter_lean":
            self._put_attitude(out, rows.lean - self.lag * rows.slope if rows else None)
        elif self.flight.has_accelerometer:
            self._force_column(effect, parameter, out)

    def _constant(self, axis: int, out: Columns) -> None:
        mean, _, mean_sum, _ = self.torques(self.rotors)
        column = np.zeros_like(mean)
        ground = 1.0 + value(self.point, "ground_effect.gain") * self.height
        arm = [
            -value(self.point, "centre_of_gravity_offset.y_m") / self.lever,
            value(self.point, "centre_of_gravity_offset.x_m") / self.lever,
        ]
        if axis < 2:
            column[:, axis] = ground * (mean[:, axis] + arm[axis] * mean_sum)
        else:
            column[:, 2] = mean[:, 2]
        if axis < 2:
            # The inertia follows from c0 and c1, and with it what other torques do.
            heavy = self.by_inertia()
            column[:, axis] += heavy[:, axis] / self.c[axis]
            share = self.inertia[axis] / (self.inertia[0] + self.inertia[1])
            column[:, 2] += share * heavy[:, 2] / self.c[axis]
        self._put_gyro(out, self.lagged(column))

    def by_inertia(self) -> Array:
        """Angular acceleration (n, 3) by accepted torques in N m, which the inertia divides."""
        total = np.zeros((len(self.gyro), 3))
        for key in TORQUES:
            size = value(self.point, key)
            if size:
                total += size * self.body_column(key, self.rotors)
        return total

    def _motor_column(self, key: str, out: Columns) -> None:
        step = STEPS[key] * (self.point[key] if key in MOTOR_KEYS else 1.0)
        moved = {**self.point, key: value(self.point, key) + step}
        rotors = spin_rotors(self.flight, moved, self.frame.vehicle)
        alpha = self.alpha
        angular, force = self.body(rotors)
        self.alpha = alpha
        self._put_gyro(out, (angular - self.gyro_model) / step)
        if self.flight.has_accelerometer:
            self._put_force(out, (force - self.force_model) / step)

    def _delay_column(self, out: Columns) -> None:
        mean, last, _, last_sum = self.torques(self.rotors)
        slope = -np.diff(last, axis=0, prepend=last[:1]) / self.period
        _, gained = self.spin_of(self.rotors)
        column = self.c * slope
        size = value(self.point, "rotor_acceleration_torque.rotor_inertia_kg_m2")
        if size:
            column[:, 2] -= (
                size / self.inertia[2] * np.diff(gained, prepend=gained[:1]) / self.period
            )
        self._put_gyro(out, self.lagged(column))
        if self.flight.has_accelerometer:
            force = np.zeros_like(mean)
            force[:, 2] = -self.lift * np.diff(last_sum, prepend=last_sum[:1]) / self.period
            self._put_force(out, force)

    def _lag_column(self, out: Columns) -> None:
        step = max(2e-4, 0.02 * self.lag)
        start = max(self.flight.first - 1, 0)
        plain, lag = self.lag, self.lag
        self.lag = 0.0
        angular, _ = self.body(self.rotors)
        self.lag = plain
        column = _low_pass(angular, lag + step, self.period, start) - self.gyro_model
        self._put_gyro(out, column / step)
        if self.flight.attitude is not None:
            self._put_attitude(out, self.true_attitude() * self.flight.attitude.slope)

    def true_attitude(self) -> float:
        """1 where the attitude is the true one, 0 where a filter makes it of this very gyro,
        whose lag is then in both."""
        return 1.0 - value(self.point, "attitude_filter_lean.strength")

    def _thrust_column(self, effect: str, parameter: str, out: Columns) -> None:
        mean, _, mean_sum, last_sum = self.torques(self.rotors)
        angular, force = np.zeros_like(mean), np.zeros_like(mean)
        if effect == "centre_of_gravity_offset":
            axis, sign = (1, 1.0) if parameter == "x_m" else (0, -1.0)
            angular[:, axis] = sign * self.c[axis] * mean_sum / self.lever
        elif effect == "rotor_mismatch":
            rotor = int(parameter) - 1
            alone = np.zeros(4)
            alone[rotor] = 1.0
            only = Rotors(self.rotors.end * alone, self.rotors.square * alone)
            mean, _, mean_sum, last_sum = self.torques(only)
            strength = 1.0 + value(self.point, f"rotor_mismatch.{parameter}")
            angular[:] = self.c * mean / strength
            force[:, 2] = self.lift * last_sum / strength
        else:
            share = self.height
            if parameter == "height_m":
                scale = value(self.point, "ground_effect.height_m")
                z = np.where(np.isfinite(self.flight.height_m), self.flight.height_m, 0.0)
                share = value(self.point, "ground_effect.gain") * self.height * z / scale**2
            angular[:, :2] = self.c[:2] * mean[:, :2] * share[:, None]
            force[:, 2] = self.lift * last_sum * share
        self._put_gyro(out, self.lagged(angular))
        if self.flight.has_accelerometer and force.any():
            self._put_force(out, force)

    def _mount_column(self, axis: int, out: Columns) -> None:
        """M dM^T/da times what the model says in the body: the sensor sees M^T of it."""
        angles = np.radians([value(self.point, f"imu_misalignment.{a}_deg") for a in ANGLES])
        step = np.zeros(3)
        step[axis] = 1e-4
        turn = (rotation_matrix(angles + step) - rotation_matrix(angles - step)) / 2e-4
        change = self.mount @ turn.T * np.radians(1.0)
        self._put_gyro(out, self.gyro_model @ change.T)
        if self.flight.has_accelerometer:
            self._put_force(out, self.force_model @ change.T)

    def _force_column(self, effect: str, parameter: str, out: Columns) -> None:
        force = np.zeros_like(self.force_model)
        if effect == "accelerometer_bias":
            force[:] = STANDARD_GRAVITY * self.mount[:, AXES.index(parameter[0])]
        elif effect == "rotor_drag":
            force[:, :2] = -self.velocity[:, :2] / self.frame.vehicle.mass_kg
        elif effect == "climb_inflow":
            force[:, 2] = -STANDARD_GRAVITY * self.velocity[:, 2]
        elif effect == "imu_lever_arm":
            force[:] = self.lever_column(AXES.index(parameter[0]))
        self._put_force(out, force)

    # Attitude.

    def _euler_residual(self, rows: AttitudeRows) -> Array:
        """Measured Euler rates less the kinematics of what the gyro means, (m, 3).

        Behind a lag the rate is ahead of the gyro by the lag times its slope. The measured
        slope: the model's lacks what disturbances do, which the controller answers, and the
        noise of a difference is not in the mean of the same rows.
        """
        bias = self.flight.run.gyro[0] - self.sensed_gyro[0]
        total = rows.gyro - bias + value(self.point, TIMING) * rows.timing
        total = total + self.true_attitude() * self.lag * rows.slope
        total = total + value(self.point, "attitude_filter_lean.strength") * rows.lean
        model = np.einsum("nij,nj->ni", rows.to_euler, total)
        return np.asarray(rows.rate - rows.gaps.spread(model))

    def _put_attitude(self, out: Columns, rates: Array | None) -> None:
        rows = self.flight.attitude
        if rows is None or rates is None:
            return
        euler = rows.gaps.spread(np.einsum("nij,nj->ni", rows.to_euler, rates))
        for axis in range(3):
            if euler[:, axis].any():
                out[ATTITUDE + axis] = euler[:, axis]


AXES = ("x", "y", "z")
ANGLES = ("roll", "pitch", "yaw")
BODY_EFFECTS = (
    "rotor_gyroscopic_torque.rotor_inertia_kg_m2",
    "rotor_acceleration_torque.rotor_inertia_kg_m2",
    "inertia_coupling.fraction",
    "rate_damping.damping_n_m_s",
    "quadratic_rate_damping.damping_n_m_s2",
    "yaw_damping.damping_n_m_s",
    "velocity_moment.moment",
)
"""Angular accelerations that are linear in their parameter."""
LIFTING = (
    "thrust_per_mass",
    *MOTOR_KEYS,
    *(key.partition(".")[0] for key in VOLTAGE_KEYS),
    "rotor_mismatch",
    "rotor_drag",
    "climb_inflow",
    "ground_effect",
)
"""What changes the force itself, not how the accelerometer shows it."""
TORQUES = tuple(k for k in BODY_EFFECTS if k.endswith(("kg_m2", "n_m_s", "n_m_s2")))
RATE_KEYS = (*BODY_EFFECTS, LOW_PASS, *(f"imu_lever_arm.{axis}_m" for axis in AXES))
"""Where one of these is there, the model depends on the rates."""


def _low_pass(values: Array, lag: float, period: float, first: int) -> Array:
    from groundstation.discrepancy.kernels import low_pass_mean

    out = np.empty_like(values)
    low_pass_mean(np.ascontiguousarray(values), lag, period, first, out)
    return out


def _linear(values: Array, at: Array) -> Array:
    place = np.clip(at, 0, len(values) - 1.0)
    index = np.minimum(place.astype(np.int64), len(values) - 2)
    share = (place - index)[:, None]
    return np.asarray(values[index] + share * (values[index + 1] - values[index]))


def _hermite(values: Array, slopes: Array, at: Array) -> Array:
    """Cubic interpolation of a running sum whose slope per row is known."""
    place = np.clip(at, 0, len(values) - 1.0)
    index = np.minimum(place.astype(np.int64), len(values) - 2)
    t = (place - index)[:, None]
    one, other = values[index], values[index + 1]
    rise, end = slopes[index], slopes[index + 1]
    return np.asarray(
        one * (1 + 2 * t) * (1 - t) ** 2
        + rise * t * (1 - t) ** 2
        + other * t**2 * (3 - 2 * t)
        + end * t**2 * (t - 1)
    )
