"""The memory that the compiled kernels work on: one record of parameters, one of state.

Times are integer nanoseconds of device time since power-on; rotor speed in rev/s, voltages in
mV where named so, everything else SI unless the name says otherwise.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Record = Any
"""A numpy record as the kernels see it."""

PASS_NS = 2_000_000
"""One pass of the stabilizer: 500 Hz."""
PILOT_PASSES = 5
"""The pilot (and a client) decides every 10 ms."""

# Positions in the integrated state vector.
POSITION, VELOCITY, QUATERNION, RATE, ROTOR = 0, 3, 6, 10, 13
CORE_STATES = 17
PHASE, GYRO_LAG, GYRO_DLPF, ACCEL_DLPF, ARM, LOAD = 17, 21, 24, 27, 30, 32
ALL_STATES = 36
LAW_BODY, LAW_SENSOR, LAW_STATES = 36, 52, 68
"""States of effects whose laws are flown, 16 of the body and 16 of sensors."""

SENSOR_RING = 32
"""Samples on their way from the sensor to the loop: up to 60 ms of delay."""
CALIBRATION_SAMPLES = 128

# Streams of random numbers: one each, so that one source never shifts another.
NOISE_STREAM, SENSOR_STREAM, CLOCK_STREAM, RADIO_STREAM = 0, 1, 2, 3

# What the programme's rows hold, one row each 10 ms.
ROW_MODE, ROW_THRUST, ROW_ROLL, ROW_PITCH, ROW_YAW, ROW_LEVEL, ROW_KEEP, ROW_PUSH = range(8)
ROW_COLUMNS = 8
FREE, FIXED, HELD = 0.0, 1.0, 2.0
THRUST_OFF, THRUST_HEIGHT, THRUST_DIRECT = 0.0, 1.0, 2.0

PARAMETERS = np.dtype(
    [
        # rigid body and rotors
        ("mass", "f8"),
        ("gravity", "f8"),
        ("inertia", "f8", (3,)),
        ("rotor_x", "f8", (4,)),
        ("rotor_y", "f8", (4,)),
        ("spin", "f8", (4,)),  # +1 counter-clockwise from above
        ("strength", "f8", (4,)),  # 1, or a rotor's thrust and drag relative to the others
        ("thrust", "f8"),  # N per (rev/s)^2
        ("drag", "f8"),  # N m per (rev/s)^2
        ("a0", "f8", (4,)),
        ("a1", "f8", (4,)),
        ("a2", "f8", (4,)),
        ("start_mv", "f8"),
        ("longest_step", "f8"),  # s
        ("states", "i8"),  # CORE_STATES, or ALL_STATES where something needs the rest
        ("airframe_x", "i8"),  # 1: the mixer of the X configuration
        # electrical
        ("winding_ohm", "f8"),
        ("back_emf", "f8"),  # mV per rev/s
        ("internal_ohm", "f8"),
        ("supply_ohm", "f8"),
        ("emf_share", "f8"),  # true back-EMF constant over ``back_emf``
        ("electronics_a", "f8"),
        ("capacity_c", "f8"),  # coulomb
        ("stiff_mv", "f8"),  # > 0: a bench supply instead of the cell
        ("adc_filter", "i8"),  # 1: the firmware's slow filter and 2 mV steps
        ("reading_lag", "f8"),  # s
        ("protection_a", "f8"),  # 0: none
        ("pwm_steps", "i8"),  # of the motors' driver, 0: as many as it is told
        ("swap_ns", "i8"),  # time without power until a fresh cell is in
        # noise
        ("torque_noise", "f8", (3,)),  # rad/s^2, held over a pass
        ("force_noise", "f8"),  # m/s^2 on each axis, held over a pass
        ("gyro_noise", "f8"),  # rad/s
        ("accel_noise", "f8"),  # m/s^2
        ("angle_noise", "f8"),  # rad, reduced plant only
        # sensor
        ("ideal_attitude", "i8"),  # 1: angles are the truth plus noise (reduced plant)
        ("dlpf_s", "f8", (2,)),  # lags of gyro and accelerometer, 0: none
        ("pipeline_ns", "i8"),  # from sampling to the loop's registers
        ("sensor_phase_ns", "i8"),
        ("sensor_period_ns", "i8"),
        ("in_step", "i8"),  # 1: sampled so that the loop need not wait for a sample
        ("gyro_offset", "f8", (3,)),  # rad/s
        ("gyro_drift", "f8", (3,)),  # rad/s reached after warming up
        ("warm_up", "f8"),  # s
        ("accel_bias", "f8", (3,)),  # m/s^2
        ("mounting", "f8", (9,)),  # sensor axes in the body, row-major rotation body <- sensor
        ("rotated", "i8"),
        ("filtered", "i8"),  # 1: today's filters, each b0 b1 b2 a1 a2
        ("gyro_filter", "f8", (5,)),
        ("accel_filter", "f8", (5,)),
        ("shake", "f8", (3,)),  # imbalance: m/s^2 in plane, m/s^2 axial, rad/s; at 250 rev/s
        # decks
        ("flow_noise", "f8"),  # tenths of a pixel
        ("range_sticks_ns", "i8"),  # after power-on, -1: never
        ("range_stuck_m", "f8"),  # < 0: where it then is
        # timer
        ("timer_jitter", "f8"),  # ticks
        ("gate_glitches", "f8"),
        # named effects
        ("rotor_inertia_gyro", "f8"),
        ("rotor_inertia_yaw", "f8"),
        ("coupling", "f8"),
        ("tilt_damping", "f8"),
        ("quadratic_damping", "f8"),
        ("turn_damping", "f8"),
        ("gravity_x", "f8"),
        ("gravity_y", "f8"),
        ("dead_mv", "f8"),
        ("braking", "f8"),  # 1: brakes as it accelerates
        ("coasting", "f8"),
        ("plane_drag", "f8"),
        ("flapping", "f8"),
        ("flapping_asymmetry", "f8"),
        ("inflow", "f8"),
        ("lever", "f8", (3,)),
        ("levered", "i8"),
        ("ground_gain", "f8"),
        ("ground_height", "f8"),
        ("gyro_lag", "f8"),  # s
        ("load_share", "f8"),  # of ``mass``
        ("load_length", "f8"),
        ("load_damping", "f8"),  # 1/s
        ("load_below", "f8"),  # m
        ("aided_strength", "f8"),
        ("aided_time", "f8"),  # s
        ("flow_aided", "i8"),  # 1: the estimator of a Flow deck says the attitude
        ("windy", "i8"),
        ("wind", "f8", (6,)),  # rad/s^2 about, m/s^2 along the body's axes
        ("wind_time", "f8"),  # s
        ("shaking_rotor", "i8"),
        ("shaking_pull", "f8"),  # N per (rev/s)^2
        ("shaking_twist", "f8"),  # N m per (rev/s)^2
        # effects whose laws are flown, see effects/own.py
        ("lawful", "i8"),
        ("own", "i8", (5,)),
        ("own_values", "f8", (16,)),
        ("own_initial", "f8", (32,)),
        # effects that no list names
        ("payload", "f8"),  # share of the mass that was added; it is in ``mass`` already
        ("arm_hz", "f8"),
        ("arm_gain", "f8"),
        ("arm_damping", "f8"),
        ("arm_rotor", "i8"),
        ("gust_force", "f8"),
        ("gust_moment", "f8"),
        ("gust_hz", "f8"),
        # pilot
        ("hold_height", "f8"),  # m, with flightmode.althold
        ("resume_ns", "i8"),  # a client silent for so long gives the craft back to the pilot
        ("land_when_low", "i8"),
    ]
)

FIRMWARE = np.dtype(
    [
        # gains: rows roll, pitch, yaw
        ("rate_kp", "f8", (3,)),
        ("rate_ki", "f8", (3,)),
        ("rate_kd", "f8", (3,)),
        ("angle_kp", "f8", (3,)),
        ("angle_ki", "f8", (3,)),
        ("angle_kd", "f8", (3,)),
        ("fusion_kp", "f8"),  # the firmware's doubled values
        ("fusion_ki", "f8"),
        ("accel_factor", "f8"),  # of 256
        ("altitude_hold", "f8"),
        ("pilot_holds", "i8"),  # 1: with it the pilot holds the height, not the firmware
        ("compensates", "i8"),  # 1: for the battery
        # quirks of the release, 1 as flown
        ("quirk_attitude_dt", "i8"),
        ("quirk_clamp_macro", "i8"),
        ("quirk_lower_limit", "i8"),
        ("quirk_negate", "i8"),
        # today's firmware
        ("today", "i8"),
        ("armed", "i8"),
        ("arms_itself", "i8"),
        ("stopped", "i8"),  # by an emergency: until it is switched off
        ("protocol", "i8"),
        ("supervisor", "i8"),  # its state, see ``supervisor``
        ("supervised_ns", "i8"),  # since when it is in that state
        ("tumbled", "i8"),
        ("tilted_ns", "i8"),  # since when, -1: it is not
        ("turned_ns", "i8"),  # when a motor last ran, -1: never
        ("thrust_curve", "f8", (4,)),  # N from V
        ("thrust_most_n", "f8"),
        ("thrust_least_n", "f8"),
        ("by_grams", "i8"),  # 1: the curve of the releases until 2025.02
        ("heading", "f8"),  # deg, that is held
        ("wanted", "f8", (4,)),
        ("idle", "i8"),  # 16-bit PWM that motors get at least, where they may run
        ("pwm", "i8", (4,)),  # 16-bit PWM
        ("commands", "f8", (4,)),  # of the loops: thrust, roll, pitch, yaw
        # state of the PIDs
        ("rate_integral", "f8", (3,)),
        ("rate_previous", "f8", (3,)),
        ("angle_integral", "f8", (3,)),
        ("angle_previous", "f8", (3,)),
        ("rate_desired", "f8", (3,)),
        # sensor fusion
        ("bias_ring", "i8", (CALIBRATION_SAMPLES, 3)),
        ("bias_seen", "i8"),
        ("bias_found", "i8"),
        ("bias", "i8", (3,)),
        ("accel_smooth", "f8", (3,)),
        ("quaternion", "f8", (4,)),
        ("feedback", "f8", (3,)),
        ("angles", "f8", (3,)),  # deg, firmware convention
        ("gyro", "f8", (3,)),  # deg/s, bias removed
        ("accel", "f8", (3,)),  # g
        # commander
        ("setpoint", "f8", (3,)),  # roll deg, pitch deg (nose up), yaw deg/s (clockwise)
        ("setpoint_thrust", "f8"),
        ("setpoint_ns", "i8"),
        ("client_ns", "i8"),  # last setpoint of a client, -1: never
        ("thrust", "f8"),
        # height, by a deck that measures it or a positioning system
        ("knows_height", "i8"),
        ("knows_place", "i8"),
        ("holds_height", "i8"),  # 1: the setpoint is a height
        ("holds_speed", "i8"),  # 1: and a velocity in the place of angles
        ("setpoint_speed", "f8", (2,)),  # m/s forward and to the left
        ("setpoint_height", "f8"),  # m
        ("holds_climb", "i8"),  # 1: the setpoint is a rate of climb
        ("setpoint_climb", "f8"),  # m/s
        ("range_m", "f8"),
        ("height", "f8"),  # m, estimated
        ("climb", "f8"),  # m/s, estimated
        ("place", "f8", (6,)),  # m and m/s in the estimator's world, as it says
        ("place_variance", "f8", (6,)),  # of position and velocity
        ("base_thrust", "f8"),  # the loop of climb begins with it
        ("least_thrust", "f8"),  # and asks for no less
        ("height_integral", "f8"),
        ("climb_integral", "f8"),
        ("speed_integral", "f8", (2,)),
        ("resets_modes", "i8"),  # 1: the loops begin anew with another kind of setpoint
        ("mode", "i8"),  # kind of the last setpoint
        # the estimator of a Flow deck, see ``kalman``
        ("kalman", "i8"),  # 1: it runs
        ("kalman_reset", "i8"),  # 1: asked to begin anew; it does at power-on
        ("kalman_resets", "i8"),
        ("kalman_state", "f8", (6,)),
        ("kalman_variance", "f8", (9, 9)),
        ("kalman_sum", "f8", (2, 3)),  # m/s^2 and rad/s since its last step
        ("kalman_drag", "f8", (2,)),  # 1/s
        # outputs
        ("compare", "i8", (4,)),  # 9-bit PWM
        # power management
        ("battery_filter", "f8"),  # V
        ("low_ns", "i8"),
        ("critical_ns", "i8"),
        ("power_state", "i8"),  # 0 battery, 3 low power
    ]
)

STATE = np.dtype(
    [
        ("y", "f8", (LAW_STATES,)),
        ("start", "f8", (LAW_STATES,)),
        ("slope", "f8", (LAW_STATES,)),
        ("sum", "f8", (LAW_STATES,)),
        ("force", "f8", (3,)),  # specific force in body axes, m/s^2
        # held over a pass
        ("duty", "f8", (4,)),
        ("supply_mv", "f8"),
        ("reported_mv", "f8"),
        ("noise", "f8", (6,)),  # torque rad/s^2, force m/s^2
        ("mode", "f8"),
        ("target", "f8", (3,)),  # rad, of a craft held in the hand
        # clocks
        ("now_ns", "i8"),  # since the first power-on
        ("boot_ns", "i8"),
        ("off_ns", "i8"),  # power lost at, -1: powered
        ("boots", "i8"),
        ("timer_phase", "i8"),  # ticks at boot
        ("overload_ns", "i8"),
        ("charge", "f8"),  # 0..1
        ("current_a", "f8"),
        # sensor samples on their way
        ("ring_ready_ns", "i8", (SENSOR_RING,)),
        ("ring_gyro", "i8", (SENSOR_RING, 3)),
        ("ring_accel", "i8", (SENSOR_RING, 3)),
        ("ring_angles", "f8", (SENSOR_RING, 3)),
        ("filter", "f8", (10, 2)),  # memory of the filters: gyro, accelerometer, quaternion
        ("aided", "f8", (4,)),  # of an estimator: tilt taken, velocity unexplained, twice
        ("sampled", "i8"),  # samples taken
        ("read", "i8"),  # index of the sample in the registers
        ("sampled_ns", "i8", (SENSOR_RING,)),
        # optical gate of the motor bench
        ("gate_ns", "f8"),
        ("gate_ticks", "i8"),
        # pilot
        ("pilot_height", "f8"),
        ("pilot_integral", "f8"),
        ("landing", "i8"),
        ("landed_ns", "i8"),
        ("rng", "u8", (4, 2)),
    ]
)

ROWS = np.dtype(
    [
        ("time_ns", "i8"),
        ("ticks", "i8"),
        ("battery", "i8"),
        ("motors", "i8", (4,)),
        ("gyro", "i8", (3,)),
        ("accelerometer", "i8", (3,)),
        ("angles", "i8", (3,)),
        ("debug", "i8"),
        # what a log block reads after the pass
        ("boot_ns", "i8"),
        ("gyro_dps", "f8", (3,)),
        ("accel_g", "f8", (3,)),
        ("angles_deg", "f8", (3,)),
        ("thrust", "f8"),
        ("commands", "f4", (4,)),
        ("place", "f4", (6,)),
        ("range_m", "f8"),
        ("pwm", "i8", (4,)),  # 16 bits, computed in this pass
        ("battery_v", "f8"),
        ("power_state", "i8"),
        ("rotor_rev_s", "f8", (4,)),
    ]
)
"""One telemetry row as the firmware fills it, and what its log would say of the pass."""

TRUTH = np.dtype(
    [
        ("time_s", "f8"),
        ("position_m", "f8", (3,)),
        ("velocity_m_s", "f8", (3,)),
        ("quaternion", "f8", (4,)),
        ("rate_rad_s", "f8", (3,)),
        ("rotor_rev_s", "f8", (4,)),
        ("duty", "f8", (4,)),
        ("supply_mv", "f8"),
        ("current_a", "f8"),
        ("charge", "f8"),
        ("sensor_age_s", "f8"),
    ]
)
"""What really happened at the start of each pass; ``duty`` acted over the pass before."""
