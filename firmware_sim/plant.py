"""The craft as a body in space: four motors, six degrees of freedom, the ground.

State vector (see ``layout``): position and velocity in the inertial frame (ENU), quaternion
body to inertial, body rates (FLU), rotor speeds in rev/s, then, only where something needs
them, rotor phases, sensor filters and the states of unlisted effects. Between two passes the
PWM, the battery voltage and the noise are constant; a classical Runge-Kutta step keeps the
numerical error below the noise by many orders (a step of 0.5 ms is 1/100 of the fastest time
constant in flight).
"""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.centre_of_gravity_offset import gravity_offset_torque
from firmware_sim.effects.climb_inflow import inflow_loss
from firmware_sim.effects.cracked_arm import cracked_arm
from firmware_sim.effects.ground_effect import ground_factor
from firmware_sim.effects.inertia_coupling import coupling_torque
from firmware_sim.effects.motor_braking_asymmetry import braked
from firmware_sim.effects.motor_coasting import driven
from firmware_sim.effects.motor_dead_voltage import armature_mv
from firmware_sim.effects.own import lawful_body, lawful_motor, lawful_rotors
from firmware_sim.effects.propeller_imbalance import propeller_imbalance
from firmware_sim.effects.quadratic_rate_damping import quadratic_damping
from firmware_sim.effects.rate_damping import linear_damping
from firmware_sim.effects.rotor_acceleration_torque import acceleration_torque
from firmware_sim.effects.rotor_drag import drag_force
from firmware_sim.effects.rotor_gyroscopic_torque import gyroscopic_torque
from firmware_sim.effects.side_gust import side_gust
from firmware_sim.effects.slung_load import slung_load
from firmware_sim.effects.velocity_moment import flapping_acceleration
from firmware_sim.effects.wind import wind
from firmware_sim.effects.yaw_damping import turn_damping
from firmware_sim.imu import filter_slopes
from firmware_sim.layout import (
    CORE_STATES,
    FIXED,
    FREE,
    GYRO_LAG,
    PHASE,
    QUATERNION,
    RATE,
    ROTOR,
    VELOCITY,
    Record,
)

GROUND_PULSATION = 125.0
"""The legs: a critically damped spring of 20 Hz under the craft's weight, rad/s."""
GROUND_RUB = 2500.0
"""1/s: how fast the legs' friction takes a yaw rate away. Rotors that run down after the motor test
must not turn a craft while its gyro is calibrated: the offset would stay for the whole flight."""
HAND_PULSATION = 25.0
"""How stiffly a hand holds the craft at an attitude, rad/s."""


@inner
def integrate(p: Record, s: Record, start_s: float, span_s: float) -> None:
    """Advance ``s.y`` by ``span_s`` with inputs held (Runge-Kutta, order 4)."""
    y, start, slope, total = s.y, s.start, s.slope, s.sum
    n = p.states
    steps = max(1, math.ceil(span_s / p.longest_step - 1e-9))
    h = span_s / steps
    for step in range(steps):
        t = start_s + step * h
        for i in range(n):
            start[i] = y[i]
        derivative(p, s, t, y, total)
        for i in range(n):
            y[i] = start[i] + 0.5 * h * total[i]
        derivative(p, s, t + 0.5 * h, y, slope)
        for i in range(n):
            total[i] += 2.0 * slope[i]
            y[i] = start[i] + 0.5 * h * slope[i]
        derivative(p, s, t + 0.5 * h, y, slope)
        for i in range(n):
            total[i] += 2.0 * slope[i]
            y[i] = start[i] + h * slope[i]
        derivative(p, s, t + h, y, slope)
        for i in range(n):
            y[i] = start[i] + h / 6.0 * (total[i] + slope[i])
        for i in range(ROTOR, ROTOR + 4):
            y[i] = max(y[i], 0.0)
    norm = math.sqrt(y[6] * y[6] + y[7] * y[7] + y[8] * y[8] + y[9] * y[9])
    for i in range(QUATERNION, QUATERNION + 4):
        y[i] /= norm


