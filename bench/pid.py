"""Closed loops against bare compiled ones in the same run, the time of a design, and how flights
of the stand-in come out beside their prediction.

The bare loops share nothing with the package: no delay, no quirks, no effects, no checks.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from bench.table import Row
from bench.timing import best
from firmware_sim.craft import StandInSettings
from groundstation.control.firmware_design import cascade_limits, design_cascade, robustness
from groundstation.control.firmware_loop import run_cascade
from groundstation.control.linear_loop import axis_plant, run_direct
from groundstation.control.pid import AXES, PidGains
from groundstation.control.plant import plant_of_model
from groundstation.control.programme import Programme
from groundstation.control.step_analysis import analyse
from groundstation.dynamics.model import THESIS, Model, load_model

TESTS = Path(__file__).parents[1] / "tests"
SEEDS = 8
PASSES = 5_000


def rows() -> Iterator[Row]:
    """What, measured, reference in the same run, unit."""
    model = load_model(TESTS / "control" / "data" / "body.json")
    yield from _direct()
    yield from _cascade(model)
    gains, designed = _design(model)
    yield from designed
    yield from _flights(model, gains)


def _direct() -> Iterator[Row]:
    plant, gains = axis_plant(THESIS, "roll", 2), PidGains(1.05e6, 1.93e6, 3760.0)
    reference = np.ones(PASSES)
    y, u = np.zeros(PASSES), np.zeros(PASSES)
    ours = best(lambda: run_direct(plant, gains, reference), 300)
    bare = best(lambda: _bare_direct(1.05e6, 1.93e6, 3760.0, y, u), 300)
    yield Row("direct loop, samples (bare loop)", PASSES / ours / 1e6, PASSES / bare / 1e6, "M/s")


def _cascade(model: Model) -> Iterator[Row]:
    plant = plant_of_model(model)
    setpoints = np.zeros((PASSES, 3))
    setpoints[:, 0] = 0.1 * np.sign(np.sin(0.01 * np.arange(PASSES)))
    soft = {"pid_rate.roll_kp": 5.0, "pid_rate.pitch_kp": 5.0}
    log = np.zeros((PASSES, 11))
    body = model.body
    assert body is not None
    numbers = np.array([model.motor.a0, model.motor.a1, model.motor.a2, body.c0, body.c1, body.c2])
    hover = plant.hover_mv / 3700.0 * 65536.0
    ours = best(lambda: run_cascade(plant, soft, setpoints), 300)
    bare = best(lambda: _bare_cascade(numbers, plant.hover_rev_s, hover, setpoints, log), 300)
    yield Row(
        "firmware's loops on the craft, passes (bare loop)",
        PASSES / ours / 1e6,
        PASSES / bare / 1e6,
        "M/s",
    )


def _design(model: Model) -> tuple[dict[str, float], list[Row]]:
    start = time.perf_counter()
    designs = design_cascade(model, AXES, cascade_limits())
    gains = {name: value for one in designs for name, value in one.gains.items()}
    tried = robustness(model, gains, AXES, 1000)
    taken = time.perf_counter() - start
    assert tried is not None
    share = min(tried.stable.values()) / tried.drawn
    return gains, [
        Row("roll, pitch and yaw designed and tried on 1000 draws", taken, None, "s", most=20.0),
        Row("share of 1000 draws that are stable (all)", share, 1.0, ""),
    ]


def _flights(model: Model, gains: dict[str, float]) -> Iterator[Row]:
    """Faithful stand-ins flown in fast time: how far from the prediction, at worst."""
    sys.path.insert(0, str(TESTS))
    from support.flights import fly_offline

    plant = plant_of_model(model)
    apart, flown_axes = 0, 0
    worst = {"RMS": 0.0, "overshoot": 0.0, "settling": 0.0}
    for seed in range(SEEDS):
        settings = StandInSettings(program="wait", altitude_hold=True, gains=gains, seed=seed)
        samples, sent, setpoints, _ = fly_offline(settings, Programme(repeats=8), 0.003)
        for one in analyse(samples, sent, setpoints, "plus", plant, gains).axes:
            assert one.predicted is not None
            flown_axes += 1
            apart += bool(one.apart)
            rms = abs(one.measured.rms / one.predicted.rms - 1)
            over = abs(one.measured.overshoot_pct - one.predicted.overshoot_pct)
            settled = one.measured.settling_s, one.predicted.settling_s
            never = settled[0] is None or settled[1] is None
            gap = math.inf if never else abs(settled[0] - settled[1])
            for name, value in zip(worst, (100 * rms, over, 1e3 * gap), strict=True):
                worst[name] = max(worst[name], value)
    yield Row("axes that agree with the prediction (flown)", flown_axes - apart, flown_axes, "")
    yield Row("worst RMS error, measured against predicted", worst["RMS"], None, "%", most=15.0)
    yield Row(
        "worst overshoot, measured against predicted", worst["overshoot"], None, "points", most=3.0
    )
    yield Row(
        "worst settling, measured against predicted", worst["settling"], None, "ms", most=20.0
    )


@njit(nogil=True, error_model="numpy")
def _bare_direct(kp: float, ki: float, kd: float, y: Any, u: Any) -> None:
    integral, before = 0.0, 0.0
    for k in range(3, len(y)):
        y[k] = 1.959 * y[k - 1] - 0.9567 * y[k - 2] + 4.222e-8 * u[k - 2]
        error = 1.0 - y[k]
        u[k] = kp * error + ki * integral + kd * (error - before) / 0.002
        integral += 0.002 * error
        before = error


@njit(nogil=True, error_model="numpy")
def _bare_slope(m: Any, v: Any, y: Any, d: Any) -> None:
    for i in range(4):
        n = y[7 + i]
        d[7 + i] = m[0] * v[i] - (m[1] + m[2] * n) * n
    d[0] = 0.5 * (-y[1] * y[4] - y[2] * y[5] - y[3] * y[6])
    d[1] = 0.5 * (y[0] * y[4] + y[2] * y[6] - y[3] * y[5])
    d[2] = 0.5 * (y[0] * y[5] + y[3] * y[4] - y[1] * y[6])
    d[3] = 0.5 * (y[0] * y[6] + y[1] * y[5] - y[2] * y[4])
    d[4] = m[3] * (y[10] * y[10] - y[8] * y[8])
    d[5] = m[4] * (y[9] * y[9] - y[7] * y[7])
    d[6] = m[5] * (y[8] * y[8] + y[10] * y[10] - y[7] * y[7] - y[9] * y[9])


@njit(nogil=True, error_model="numpy")
def _bare_cascade(m: Any, start: float, hover: float, setpoints: Any, log: Any) -> None:
    y, y0, d, total = np.zeros(11), np.zeros(11), np.zeros(11), np.zeros(11)
    v, integral = np.zeros(4), np.zeros(3)
    y[0] = 1.0
    y[7:] = start
    h, degrees = 0.002, 180.0 / math.pi
    for k in range(len(setpoints)):
        roll = math.atan2(2 * (y[0] * y[1] + y[2] * y[3]), 1 - 2 * (y[1] * y[1] + y[2] * y[2]))
        pitch = math.asin(2 * (y[0] * y[2] - y[1] * y[3]))
        errors = (setpoints[k, 0] - roll, setpoints[k, 1] - pitch)
        integral[0] += h * errors[0]
        integral[1] += h * errors[1]
        r = 5.0 * degrees * (3.5 * errors[0] + 2.0 * integral[0] - y[4])
        p = 5.0 * degrees * (3.5 * errors[1] + 2.0 * integral[1] - y[5])
        error = degrees * (setpoints[k, 2] - y[6])
        integral[2] += h * error
        w = 50.0 * error + 25.0 * integral[2]
        mixed = (hover - p - w, hover - r + w, hover + p - w, hover + r + w)
        for i in range(4):
            v[i] = min(max(mixed[i], 0.0), 65535.0) / 65536.0 * 3700.0
        for i in range(11):
            y0[i] = y[i]
        _bare_slope(m, v, y, total)
        for i in range(11):
            y[i] = y0[i] + 0.5 * h * total[i]
        _bare_slope(m, v, y, d)
        for i in range(11):
            total[i] += 2.0 * d[i]
            y[i] = y0[i] + 0.5 * h * d[i]
        _bare_slope(m, v, y, d)
        for i in range(11):
            total[i] += 2.0 * d[i]
            y[i] = y0[i] + h * d[i]
        _bare_slope(m, v, y, d)
        for i in range(11):
            y[i] = y0[i] + h / 6.0 * (total[i] + d[i])
            log[k, i] = y[i]
