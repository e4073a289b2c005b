"""How exact fits are: 50 seeds of the software craft, whose constants are known."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from bench.table import Row
from firmware_sim.craft import StandIn, StandInSettings
from groundstation.dynamics.vehicle import BUILT_IN, THESIS_MOTOR
from groundstation.identification.body import fit_body
from groundstation.identification.flight import stretches_of
from groundstation.identification.motor.fit import bench_run, fit_motor
from groundstation.identification.motor.workflow import undo_supply
from groundstation.identification.runs import Run, runs_of
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
    """The worst and the mean of the errors, and how often the truth is inside the interval."""
    yield from _motor_accuracy()
    yield from _body_accuracy()


def _motor_accuracy() -> Iterator[Row]:
    errors, inside = [], []
    for seed in range(SEEDS):
        fit = _bench_fit(seed)
        interval = fit.estimates.interval()[:3]
        errors.append(fit.estimates.values[:3] / MOTOR_TRUE - 1)
        inside.append((interval[:, 0] <= MOTOR_TRUE) & (interval[:, 1] >= MOTOR_TRUE))
    worst = 100 * np.abs(errors).max(axis=0)
    covered = np.mean(inside, axis=0)
    label = f"motor bench, {SEEDS} seeds"
    for i, name in enumerate(("a0", "a1", "a2")):
        yield Row(f"{label}: worst error of {name}", worst[i], None, "%", most=2.0)
        yield Row(f"{label}: {name} inside its 95 %", covered[i], None, "share", least=0.9)


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
        errors, inside, delays = [], [], []
        for seed in range(SEEDS):
            motor, covariance = THESIS_MOTOR, None
            if "bench" in label:
                fitted = _bench_fit(seed)
                motor, covariance = fitted.motor, fitted.estimates.covariance[:3, :3]
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
            true = craft.truth()["sensor_age_s"][3000:].mean() + DLPF_LAG_S
            delays.append(fit.delay_s - true)
        yield from _accuracy_rows(f"{label}, {SEEDS} flights", errors, inside, label != "faithful")
        if effects:
            worst = 1e3 * float(np.abs(delays).max())
            yield Row(f"{label}: worst error of the delay", worst, None, "ms", most=2.0)


def _accuracy_rows(label: str, errors: Any, inside: Any, covered: bool) -> Iterator[Row]:
    for i, name in enumerate(CONSTANTS):
        values, within = np.array(errors)[:, i], np.mean(inside, 0)[i]
        worst = 100 * np.abs(values).max()
        yield Row(f"{label}: worst error of {name}", worst, None, "%", most=3.0)
        limit = 0.5 if covered else None
        yield Row(f"{label}: mean error of {name}", 100 * abs(values.mean()), None, "%", limit)
        if covered:
            yield Row(f"{label}: {name} inside its 95 %", within, None, "share", least=0.9)


def _bench_fit(seed: int) -> Any:
    """Of a motor, from 8 s on a bench with a stiff supply."""
    bench = StandInSettings(program="motor_bench", plant="reduced", supply_v=3.7, seed=seed)
    (run,) = _decoded(StandIn(bench).advance(13.5))
    return fit_motor([bench_run(run[2500:6500])])


def _decoded(heard: tuple[NDArray[np.uint8], Array]) -> list[Run]:
    packets, heard_s = heard
    samples, _ = decode_all(RawBatch(packets, np.rint(heard_s * 1e9).astype(np.int64)))
    return runs_of(samples)