@inner
def derivative(p: Record, s: Record, time_s: float, y: Any, dy: Any) -> None:
    """dy/dt; leaves the specific force (m/s^2, body axes) in ``s.force``."""
    w, a, b, c = y[6], y[7], y[8], y[9]
    roll_rate, pitch_rate, yaw_rate = y[10], y[11], y[12]
    # Third column of R (body z in the inertial frame) and the rest where needed (eq. 3.6).
    r13, r23, r33 = 2 * (a * c + w * b), 2 * (b * c - w * a), 1 - 2 * (a * a + b * b)
    r11, r12 = 1 - 2 * (b * b + c * c), 2 * (a * b - w * c)
    r21, r22 = 2 * (a * b + w * c), 1 - 2 * (a * a + c * c)
    r31, r32 = 2 * (a * c - w * b), 2 * (b * c + w * a)

    thrust = 0.0
    roll = 0.0
    pitch = 0.0
    yaw = 0.0
    spin_sum = 0.0
    spin_acceleration = 0.0
    lift = p.thrust
    if p.ground_gain != 0.0:
        lift *= ground_factor(p, y[2])
    for i in range(4):
        speed = y[ROTOR + i]
        acceleration = rotor_acceleration(p, i, armature_mv(p, s.duty[i] * s.supply_mv), speed)
        if p.lawful != 0:
            armature = armature_mv(p, s.duty[i] * s.supply_mv)
            acceleration = lawful_motor(p, i, armature, speed, acceleration)
        dy[ROTOR + i] = acceleration
        square = p.strength[i] * speed * speed
        one = lift * square
        if p.arm_gain != 0.0 and p.arm_rotor == i:
            one += cracked_arm(p, y, dy, one)
        thrust += one
        roll += p.rotor_y[i] * one
        pitch -= p.rotor_x[i] * one
        yaw -= p.spin[i] * p.drag * square
        spin_sum += p.spin[i] * speed
        spin_acceleration += p.spin[i] * acceleration

    if p.lawful != 0:
        thrust, roll, pitch, yaw = lawful_rotors(p, y, dy, (thrust, roll, pitch, yaw))
    if p.rotor_inertia_gyro != 0.0:
        on_roll, on_pitch = gyroscopic_torque(p, roll_rate, pitch_rate, spin_sum)
        roll += on_roll
        pitch += on_pitch
    if p.rotor_inertia_yaw != 0.0:
        yaw += acceleration_torque(p, spin_acceleration)
    if p.coupling != 0.0:
        on_roll, on_pitch, on_yaw = coupling_torque(p, roll_rate, pitch_rate, yaw_rate)
        roll += on_roll
        pitch += on_pitch
        yaw += on_yaw
    if p.tilt_damping != 0.0 or p.quadratic_damping != 0.0:
        roll += linear_damping(p, roll_rate) + quadratic_damping(p, roll_rate)
        pitch += linear_damping(p, pitch_rate) + quadratic_damping(p, pitch_rate)
    if p.turn_damping != 0.0:
        yaw += turn_damping(p, yaw_rate)
    if p.gravity_x != 0.0 or p.gravity_y != 0.0:
        on_roll, on_pitch = gravity_offset_torque(p, thrust)
        roll += on_roll
        pitch += on_pitch

    # Body forces in N; inertial acceleration of everything but gravity.
    force_x = 0.0
    force_y = 0.0
    force_z = thrust
    moment_x = 0.0
    moment_y = 0.0
    if p.plane_drag != 0.0 or p.flapping != 0.0 or p.inflow != 0.0:
        forward = r11 * y[3] + r21 * y[4] + r31 * y[5]
        left = r12 * y[3] + r22 * y[4] + r32 * y[5]
        climb = r13 * y[3] + r23 * y[4] + r33 * y[5]
        force_x, force_y = drag_force(p, forward, left)
        moment_x, moment_y = flapping_acceleration(p, forward, left)
        force_z += p.mass * inflow_loss(p, climb)
    twist = 0.0
    if p.lawful != 0:
        turn = (
            roll / p.inertia[0] + moment_x,
            pitch / p.inertia[1] + moment_y,
            yaw / p.inertia[2],
        )
        felt = (force_x / p.mass, force_y / p.mass, force_z / p.mass)
        own, felt = lawful_body(p, y, dy, thrust, turn, felt)
        moment_x += own[0] - turn[0]
        moment_y += own[1] - turn[1]
        twist = own[2] - turn[2]
        force_x, force_y, force_z = p.mass * felt[0], p.mass * felt[1], p.mass * felt[2]
    if p.states > CORE_STATES:
        for i in range(4):
            dy[PHASE + i] = y[ROTOR + i]
        if p.shaking_pull != 0.0 or p.shaking_twist != 0.0:
            i = p.shaking_rotor
            on_x, on_y, on_roll, on_pitch, on_yaw = propeller_imbalance(
                p, i, y[ROTOR + i], y[PHASE + i]
            )
            force_x += on_x
            force_y += on_y
            roll += on_roll
            pitch += on_pitch
            yaw += on_yaw
    if p.windy != 0:
        moment_x += wind(p, time_s, 0)
        moment_y += wind(p, time_s, 1)
        twist += wind(p, time_s, 2)
        force_x += p.mass * wind(p, time_s, 3)
        force_y += p.mass * wind(p, time_s, 4)
        force_z += p.mass * wind(p, time_s, 5)
    push_x = (r11 * force_x + r12 * force_y + r13 * force_z) / p.mass + s.noise[3]
    push_y = (r21 * force_x + r22 * force_y + r23 * force_z) / p.mass + s.noise[4]
    push_z = (r31 * force_x + r32 * force_y + r33 * force_z) / p.mass + s.noise[5]
    if p.gust_force != 0.0 or p.gust_moment != 0.0:
        on_y, on_roll = side_gust(p, time_s)
        push_y += on_y / p.mass
        roll += on_roll
    if p.load_share != 0.0:
        push_x /= 1.0 - p.load_share
        push_y /= 1.0 - p.load_share
        push_z /= 1.0 - p.load_share
        pull_x, pull_y, pull_z = slung_load(p, y, dy, push_x, push_y, push_z)
        push_x += pull_x
        push_y += pull_y
        push_z += pull_z
        lever = p.load_below * (1.0 - p.load_share) * p.mass
        roll += lever * (r12 * pull_x + r22 * pull_y + r32 * pull_z)
        pitch -= lever * (r11 * pull_x + r21 * pull_y + r31 * pull_z)

    roll_acceleration = roll / p.inertia[0] + moment_x + s.noise[0]
    pitch_acceleration = pitch / p.inertia[1] + moment_y + s.noise[1]
    yaw_acceleration = yaw / p.inertia[2] + twist + s.noise[2]

    if s.mode == FREE:
        if y[2] < 0.0:
            load = -GROUND_PULSATION * (GROUND_PULSATION * y[2] + 2.0 * y[5])
            if load > 0.0:
                share = min(load / p.gravity, 1.0)
                push_z += load
                push_x -= share * 50.0 * y[3]
                push_y -= share * 50.0 * y[4]
                upright = math.copysign(GROUND_PULSATION * GROUND_PULSATION, r33)
                brake = 2.0 * GROUND_PULSATION
                roll_acceleration -= share * (upright * r32 + brake * roll_rate)
                pitch_acceleration -= share * (-upright * r31 + brake * pitch_rate)
                yaw_acceleration -= share * GROUND_RUB * yaw_rate
        for i in range(3):
            dy[i] = y[VELOCITY + i]
        dy[3] = push_x
        dy[4] = push_y
        dy[5] = push_z - p.gravity
    else:
        push_x, push_y, push_z = 0.0, 0.0, p.gravity
        for i in range(6):
            dy[i] = 0.0
        if s.mode == FIXED:
            roll_acceleration, pitch_acceleration, yaw_acceleration = 0.0, 0.0, 0.0
        else:
            roll_acceleration, pitch_acceleration, yaw_acceleration = _hand(s, y)

    dy[6] = 0.5 * (-a * roll_rate - b * pitch_rate - c * yaw_rate)
    dy[7] = 0.5 * (w * roll_rate + b * yaw_rate - c * pitch_rate)
    dy[8] = 0.5 * (w * pitch_rate + c * roll_rate - a * yaw_rate)
    dy[9] = 0.5 * (w * yaw_rate + a * pitch_rate - b * roll_rate)
    dy[RATE] = roll_acceleration
    dy[RATE + 1] = pitch_acceleration
    dy[RATE + 2] = yaw_acceleration
    s.force[0] = r11 * push_x + r21 * push_y + r31 * push_z
    s.force[1] = r12 * push_x + r22 * push_y + r32 * push_z
    s.force[2] = r13 * push_x + r23 * push_y + r33 * push_z
    if p.states > GYRO_LAG:
        filter_slopes(p, s, y, dy)


