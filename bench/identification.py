"""Simulation and identification against bare loops in the same run, and 50 seeds of accuracy.

The references are the least code that does the numerical work: no checks, no uncertainty, no
structure. They share nothing with the package.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
from numba import njit
from numpy.typing import NDArray

from bench.table import Row
from bench.timing import best
from firmware_sim.craft import StandIn, StandInSettings
from groundstation.dynamics.craft import craft_of_vehicle
from groundstation.dynamics.model import ArxAxis
from groundstation.dynamics.motor import simulate_motor
from groundstation.dynamics.simulation import simulate
from groundstation.dynamics.state import craft_state
from groundstation.dynamics.vehicle import BUILT_IN, THESIS_MOTOR, MotorConstants
from groundstation.identification.arx.data import ArxData
from groundstation.identification.arx.fit import search_arx
from groundstation.identification.body.fit import fit_body
from groundstation.identification.body.validation import fit_free_run
from groundstation.identification.motor.fit import bench_run, fit_motor
from groundstation.identification.motor.problem import MotorRun
from groundstation.identification.motor.supply import undo_supply
from groundstation.identification.runs import Run, runs_of
from groundstation.identification.stretches import stretches_of
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch

Array = NDArray[np.float64]

VEHICLE = BUILT_IN["crazyflie1"]
SEEDS = 50
MOTOR_TRUE = np.array([THESIS_MOTOR.a0, THESIS_MOTOR.a1, THESIS_MOTOR.a2])
BODY_TRUE = np.array([*VEHICLE.body_constants, VEHICLE.thrust_per_mass])
PERIOD = 0.002
DLPF_LAG_S = 1 / (2 * np.pi * 188)
"""The faithful sensor's own lag, which a delay fitted to the gyro contains."""


def rows() -> Iterator[Row]:
    """What, measured, reference in the same run, unit."""
    yield from _simulation()
    yield from _motor_speed()
    yield from _arx_speed()
    yield from _body_speed()
    yield from _motor_accuracy()
    yield from _body_accuracy()


def _simulation() -> Iterator[Row]:
    steps = 200_000
    voltage = np.full((steps, 4), 2400.0)
    start = craft_state(rates=(0.1, 0.2, 0.3), rotor_rev_s=250)
    craft = craft_of_vehicle(VEHICLE, {"inertia_coupling": {"fraction": 1.0}})
    numbers = np.array([*VEHICLE.inertia_kg_m2, VEHICLE.mass_kg, VEHICLE.thrust_n, 0.045, 9.5e-9])
    log = np.empty((steps + 1, 17))
    ours = best(lambda: simulate(craft, start, voltage), 15)
    bare = best(lambda: _bare_flight(numbers, MOTOR_TRUE, start, voltage, log), 15)
    yield Row(
        "6-DOF with motors, full log (bare loop)",
        steps / ours / 1e6,
        steps / bare / 1e6,
        "M steps/s",
    )


