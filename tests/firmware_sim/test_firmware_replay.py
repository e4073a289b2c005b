"""The firmware written a second time, straight from its description, must give every count.

A stand-in flies under a client's setpoints. From nothing but the raw gyro and accelerometer
counts of its telemetry and those setpoints, the code below (which shares nothing with the
stand-in's) predicts each motor value and each angle of each row: the order of the loop, bias
search, sensor fusion, cascaded PIDs with their quirks, commander, mixer and PWM.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.settings import Loss, Quirks, Sensor
from support.plant import rows_of

FIRST_ROW = 10  # passes before telemetry starts
END_S = 9.0


class Pid:
    def __init__(self, kp, ki, kd, dt, high, low):
        self.kp, self.ki, self.kd, self.dt, self.high, self.low = kp, ki, kd, dt, high, low
        self.forget()

    def forget(self):
        self.integral = self.previous = 0.0

    def update(self, error):
        self.integral += error * self.dt
        if self.integral > self.high:
            self.integral = self.high
        elif self.integral < self.low:
            self.integral = self.low
        slope = (error - self.previous) / self.dt
        self.previous = error
        return self.kp * error + self.ki * self.integral + self.kd * slope


class Firmware:
    """Release 2014.01.0 in floats: feed it one row's counts, get the next row's motors."""

    def __init__(self, x_frame, quirks, rate_kp, angle_kp, angle_ki, rate_kd):
        self.x_frame, self.quirks = x_frame, quirks
        dt = 0.002 if quirks.attitude_dt else 0.004

        def low(high):
            return -5000.0 if quirks.lower_limit else -high

        self.rate = [
            Pid(rate_kp, 0, rate_kd, 0.002, 100.0, low(100.0)),
            Pid(rate_kp, 0, 0, 0.002, 100.0, low(100.0)),
            Pid(50.0, 25.0, 0, 0.002, 500.0, low(500.0)),
        ]
        self.angle = [Pid(angle_kp, angle_ki, 0, dt, 20.0, low(20.0)) for _ in range(2)]
        self.ring, self.bias = [], None
        self.smooth, self.q, self.drift = np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3)
        self.degrees, self.wanted = np.zeros(3), [0.0, 0.0, 0.0]
        self.setpoint, self.heard_ms = (0.0, 0.0, 0.0, 0), 0

    def step(self, number, gyro, accelerometer):
        """(angles in 0.01 deg that this row shows, motors that the next row shows)."""
        now_ms = 2 * number
        if self.bias is None:
            self.find_bias(now_ms, gyro)
            tested = [0 <= now_ms - 1000 - 200 * motor < 50 for motor in range(4)]
            return self.shown(), [(101 << 3) * test for test in tested]
        rates = (gyro - self.bias) / 16.384
        self.smooth = self.smooth + (accelerometer / 4096 - self.smooth) * 32 / 256
        if number % 2 == 0:
            self.fuse(np.radians(rates))
        return self.shown(), self.control(number, now_ms, rates)

    def shown(self):
        return np.floor(100 * self.degrees + 0.5)

    def find_bias(self, now_ms, gyro):
        if now_ms < 1800:
            return
        self.ring = [*self.ring, gyro][-128:]
        ring = np.array(self.ring, dtype=np.int64)
        quiet = (ring**2).sum(0) - ring.sum(0) ** 2 / 128 < 4000
        if len(ring) == 128 and quiet.all():
            self.bias = np.trunc(ring.sum(0) / 128)

    def fuse(self, rates):
        w, x, y, z = self.q
        measured = self.smooth / np.linalg.norm(self.smooth)
        half_up = np.array([x * z - w * y, w * x + y * z, w * w - 0.5 + z * z])
        error = np.cross(measured, half_up)
        self.drift = self.drift + 0.002 * error * 0.004
        p, q, r = rates + self.drift + 0.8 * error
        turned = [-x * p - y * q - z * r, w * p + y * r - z * q]
        turned += [w * q - x * r + z * p, w * r + x * q - y * p]
        self.q = self.q + 0.5 * 0.004 * np.array(turned)
        self.q = self.q / np.linalg.norm(self.q)
        w, x, y, z = self.q
        roll = math.atan2(2 * (w * x + y * z), w * w - x * x - y * y + z * z)
        pitch = math.asin(2 * (x * z - w * y))
        yaw = math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
        self.degrees = np.degrees([roll, pitch, yaw])

    def control(self, number, now_ms, rates):
        roll, pitch, yaw, thrust = self.setpoint
        if now_ms - self.heard_ms > 500:
            roll = pitch = yaw = 0.0
        if now_ms - self.heard_ms > 2000 or thrust <= 10000:
            thrust = 0
        thrust = min(thrust, 60000)
        if number % 2 == 0:
            self.wanted[0] = self.angle[0].update(roll - self.degrees[0])
            self.wanted[1] = self.angle[1].update(pitch - self.degrees[1])
            self.wanted[2] = -yaw
        measured = (rates[0], -rates[1], rates[2])
        r, p, y = (
            self.clamped(pid, wanted - rate)
            for pid, wanted, rate in zip(self.rate, self.wanted, measured, strict=True)
        )
        if thrust == 0:
            for pid in (*self.rate, *self.angle):
                pid.forget()
            return [0, 0, 0, 0]
        y = -y
        if self.x_frame:
            r, p = r >> 1, p >> 1
            mixed = [-r + p + y, -r - p - y, r - p + y, r + p - y]
        else:
            mixed = [p + y, -r - y, -p + y, r - y]
        return [max(0, min(65535, thrust + part)) >> 7 << 3 for part in mixed]

    def clamped(self, pid, error):
        """((x) < MIN) ? MIN : (((x) > MAX) ? MAX : (x)) with x a call."""
        output = pid.update(error)
        if output < -32768:
            return -32768
        if self.quirks.clamp_macro:
            output = pid.update(error)
        if output > 32767:
            return 32767
        return int(pid.update(error) if self.quirks.clamp_macro else output)


def setpoints(seed):
    """(time, roll, pitch, yaw, thrust) each 20 ms; a stop, and silences of 0.8 and 2.2 s."""
    generator = np.random.default_rng(seed)
    for tick in range(150, round(END_S / 0.02)):
        time_s = tick * 0.02
        angles = [float(np.float32(value)) for value in generator.uniform(-6, 6, 2)]
        turn, thrust = float(generator.uniform(-60, 60)), int(generator.integers(42000, 50000))
        if 4.0 <= time_s < 4.1:
            yield time_s, 0.0, 0.0, 0.0, 9000
        elif not (5.0 <= time_s < 5.8 or 6.6 <= time_s < 8.8):
            yield time_s, *angles, turn, thrust


NO_QUIRKS = Quirks(attitude_dt=False, clamp_macro=False, lower_limit=False, negate=False)
CASES = [
    ("crazyflie1", Quirks(), {}),
    ("crazyflie1", NO_QUIRKS, {"pid_rate.roll_kd": 0.1}),
    ("crazyflie21", Quirks(), {}),
    ("thesis", Quirks(clamp_macro=False), {}),
]


@pytest.mark.parametrize(("craft", "quirks", "gains"), CASES)
def test_every_motor_value_and_angle_follows_from_the_raw_sensors(craft, quirks, gains):
    stand_in = StandIn(
        StandInSettings(
            craft=craft,
            firmware="2014",
            quirks=quirks,
            gains=gains,
            program="wait",
            seed=4,
            copies=1,
            loss=Loss(good_loss=0.0),
            device_clock_ppm=0.0,
            sensor=Sensor(gyro_bias_dps=(1.3, -2.1, 0.6)),
        )
    )
    parts, given = [], {}
    for time_s, *setpoint in setpoints(seed=4):
        parts.append(stand_in.advance(time_s)[0])
        given[round(stand_in.time_s * 500)] = setpoint
        stand_in.command(*setpoint)
    parts.append(stand_in.advance(END_S)[0])
    rows = rows_of(np.concatenate(parts))
    assert len(rows["gyro"]) > 4480
    gentle = craft == "thesis"
    firmware = Firmware(
        craft == "crazyflie21",
        quirks,
        rate_kp=12.0 if gentle else 70.0,
        angle_kp=2.5 if gentle else 3.5,
        angle_ki=1.0 if gentle else 2.0,
        rate_kd=gains.get("pid_rate.roll_kd", 0.0),
    )
    angles, motors = [], [[0, 0, 0, 0]]
    for row, (gyro, force) in enumerate(zip(rows["gyro"], rows["accelerometer"], strict=True)):
        number = FIRST_ROW + row
        if number in given:
            firmware.setpoint, firmware.heard_ms = given[number], 2 * number
        shown, pwm = firmware.step(number, gyro, force)
        angles.append(shown)
        motors.append(pwm)
    assert (np.array(angles) == rows["angles"]).all()
    assert (np.array(motors[:-1]) == rows["motors"]).all()
    assert np.abs(rows["angles"]).max() > 300  # it did fly
    assert (rows["motors"][:, 0] > 2000).mean() > 0.3