@inner
def rotor_acceleration(p: Record, rotor: int, armature: float, speed: float) -> float:
    """The identified motor (thesis eq. 3.82) in rev/s^2, with what holds it back.

    Below ``start_mv`` a motor at rest stays at rest (friction); one that turns goes on turning.
    """
    if armature < p.start_mv and speed < 1.0:
        return -20.0 * speed
    a0, a1, a2 = p.a0[rotor], p.a1[rotor], p.a2[rotor]
    return braked(p, driven(p, a0 * armature - a1 * speed) - a2 * speed * speed)


@inner
def _hand(s: Record, y: Any) -> Any:
    """Angular acceleration (rad/s^2) of a hand that turns the craft to ``s.target``."""
    half_r, half_p, half_y = 0.5 * s.target[0], 0.5 * s.target[1], 0.5 * s.target[2]
    cr, sr = math.cos(half_r), math.sin(half_r)
    cp, sp = math.cos(half_p), math.sin(half_p)
    cy, sy = math.cos(half_y), math.sin(half_y)
    tw = cr * cp * cy + sr * sp * sy
    tx = sr * cp * cy - cr * sp * sy
    ty = cr * sp * cy + sr * cp * sy
    tz = cr * cp * sy - sr * sp * cy
    w, x, v, z = y[6], -y[7], -y[8], -y[9]
    # conj(q) * target: the rotation still to be made, in body axes.
    ew = w * tw - x * tx - v * ty - z * tz
    ex = w * tx + x * tw + v * tz - z * ty
    ey = w * ty - x * tz + v * tw + z * tx
    ez = w * tz + x * ty - v * tx + z * tw
    gain = 2.0 * HAND_PULSATION * HAND_PULSATION * (1.0 if ew >= 0.0 else -1.0)
    brake = 2.0 * HAND_PULSATION
    return (
        gain * ex - brake * y[RATE],
        gain * ey - brake * y[RATE + 1],
        gain * ez - brake * y[RATE + 2],
    )
