"""How fast the stand-in flies, how punctual it is, and what its first start costs."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numba import njit

from bench.table import Row
from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.layout import STATE
from firmware_sim.monte_carlo import fly_many
from firmware_sim.physics import parameters
from firmware_sim.plant import integrate

FLIGHT_S = 60.0
PASSES = 30_000
SUBSTEPS = 4
FLIGHTS, FLIGHTS_S, BATCHES = 1000, 10.0, 8
JITTER_S, RELEASE_S = 10.0, 0.01


def rows() -> Iterator[Row]:
    """Each speed beside its reference in the same run."""
    for plant in ("reduced", "faithful"):
        settings = StandInSettings(plant=plant)
        StandIn(settings).advance(1.0)
        seconds = min(_seconds(lambda s=settings: StandIn(s).advance(FLIGHT_S)) for _ in range(3))
        yield Row(
            f"{plant}: 60 s of flight with radio and packets (real time)",
            FLIGHT_S / seconds,
            1.0,
            "x",
            least=60.0,
        )
    plant_s, loop_s = _plant_against_loop()
    steps = PASSES * SUBSTEPS
    yield Row("bare plant, RK4 (hand-written loop)", steps / plant_s, steps / loop_s, "step/s")
    yield _monte_carlo()
    lateness_ms = _release_lateness_ms()
    yield Row("real time: release lateness, 99th percentile", lateness_ms, None, "ms", most=2.0)
    cold, warm = _start_up_s()
    yield Row("first start ever, which compiles (later starts)", cold, warm, "s")


def _monte_carlo() -> Row:
    def settings(count: int) -> list[StandInSettings]:
        return [StandInSettings(seed=seed, copies=1) for seed in range(count)]

    def bytes_of(craft: StandIn, packets: Any, arrivals: Any) -> int:
        return len(packets)

    # In turns, and the best of each: the machine may have other things to do.
    alone, together = [], []
    for _ in range(BATCHES):
        few, many = settings(FLIGHTS // BATCHES // 4), settings(FLIGHTS // BATCHES)
        alone.append(len(few) / _seconds(lambda f=few: fly_many(f, FLIGHTS_S, bytes_of, workers=1)))
        together.append(len(many) / _seconds(lambda m=many: fly_many(m, FLIGHTS_S, bytes_of)))
    return Row(
        f"1000 flights of 10 s on {os.cpu_count()} cores (one core)",
        FLIGHTS_S * max(together),
        FLIGHTS_S * max(alone),
        "flight s/s",
    )


def _release_lateness_ms() -> float:
    craft = StandIn(StandInSettings())
    craft.advance(5.0)
    start, late = time.monotonic(), []
    for step in range(1, int(JITTER_S / RELEASE_S) + 1):
        due = start + step * RELEASE_S
        time.sleep(max(due - time.monotonic(), 0.0))
        craft.advance(5.0 + step * RELEASE_S)
        late.append(time.monotonic() - due)
    return float(np.percentile(late, 99)) * 1e3


def _start_up_s() -> tuple[float, float]:
    code = "from firmware_sim.craft import StandIn; StandIn().advance(1.0)"
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        command = [sys.executable, "-c", code]
        cold = _seconds(lambda: subprocess.run(command, env=environment, check=True))
        warm = _seconds(lambda: subprocess.run(command, env=environment, check=True))
    return cold, warm


def _plant_against_loop() -> tuple[float, float]:
    """Seconds for the same flight by the plant and by a loop that can do nothing else."""
    p = parameters(StandInSettings(plant="reduced", substeps=SUBSTEPS))

    @njit(nogil=True, error_model="numpy")
    def plant(p: Any, s: Any, passes: int) -> None:
        for i in range(passes):
            _steer(s.duty, i)
            integrate(p, s, i * 0.002, 0.002)

    def fly_plant() -> Any:
        s = np.zeros(1, STATE)
        s["y"][0] = _start(len(s["y"][0]))
        s["supply_mv"] = 3700.0
        plant(p[0], s[0], PASSES)
        return s["y"][0, :17]

    names = ("a0", "a1", "a2", "thrust", "drag", "rotor_x", "inertia", "mass")
    constants = np.concatenate([np.atleast_1d(p[0][name]) for name in names])

    def fly_loop() -> Any:
        y = _start(17)
        _loop(constants, y, PASSES, SUBSTEPS)
        return y

    assert np.allclose(fly_plant(), fly_loop(), rtol=1e-6, atol=1e-9), "not the same flight"
    plant_s = min(_seconds(fly_plant) for _ in range(5))
    return plant_s, min(_seconds(fly_loop) for _ in range(5))


def _start(states: int) -> Any:
    y = np.zeros(states)
    y[2], y[6], y[13:17] = 1e6, 1.0, 240.0
    return y


@njit(nogil=True, error_model="numpy")
def _steer(duty: Any, i: int) -> None:
    for k in range(4):
        duty[k] = 0.6 + 0.01 * (((i >> 5) + k) & 3)


@njit(nogil=True, error_model="numpy")
def _loop(c: Any, y: Any, passes: int, substeps: int) -> None:
    """The reduced plant written out by hand: motors, thrust, torques, quaternion, RK4."""
    duty, k1, k2, k3, k4, z = (
        np.zeros(4),
        np.zeros(17),
        np.zeros(17),
        np.zeros(17),
        np.zeros(17),
        np.zeros(17),
    )
    h = 0.002 / substeps
    for i in range(passes):
        _steer(duty, i)
        for _ in range(substeps):
            _slopes(c, duty, y, k1)
            for j in range(17):
                z[j] = y[j] + 0.5 * h * k1[j]
            _slopes(c, duty, z, k2)
            for j in range(17):
                z[j] = y[j] + 0.5 * h * k2[j]
            _slopes(c, duty, z, k3)
            for j in range(17):
                z[j] = y[j] + h * k3[j]
            _slopes(c, duty, z, k4)
            for j in range(17):
                y[j] += h / 6 * (k1[j] + 2 * k2[j] + 2 * k3[j] + k4[j])
        norm = np.sqrt(y[6] ** 2 + y[7] ** 2 + y[8] ** 2 + y[9] ** 2)
        for j in range(6, 10):
            y[j] /= norm


@njit(nogil=True, error_model="numpy")
def _slopes(c: Any, duty: Any, y: Any, dy: Any) -> None:
    squares = np.empty(4)
    for k in range(4):
        n = y[13 + k]
        squares[k] = n * n
        dy[13 + k] = c[0] * duty[k] * 3700.0 - c[1] * n - c[2] * n * n
    q0, q1, q2, q3, p, q, r = y[6], y[7], y[8], y[9], y[10], y[11], y[12]
    thrust = c[3] * (squares[0] + squares[1] + squares[2] + squares[3]) / c[12]
    for j in range(3):
        dy[j] = y[3 + j]
    dy[3] = 2 * (q1 * q3 + q0 * q2) * thrust
    dy[4] = 2 * (q2 * q3 - q0 * q1) * thrust
    dy[5] = (1 - 2 * (q1 * q1 + q2 * q2)) * thrust - 9.80665
    dy[6] = 0.5 * (-q1 * p - q2 * q - q3 * r)
    dy[7] = 0.5 * (q0 * p + q2 * r - q3 * q)
    dy[8] = 0.5 * (q0 * q + q3 * p - q1 * r)
    dy[9] = 0.5 * (q0 * r + q1 * q - q2 * p)
    dy[10] = c[3] * c[5] * (squares[3] - squares[1]) / c[9]
    dy[11] = c[3] * c[5] * (squares[2] - squares[0]) / c[10]
    dy[12] = c[4] * (-squares[0] + squares[1] - squares[2] + squares[3]) / c[11]


def _seconds(action: Any) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start
