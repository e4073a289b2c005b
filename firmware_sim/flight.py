"""The pass: sensor, firmware, telemetry row, plant. 500 times a second, compiled."""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.battery import ADC_PASSES, manage_power, protect, read_adc, supply
from firmware_sim.bench_motor import watch_gate
from firmware_sim.commander import watch
from firmware_sim.compiled import inner
from firmware_sim.fusion import COUNTS_PER_DPS, COUNTS_PER_G, calibrate, fuse, smooth_acceleration
from firmware_sim.height import begin_anew, estimate_height, hold_climb, hold_height, hold_speed
from firmware_sim.imu import fetch, sample
from firmware_sim.kalman import estimate
from firmware_sim.layout import (
    CLOCK_STREAM,
    FIXED,
    FREE,
    NOISE_STREAM,
    PASS_NS,
    PHASE,
    PILOT_PASSES,
    QUATERNION,
    RATE,
    ROTOR,
    Record,
)
from firmware_sim.pilot import LANDED_M, REST_NS, decide
from firmware_sim.plant import derivative, integrate
from firmware_sim.random_numbers import normal, uniform
from firmware_sim.stabilizer import angle_loops, stabilize
from firmware_sim.stabilizer_today import stabilize_today
from firmware_sim.supervisor import EVERY_PASSES, supervise
from groundstation.compiled import kernel
from groundstation.telemetry.packet import FULL_16_BIT

FULL_COMPARE = 512.0
WAIT_NS = 1_000_000_000
"""The firmware waits so long before anything moves."""
TEST_NS, TEST_EVERY_NS, TEST_COMPARE = 50_000_000, 200_000_000, 101
"""The motor test: each motor turns for 50 ms, 200 ms apart, at a fifth of full PWM."""
FIRST_ROW = 10
"""Passes until sensors and battery have been read and telemetry starts."""
TIMER_NS = 73_000.0 / 72.0
LONG_INTERRUPT = 0.02
"""Share of rows whose timestamp is late by a long interrupt."""


@kernel
def fly(
    p: Record,
    fw: Record,
    s: Record,
    programme: Any,
    first: int,
    hover: float,
    passes: int,
    rows: Any,
    truth: Any,
) -> Any:
    """The compiled flight: ``fly(p, fw, s, programme, first, hover, passes, rows, truth)``.

    Flies up to ``passes`` passes, reading ``programme`` (n, 7) from row ``first`` on, and fills
    ``rows`` and, where it has rows, ``truth``. Returns (passes flown, rows written); it stops
    early when a fresh battery has just started the craft anew, because the programme then
    starts anew too.
    """
    written = 0
    for done in range(passes):
        if s.off_ns >= 0:
            if s.now_ns - s.off_ns >= p.swap_ns:
                return done, written
            _fall(s)
            _move(p, s)
            continue
        since_boot = s.now_ns - s.boot_ns
        index = since_boot // PASS_NS
        slot = fetch(s, s.now_ns)
        tick = index // PILOT_PASSES - first
        if index % PILOT_PASSES == 0:
            decide(p, fw, s, programme[tick], hover * _battery_ratio(fw), s.now_ns)
        _firmware(p, fw, s, index, slot)
        if index >= FIRST_ROW:
            _report(p, fw, s, rows[written], slot, index)
            if len(truth) > 0:
                _witness(s, truth[written], slot)
            written += 1
        _act(p, fw, s, index)
        if index >= FIRST_ROW:
            _log(fw, s, rows[written - 1])
        phase, speed = s.y[PHASE], s.y[ROTOR]
        _move(p, s)
        if s.mode == FIXED:
            watch_gate(p, s, phase, speed)
        if _power_lost(p, fw, s):
            s.off_ns = s.now_ns
    return passes, written


@inner
def _battery_ratio(fw: Record) -> float:
    """A pilot pushes the stick further as the battery empties, where the firmware does not."""
    if fw.today != 0:
        return 1.0
    return 3.7 / min(max(fw.battery_filter, 3.0), 4.2)


@inner
def _firmware(p: Record, fw: Record, s: Record, index: int, slot: int) -> None:
    if fw.bias_found == 0:
        if s.now_ns - s.boot_ns >= WAIT_NS + 4 * TEST_EVERY_NS:
            calibrate(fw, s.ring_gyro[slot, 0], s.ring_gyro[slot, 1], s.ring_gyro[slot, 2])
        return
    for i in range(3):
        fw.gyro[i] = (s.ring_gyro[slot, i] - fw.bias[i]) / COUNTS_PER_DPS
        fw.accel[i] = s.ring_accel[slot, i] / COUNTS_PER_G
    smooth_acceleration(fw)
    if index % 2 == 0:
        if p.ideal_attitude != 0:
            for i in range(3):
                fw.angles[i] = s.ring_angles[slot, i]
        elif fw.kalman == 0:
            fuse(fw)
    if fw.kalman != 0:
        estimate(p, fw, s, index)


