"""What each parameter changes along a true trajectory: plain numpy, written for the bound.

``rate``: angular acceleration (rad/s^2) that becomes a step of the gyro; ``angle``: what an
angle's step gains on the gyro's (rad a row); ``force``: specific force (m/s^2), body axes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

DT = 0.002
G = 9.80665
AIRBORNE_M = 0.012
Columns = dict[str, Array]
"""Row kind (``rate``, ``angle``, ``force``) -> (n, 3). ``felt`` marks a force that only the
sensor feels, not the craft."""


class Signals:
    """A flight's truth as the signals need it. p: PARAMETERS record of the craft that flew."""

    def __init__(self, p: Any, truth: NDArray[np.void]) -> None:
        self.p = p
        self.speed = truth["rotor_rev_s"]
        self.duty = truth["duty"]
        self.supply_mv = truth["supply_mv"]
        self.rate = truth["rate_rad_s"]
        self.height = truth["position_m"][:, 2]
        self.turn = _rotations(truth["quaternion"])  # body to inertial, (n, 3, 3)
        self.velocity = np.einsum("nji,nj->ni", self.turn, truth["velocity_m_s"])
        self.flying = (self.height > AIRBORNE_M) & (self.speed.min(axis=1) > 50.0)
        self.square = p["strength"] * self.speed**2
        mixer = np.stack([p["rotor_y"], -p["rotor_x"], -p["spin"] * p["drag"] / p["thrust"]])
        self.mixer = p["thrust"] * mixer / p["inertia"][:, None]  # rad/s^2 per (rev/s)^2, (3, 4)
        self.per_mass = p["thrust"] / p["mass"]
        armature = self.duty * self.supply_mv[:, None]
        self.slope = p["a0"] * np.maximum(armature - p["dead_mv"], 0.0)
        self.slope = self.slope - p["a1"] * self.speed
        self.slope = self.slope - p["coasting"] * np.minimum(self.slope, 0.0)
        self.slope = self.slope - p["a2"] * self.speed**2
        self.slope = np.where(self.slope < 0, p["braking"] * self.slope, self.slope)
        self.decay = float(np.mean(p["a1"] + 2 * p["a2"] * self.speed[self.flying]))

    def through_motors(self, drive: Array) -> Columns:
        """What a change of dn/dt (n, 4) in rev/s^2 does to torques and thrust."""
        keep = math.exp(-self.decay * DT)
        change = lfilter([(1 - keep) / self.decay], [1, -keep], drive, axis=0)
        return self.from_squares(2.0 * self.p["strength"] * self.speed * change)

    def from_squares(self, squares: Array) -> Columns:
        """What a change of the squared speeds (n, 4) does."""
        force = np.zeros((len(squares), 3))
        force[:, 2] = self.per_mass * squares.sum(axis=1)
        return {"rate": squares @ self.mixer.T, "force": force}

    def torque(self, roll: Array | float, pitch: Array | float, yaw: Array | float) -> Columns:
        """Torques in N m."""
        rows = np.broadcast_arrays(roll, pitch, yaw, np.zeros(len(self.speed)))[:3]
        return {"rate": np.stack(rows, axis=1) / self.p["inertia"]}

    @property
    def acceleration(self) -> Array:
        """Angular acceleration by the rotors alone, without the noise (n, 3)."""
        return np.asarray(self.square @ self.mixer.T)


def base_signals(h: Signals) -> dict[str, Columns]:
    """Signals of the base model's constants at their true values, each 1 in shares."""
    signals = {}
    for axis, name in enumerate(("c0", "c1", "c2")):
        rate = np.zeros((len(h.speed), 3))
        rate[:, axis] = h.acceleration[:, axis]
        signals[name] = {"rate": rate}
    force = np.zeros((len(h.speed), 3))
    force[:, 2] = h.per_mass * h.square.sum(axis=1)
    signals["thrust_per_mass"] = {"force": force}
    p = h.p
    signals["a0"] = h.through_motors(p["a0"] * h.duty * h.supply_mv[:, None])
    signals["a1"] = h.through_motors(-p["a1"] * h.speed)
    signals["a2"] = h.through_motors(-p["a2"] * h.speed**2)
    return signals