def _motor_speed() -> Iterator[Row]:
    generator = np.random.default_rng(0)
    rows = 4000
    voltage = np.repeat(generator.uniform(800, 3600, rows // 100), 100)
    speed, _ = simulate_motor(THESIS_MOTOR, voltage[1:, None], PERIOD, [120.0])
    measured = speed[:, 0] + generator.normal(0, 0.3, rows)
    run = MotorRun("made", PERIOD, voltage, measured, np.zeros(rows), np.zeros(rows))
    ours = best(lambda: fit_motor([run]), 15)
    bare = best(lambda: _bare_motor_fit(voltage, measured), 15)
    yield Row("motor fit, 4000 samples (bare Levenberg-Marquardt)", ours * 1e3, bare * 1e3, "ms")


def _arx_speed() -> Iterator[Row]:
    for rows in (4000, 100_000):
        data = [_arx_data(rows, seed) for seed in (0, 1)]
        ours = best(lambda data=data: search_arx(data[:1], data[1:]), 15)
        bare = best(lambda data=data: _bare_arx_search(data[0], data[1]), 15)
        yield Row(
            f"ARX search, 88 structures, {rows} rows (bare shared Gram)",
            ours * 1e3,
            bare * 1e3,
            "ms",
        )


def _body_speed() -> Iterator[Row]:
    runs = _recorded(65.0, plant="reduced", seed=0)
    stretches = stretches_of(runs, THESIS_MOTOR)
    count = sum(len(one) for one in stretches)
    yield Row(
        f"body fit, three axes, {count} rows",
        best(lambda: fit_body(stretches_of(runs, THESIS_MOTOR), VEHICLE), 5),
        None,
        "s",
        most=1.0,
    )
    yield Row(
        "body fit with dead time",
        best(lambda: fit_body(stretches, VEHICLE, ("dead_time",)), 3),
        None,
        "s",
        most=1.0,
    )


def _motor_accuracy() -> Iterator[Row]:
    errors, inside = [], []
    for seed in range(SEEDS):
        (run,) = _recorded(13.5, program="motor_bench", plant="reduced", supply_v=3.7, seed=seed)
        fit = fit_motor([bench_run(run[2500:6500])])
        interval = fit.estimates.interval()[:3]
        errors.append(fit.estimates.values[:3] / MOTOR_TRUE - 1)
        inside.append((interval[:, 0] <= MOTOR_TRUE) & (interval[:, 1] >= MOTOR_TRUE))
    worst = 100 * np.abs(errors).max(axis=0)
    covered = np.mean(inside, axis=0)
    for i, name in enumerate(("a0", "a1", "a2")):
        yield Row(
            f"motor bench, {SEEDS} seeds: worst error of {name}", worst[i], None, "%", most=2.0
        )
        yield Row(
            f"motor bench, {SEEDS} seeds: {name} inside its 95 %",
            covered[i],
            None,
            "share",
            least=0.9,
        )


CONSTANTS = ("c0", "c1", "c2", "thrust_per_mass")
PRESENT = ("dead_time", "inertia_coupling", "rotor_gyroscopic_torque", "rotor_acceleration_torque")
"""What the faithful plant has beside its supply."""


def _body_accuracy() -> Iterator[Row]:
    cases: tuple[tuple[str, tuple[str, ...], bool], ...] = (
        ("reduced", (), False),
        ("reduced, motor from 8 s of bench", (), False),
        ("faithful", ("dead_time", "rotor_acceleration_torque"), False),
        ("faithful, supply undone, all present effects", PRESENT, True),
    )
    for label, effects, supplied in cases:
        plant = label.partition(",")[0]
        errors, inside, naive, delays = [], [], [], []
        for seed in range(SEEDS):
            motor, covariance = THESIS_MOTOR, None
            if "bench" in label:
                motor, covariance = _bench_motor(seed)
            craft = StandIn(
                msgspec.convert({"plant": plant, "seed": seed, "truth": True}, StandInSettings)
            )
            runs = _decoded(craft.advance(65.0))
            if supplied:
                runs, _ = undo_supply(runs, motor, VEHICLE, ("battery_reading_lag", "supply_sag"))
            stretches = stretches_of(runs, motor)
            fit = fit_body(stretches, VEHICLE, effects, motor_covariance=covariance)
            place = [fit.estimates.names.index(name) for name in CONSTANTS]
            interval = fit.estimates.interval()[place]
            errors.append(fit.estimates.values[place] / BODY_TRUE - 1)
            inside.append((interval[:, 0] <= BODY_TRUE) & (interval[:, 1] >= BODY_TRUE))
            naive.append(fit_free_run(stretches, VEHICLE) / BODY_TRUE[:3] - 1)
            true = craft.truth()["sensor_age_s"][3000:].mean() + DLPF_LAG_S
            delays.append(fit.delay_s - true)
        yield from _accuracy_rows(f"{label}, {SEEDS} flights", errors, inside, label != "faithful")
        if label in ("reduced", "faithful"):
            for i, name in enumerate(CONSTANTS[:3]):
                worst = 100 * np.abs(np.array(naive)[:, i]).max()
                yield Row(f"{label}: worst error of {name}, naive free run", worst, None, "%")
        if effects:
            worst = 1e3 * float(np.abs(delays).max())
            yield Row(f"{label}: worst error of the delay", worst, None, "ms", most=2.0)


def _accuracy_rows(label: str, errors: Any, inside: Any, covered: bool) -> Iterator[Row]:
    for i, name in enumerate(CONSTANTS):
        values = np.array(errors)[:, i]
        yield Row(
            f"{label}: worst error of {name}", 100 * np.abs(values).max(), None, "%", most=3.0
        )
        limit = 0.5 if covered else None
        yield Row(f"{label}: mean error of {name}", 100 * abs(values.mean()), None, "%", limit)
        if covered:
            yield Row(
                f"{label}: {name} inside its 95 %", np.mean(inside, 0)[i], None, "share", least=0.9
            )


def _bench_motor(seed: int) -> tuple[MotorConstants, Array]:
    """A motor and its covariance from 8 s on a bench with a stiff supply."""
    (run,) = _recorded(13.5, program="motor_bench", plant="reduced", supply_v=3.7, seed=seed)
    fit = fit_motor([bench_run(run[2500:6500])])
    return fit.motor, fit.estimates.covariance[:3, :3]


def _recorded(seconds: float, **settings: Any) -> list[Run]:
    return _decoded(StandIn(StandInSettings(**settings)).advance(seconds))


def _decoded(heard: tuple[NDArray[np.uint8], Array]) -> list[Run]:
    packets, heard_s = heard
    samples, _ = decode_all(RawBatch(packets, np.rint(heard_s * 1e9).astype(np.int64)))
    return runs_of(samples)


def _arx_data(rows: int, seed: int) -> ArxData:
    from groundstation.dynamics.arx import simulate_arx

    generator = np.random.default_rng(seed)
    inputs = np.repeat(generator.uniform(-2e4, 2e4, rows // 40 + 1), 40)[:rows]
    axis = ArxAxis(2, 1, 3, (-1.95, 0.9503), (2e-7,), PERIOD)
    outputs = simulate_arx(axis, inputs) + generator.normal(0, 1e-4, rows)
    return ArxData("made", PERIOD, inputs, outputs)


# --- references --------------------------------------------------------------------------------


@njit(cache=True)
def _bare_slope(c: Any, m: Any, u: Any, y: Any, d: Any) -> None:
    s0, s1, s2, s3 = y[13] ** 2, y[14] ** 2, y[15] ** 2, y[16] ** 2
    lift = c[4] * (s0 + s1 + s2 + s3) / c[3]
    w, a, b, e, p, q, r = y[6], y[7], y[8], y[9], y[10], y[11], y[12]
    d[0], d[1], d[2] = y[3], y[4], y[5]
    d[3], d[4] = 2 * (a * e + w * b) * lift, 2 * (b * e - w * a) * lift
    d[5] = (1 - 2 * (a * a + b * b)) * lift - 9.80665
    d[6], d[7] = 0.5 * (-a * p - b * q - e * r), 0.5 * (w * p + b * r - e * q)
    d[8], d[9] = 0.5 * (w * q + e * p - a * r), 0.5 * (w * r + a * q - b * p)
    d[10] = (c[4] * c[5] * (s3 - s1) + (c[1] - c[2]) * q * r) / c[0]
    d[11] = (c[4] * c[5] * (s2 - s0) + (c[2] - c[0]) * p * r) / c[1]
    d[12] = (c[6] * (-s0 + s1 - s2 + s3) + (c[0] - c[1]) * p * q) / c[2]
    for i in range(4):
        n = y[13 + i]
        d[13 + i] = m[0] * u[i] - m[1] * n - m[2] * n * n


@njit(cache=True)
def _bare_flight(c: Any, m: Any, start: Any, voltage: Any, log: Any) -> None:
    y, z = start.copy(), np.empty(17)
    k1, k2, k3, k4 = np.empty(17), np.empty(17), np.empty(17), np.empty(17)
    h = 0.002
    log[0] = y
    for k in range(len(voltage)):
        u = voltage[k]
        _bare_slope(c, m, u, y, k1)
        for i in range(17):
            z[i] = y[i] + 0.5 * h * k1[i]
        _bare_slope(c, m, u, z, k2)
        for i in range(17):
            z[i] = y[i] + 0.5 * h * k2[i]
        _bare_slope(c, m, u, z, k3)
        for i in range(17):
            z[i] = y[i] + h * k3[i]
        _bare_slope(c, m, u, z, k4)
        for i in range(17):
            y[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i])
            log[k + 1, i] = y[i]


@njit(cache=True)
def _bare_motor_system(theta: Any, voltage: Any, measured: Any) -> Any:
    """Simulation (RK4), sensitivities (same stages), J^T J and J^T e in one loop."""
    normal, gradient, cost = np.zeros((4, 4)), np.zeros(4), 0.0
    x = np.array([theta[3], 0.0, 0.0, 0.0, 1.0])
    k = np.empty((4, 5))
    z = np.empty(5)
    for i in range(len(voltage)):
        if i > 0:
            for stage in range(4):
                step = 0.0 if stage == 0 else (0.002 if stage == 3 else 0.001)
                for j in range(5):
                    z[j] = x[j] + (step * k[stage - 1, j] if stage else 0.0)
                n, g = z[0], theta[1] + 2 * theta[2] * z[0]
                k[stage, 0] = theta[0] * voltage[i] - theta[1] * n - theta[2] * n * n
                k[stage, 1] = voltage[i] - g * z[1]
                k[stage, 2] = -n - g * z[2]
                k[stage, 3] = -n * n - g * z[3]
                k[stage, 4] = -g * z[4]
            for j in range(5):
                x[j] += 0.002 / 6 * (k[0, j] + 2 * k[1, j] + 2 * k[2, j] + k[3, j])
        error = measured[i] - x[0]
        cost += error * error
        for a in range(4):
            gradient[a] += x[1 + a] * error
            for b in range(4):
                normal[a, b] += x[1 + a] * x[1 + b]
    return normal, gradient, cost


def _bare_motor_fit(voltage: Array, measured: Array) -> Array:
    theta = np.array([0.8, 6.0, 0.007, measured[0]])
    damping = 1e-3
    normal, gradient, cost = _bare_motor_system(theta, voltage, measured)
    for _ in range(30):
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)
        trial = _bare_motor_system(theta + step, voltage, measured)
        if trial[2] < cost:
            done = cost - trial[2] < 1e-9 * cost
            theta, damping = theta + step, damping / 10
            normal, gradient, cost = trial
            if done:
                break
        else:
            damping *= 10
    return theta


@njit(cache=True)
def _bare_free_run(a: Any, b: Any, nk: int, inputs: Any, outputs: Any) -> float:
    total = 0.0
    y1, y2, y3, y4 = outputs[11], outputs[10], outputs[9], outputs[8]
    for t in range(12, len(inputs)):
        y = b[0] * inputs[t - nk] + b[1] * inputs[t - nk - 1]
        y -= a[0] * y1 + a[1] * y2 + a[2] * y3 + a[3] * y4
        total += (outputs[t] - y) ** 2
        y4, y3, y2, y1 = y3, y2, y1, y
    return total


def _bare_arx_search(fit: ArxData, held: ArxData) -> float:
    y, u = fit.outputs, fit.inputs
    rows = len(y) - 12
    lagged = np.empty((17, rows))
    lagged[0] = y[12:]
    for i in range(1, 5):
        lagged[i] = -y[12 - i : 12 - i + rows]
    for j in range(12):
        lagged[5 + j] = u[12 - j : 12 - j + rows]
    gram = lagged @ lagged.T
    best = np.inf
    for na in range(1, 5):
        for nb in (1, 2):
            for nk in range(11):
                chosen = [*range(1, na + 1), *range(5 + nk, 5 + nk + nb)]
                theta = np.linalg.solve(gram[np.ix_(chosen, chosen)], gram[chosen, 0])
                a, b = np.zeros(4), np.zeros(2)
                a[:na], b[:nb] = theta[:na], theta[na:]
                for data in (fit, held):
                    best = min(best, _bare_free_run(a, b, nk, data.inputs, data.outputs))
    return best