@inner
def _act(p: Record, fw: Record, s: Record, index: int) -> None:
    """What the pass leaves behind: PWM, the battery's voltage under it, and its reading."""
    if fw.bias_found == 0:
        _motor_test(fw, s.now_ns - s.boot_ns - WAIT_NS)
    else:
        if fw.knows_height != 0:
            if fw.kalman == 0:
                estimate_height(p, fw, s, index)
            if fw.resets_modes != 0:
                begin_anew(fw)
            if fw.knows_place != 0:
                hold_speed(fw, index)
            if fw.holds_height != 0:
                fw.setpoint_thrust = hold_height(fw, index)
        if fw.holds_climb != 0:
            fw.setpoint_thrust = hold_climb(fw, s.y[5], index)
        watch(fw, s.now_ns)
        if fw.today != 0:
            if index % EVERY_PASSES == 0:
                supervise(fw, s.now_ns)
            stabilize_today(fw)
        else:
            if index % 2 == 0:
                angle_loops(fw)
            stabilize(p, fw)
    for i in range(4):
        if fw.today != 0 and fw.bias_found != 0:
            s.duty[i] = _driven(p, fw.pwm[i])
        else:
            fw.pwm[i] = fw.compare[i] << 7
            s.duty[i] = fw.compare[i] / FULL_COMPARE
    supply(p, s)
    if index % ADC_PASSES == 0 or p.adc_filter == 0:
        read_adc(p, fw, s)


@inner
def _driven(p: Record, pwm: int) -> float:
    """Share of full PWM that a motor gets from its driver."""
    if p.pwm_steps == 0:
        return float(pwm / FULL_16_BIT)
    return float(pwm * p.pwm_steps // 65536 / p.pwm_steps)


@inner
def _motor_test(fw: Record, elapsed_ns: int) -> None:
    for i in range(4):
        since = elapsed_ns - i * TEST_EVERY_NS
        fw.compare[i] = TEST_COMPARE if 0 <= since < TEST_NS else 0


@inner
def _move(p: Record, s: Record) -> None:
    """Fly to the next pass, stopping where the sensor samples."""
    for i in range(3):
        s.noise[i] = p.torque_noise[i] * normal(s.rng, NOISE_STREAM)
        s.noise[3 + i] = p.force_noise * normal(s.rng, NOISE_STREAM)
    if s.y[2] < LANDED_M:
        share = max(s.y[2] / LANDED_M, 0.0)
        for i in range(6):
            s.noise[i] *= share
    at = s.now_ns
    end = at + PASS_NS
    while True:
        instant = p.sensor_phase_ns + s.sampled * p.sensor_period_ns
        if instant > end:
            break
        if instant > at:
            integrate(p, s, at * 1e-9, (instant - at) * 1e-9)
            at = instant
        derivative(p, s, at * 1e-9, s.y, s.slope)
        sample(p, s, instant)
    if end > at:
        integrate(p, s, at * 1e-9, (end - at) * 1e-9)
    s.now_ns = end


@inner
def _fall(s: Record) -> None:
    """A craft without power: its motors coast."""
    s.mode = FREE
    for i in range(4):
        s.duty[i] = 0.0


@inner
def _power_lost(p: Record, fw: Record, s: Record) -> bool:
    if protect(p, s) or manage_power(fw, s.now_ns):
        return True
    if s.landing == 0 or fw.thrust > 0.0 or s.y[2] > LANDED_M:
        s.landed_ns = s.now_ns
        return False
    return bool(s.now_ns - s.landed_ns > REST_NS)


@inner
def _report(p: Record, fw: Record, s: Record, row: Record, slot: int, index: int) -> None:
    """The telemetry row: fresh sensors and angles, the PWM and battery that acted before."""
    late = p.timer_jitter * normal(s.rng, CLOCK_STREAM)
    chance = uniform(s.rng, CLOCK_STREAM)
    if p.timer_jitter > 0.0:
        if chance < LONG_INTERRUPT:
            late += 12.0 * chance / LONG_INTERRUPT
        if index % 2 == 0:
            late += 1.0
    elapsed = (s.now_ns - s.boot_ns) / TIMER_NS
    row.time_ns = s.now_ns
    row.ticks = s.timer_phase + math.floor(elapsed + late + 8.0)
    row.battery = int(fw.battery_filter * 1000.0 + 0.5)
    for i in range(4):
        share = fw.pwm[i] / FULL_16_BIT if p.pwm_steps != 0 else s.duty[i]
        row.motors[i] = min(int(share * FULL_COMPARE + 0.5), 511) << 3
    for i in range(3):
        row.gyro[i] = s.ring_gyro[slot, i]
        row.accelerometer[i] = s.ring_accel[slot, i]
        row.angles[i] = math.floor(100.0 * fw.angles[i] + 0.5)
    row.debug = s.gate_ticks
    # what a log says of the battery is never newer than the motors that it says acted
    row.battery_v = fw.battery_filter


@inner
def _log(fw: Record, s: Record, row: Record) -> None:
    """What the firmware's log variables hold when the pass is over."""
    row.boot_ns = s.boot_ns
    for i in range(3):
        row.gyro_dps[i] = fw.gyro[i]
        row.accel_g[i] = fw.accel[i]
        row.angles_deg[i] = fw.angles[i]
    for i in range(4):
        row.pwm[i] = fw.pwm[i]
        row.rotor_rev_s[i] = s.y[ROTOR + i]
        row.commands[i] = fw.commands[i]
    row.thrust = fw.thrust
    for i in range(6):
        row.place[i] = fw.place[i]
    row.range_m = fw.range_m
    row.power_state = fw.power_state


@inner
def _witness(s: Record, row: Record, slot: int) -> None:
    row.time_s = s.now_ns * 1e-9
    for i in range(3):
        row.position_m[i] = s.y[i]
        row.velocity_m_s[i] = s.y[3 + i]
        row.rate_rad_s[i] = s.y[RATE + i]
    for i in range(4):
        row.quaternion[i] = s.y[QUATERNION + i]
        row.rotor_rev_s[i] = s.y[ROTOR + i]
        row.duty[i] = s.duty[i]
    row.supply_mv = s.supply_mv
    row.current_a = s.current_a
    row.charge = s.charge
    row.sensor_age_s = (s.now_ns - s.sampled_ns[slot]) * 1e-9