def effect_signals(h: Signals, name: str, values: dict[str, float]) -> dict[str, Columns]:
    """Signal of each parameter of an effect at its true value, by parameter."""
    p = h.p
    roll_rate, pitch_rate, yaw_rate = h.rate.T
    thrust = p["thrust"] * h.square.sum(axis=1)
    if name == "dead_time":
        change = np.gradient(h.acceleration, axis=0) / DT
        force = np.zeros_like(h.rate)
        force[:, 2] = -np.gradient(h.per_mass * h.square.sum(axis=1)) / DT
        delay = values["delay_s"]
        return {"delay_s": {"rate": -delay * change, "force": delay * force}}
    if name == "gyro_low_pass":
        lag = 1.0 / (2.0 * math.pi * values["bandwidth_hz"])
        keep = math.exp(-DT / lag)
        lagged = lfilter([1 - keep], [1, -keep], h.acceleration, axis=0)
        missing = lagged - h.acceleration
        slow_rate = lfilter([1 - keep], [1, -keep], h.rate, axis=0)
        return {"bandwidth_hz": {"rate": missing, "angle": (h.rate - slow_rate) * DT}}
    if name == "rotor_gyroscopic_torque":
        momentum = values["rotor_inertia_kg_m2"] * 2 * math.pi * (h.speed @ p["spin"])
        torque = h.torque(-pitch_rate * momentum, roll_rate * momentum, 0.0)
        return {"rotor_inertia_kg_m2": torque}
    if name == "rotor_acceleration_torque":
        gained = values["rotor_inertia_kg_m2"] * 2 * math.pi * (h.slope @ p["spin"])
        return {"rotor_inertia_kg_m2": h.torque(0.0, 0.0, -gained)}
    if name == "inertia_coupling":
        ixx, iyy, izz = p["inertia"]
        f = values["fraction"]
        torque = h.torque(
            f * (iyy - izz) * pitch_rate * yaw_rate,
            f * (izz - ixx) * roll_rate * yaw_rate,
            f * (ixx - iyy) * roll_rate * pitch_rate,
        )
        return {"fraction": torque}
    if name == "rate_damping":
        d = values["damping_n_m_s"]
        return {"damping_n_m_s": h.torque(-d * roll_rate, -d * pitch_rate, 0.0)}
    if name == "quadratic_rate_damping":
        d = values["damping_n_m_s2"]
        on_roll, on_pitch = roll_rate * np.abs(roll_rate), pitch_rate * np.abs(pitch_rate)
        return {"damping_n_m_s2": h.torque(-d * on_roll, -d * on_pitch, 0.0)}
    if name == "yaw_damping":
        return {"damping_n_m_s": h.torque(0.0, 0.0, -values["damping_n_m_s"] * yaw_rate)}
    if name == "centre_of_gravity_offset":
        x, y = values["x_m"], values["y_m"]
        return {"x_m": h.torque(0.0, x * thrust, 0.0), "y_m": h.torque(-y * thrust, 0.0, 0.0)}
    if name == "rotor_mismatch":
        squares = np.zeros_like(h.speed)
        rotor = int(values["rotor"]) - 1
        squares[:, rotor] = values["excess"] * h.speed[:, rotor] ** 2
        return {"excess": h.from_squares(squares)}
    if name == "motor_dead_voltage":
        on = (h.duty * h.supply_mv[:, None] > values["voltage_mv"]).astype(float)
        return {"voltage_mv": h.through_motors(-p["a0"] * values["voltage_mv"] * on)}
    if name == "motor_braking_asymmetry":
        factor = values["factor"]
        raw = np.minimum(h.slope, 0.0) / factor
        return {"factor": h.through_motors((factor - 1.0) * raw)}
    if name == "motor_coasting":
        push = p["a0"] * h.duty * h.supply_mv[:, None] - p["a1"] * h.speed
        return {"share": h.through_motors(-values["share"] * np.minimum(push, 0.0))}
    if name == "supply_sag":
        loss = 1000.0 * values["resistance_ohm"] * _bound_current(h)
        return {"resistance_ohm": h.through_motors(-p["a0"] * h.duty * loss[:, None])}
    if name == "battery_reading_lag":
        terminal = h.supply_mv + 1000.0 * p["supply_ohm"] * _bound_current(h)
        keep = math.exp(-DT / values["time_constant_s"])
        start = [keep * terminal[0]]
        reported, _ = lfilter([1 - keep], [1, -keep], terminal, zi=start)
        ahead = h.duty * (terminal - reported)[:, None]
        return {"time_constant_s": h.through_motors(p["a0"] * ahead)}
    if name == "gyro_bias":
        return {
            key: {"angle": np.full_like(h.rate, -DT * math.radians(value)) * unit}
            for (key, value), unit in zip(values.items(), np.eye(3), strict=True)
        }
    if name == "accelerometer_bias":
        return {
            key: {"force": np.full_like(h.rate, G * value) * unit, "felt": np.zeros(1)}
            for (key, value), unit in zip(values.items(), np.eye(3), strict=True)
        }
    force = np.zeros_like(h.rate)
    force[:, 2] = thrust / p["mass"]
    if name == "imu_misalignment":
        signals = {}
        for (key, value), unit in zip(values.items(), np.eye(3), strict=True):
            turned = math.radians(value) * unit
            signals[key] = {
                "rate": -np.cross(turned, h.acceleration),
                "force": -np.cross(turned, force),
                "felt": np.zeros(1),
            }
        return signals
    forward, left, climb = h.velocity.T
    if name == "rotor_drag":
        drag = values["drag_n_s_m"] / p["mass"]
        along = np.stack([-drag * forward, -drag * left, 0 * climb], axis=1)
        return {"drag_n_s_m": {"force": along}}
    if name == "velocity_moment":
        moment = values["moment"]
        rate = np.stack([moment * left, -moment * forward, 0 * climb], axis=1)
        return {"moment": {"rate": rate}}
    if name == "climb_inflow":
        loss = values["loss_g_per_m_s"] * G * climb
        return {"loss_g_per_m_s": {"force": np.stack([0 * loss, 0 * loss, -loss], axis=1)}}
    if name == "imu_lever_arm":
        signals = {}
        for (key, value), unit in zip(values.items(), np.eye(3), strict=True):
            lever = value * unit
            spun = np.cross(h.rate, np.cross(h.rate, lever))
            signals[key] = {
                "force": np.cross(h.acceleration, lever) + spun,
                "felt": np.zeros(1),
            }
        return signals
    if name == "ground_effect":
        factor = values["gain"] * np.exp(-np.maximum(h.height, 0.0) / values["height_m"])
        signal = h.from_squares(factor[:, None] * h.square)
        signal["rate"][:, 2] = 0.0  # thrust without more drag
        return {"gain": signal}
    if name == "slung_load":
        return {"percent": _swing(h, values)}
    raise ValueError(f"no bound is known for {name}")


def _swing(h: Signals, values: dict[str, float]) -> Columns:
    """What a load on a line does: a small swing, driven by the thrust."""
    p, share = h.p, 0.01 * values["percent"]
    length, damping = values["length_m"], values["damping_per_s"]
    thrust = h.per_mass * h.square.sum(axis=1)
    push = h.turn[:, :, 2] * (thrust * h.flying)[:, None] / (1.0 - share)
    offset, slope = np.zeros(2), np.zeros(2)
    pull = np.zeros_like(push)
    for row, now in enumerate(push):
        back = now[2] / length
        slope = slope - DT * (back * offset + now[:2] + damping * slope)
        offset = offset + DT * slope
        pull[row] = share * np.array([back * offset[0], back * offset[1], -now[2]])
    # Both of inertial axes; less the weight, which is the craft's.
    pulled = np.einsum("nji,nj->ni", h.turn, pull)
    force = np.einsum("nji,nj->ni", h.turn, pull + share * push)
    arm = values["below_m"] * (1.0 - share) * p["mass"]
    return {**h.torque(arm * pulled[:, 1], -arm * pulled[:, 0], 0.0), "force": force}


def _bound_current(h: Signals) -> Array:
    """Summed supply current in A by the bound of the back-EMF constant (supply_sag's law)."""
    p = h.p
    volts = h.duty * h.supply_mv[:, None] - p["back_emf"] * h.speed
    return np.asarray((h.duty * volts).sum(axis=1) / (1000.0 * p["winding_ohm"]))


def _rotations(q: Array) -> Array:
    w, x, y, z = q.T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        axis=1,
    )
