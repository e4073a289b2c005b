"""NanoBench's first task by the protocol of its released code, and predictions by steps.

Thrust (``benchmarks/task1_sysid.py`` of February 2026): what is predicted is the second derivative
of Vicon's height (Savitzky-Golay, 15 rows, third order) plus 9.81, on rows with M1 above 1000; the
first 70 % of a flight fit, the last 30 % (landing included) judge; figures are means over flights.
The published table has two flights, circle slow and figure-eight fast, at 200 Hz, which are not
among the 100 Hz files released later; its other three baselines leave gravity out on one side
(36 m/s^2 and more), so only the linear regression is repeated here.

Steps: open loop from every tenth airborne row, mean Euclidean error of velocity (Vicon) and rates
(gyro) 1, 10 and 50 rows ahead, as in Busetto and others (arXiv 2512.14450), beside holding the
first value. Their craft (brushless) and inputs (measured rotor speeds) are others, and NanoBench's
own splitter is not in its repository: no published figure stands beside these.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from bench.real.sets import Split
from groundstation.dynamics.model import Model, load_model
from groundstation.dynamics.rotations import rotation_matrix
from groundstation.identification.recordings import flights_of, without_gaps
from groundstation.identification.runs import Run
from groundstation.prediction.drive import drive_run
from groundstation.prediction.prediction import predict_ahead
from groundstation.recording.open_recording import open_recording

Array = NDArray[np.float64]

GRAVITY = 9.81
"""As in the benchmark's code."""
FLYING_PWM, FITTED_SHARE = 1000.0, 0.70
STEPS = (1, 10, 50)
STRIDE = 10
PUBLISHED = "2.171 m/s^2, R^2 -0.259"


def tables(cases: Sequence[tuple[Split, Sequence[str]]], folder: Path) -> Iterator[str]:
    """Each split with its fitted and its improved model: two tables on every held-out flight."""
    yield ""
    yield (
        "| held-out flight | vertical acceleration: their linear regression, fitted on the"
        f" flight's first 70 % (published, other flights: {PUBLISHED}) | fit body on other flights,"
        " with the reported tilt | after naming |"
    )
    yield "|---|---|---|---|"
    ahead = []
    for split, paths in cases:
        models = [load_model(path) for path in paths]
        for name in split.held:
            run, velocity, height = _flight(folder / name)
            yield f"| {name} | {' | '.join(_thrust(models, run, height))} |"
            ahead.append((name, _by_steps(models, run, velocity)))
    yield ""
    heads = [f"{what}, {step} steps" for what in ("velocity, m/s", "rate, rad/s") for step in STEPS]
    yield f"| held-out flight: first value held; fit body; after naming | {' | '.join(heads)} |"
    yield "|---" * (1 + len(heads)) + "|"
    for name, errors in ahead:
        cells = ("; ".join(f"{one:.3f}" for one in group) for group in errors)
        yield f"| {name} | {' | '.join(cells)} |"


def _flight(path: Path) -> tuple[Run, Array, Array]:
    """The flight, Vicon's velocity (n, 3) and height (n,)."""
    recording = open_recording(path)
    (run,) = flights_of(recording.samples, path.name)
    vicon = recording.tables["vicon"]
    columns = {
        name: np.interp(run.time_s, vicon.time_s, vicon.columns[name].astype(np.float64))
        for name in ("vx", "vy", "vz", "pz")
    }
    velocity = np.column_stack([columns[name] for name in ("vx", "vy", "vz")])
    return without_gaps(run), velocity, columns["pz"]


def _thrust(models: Sequence[Model], run: Run, height: Array) -> Iterator[str]:
    flying = np.round(run.duty[:, 0] * 65535) > FLYING_PWM
    truth = savgol_filter(height[flying], 15, 3, deriv=2, delta=run.period_s) + GRAVITY
    inputs = np.column_stack([run.duty * 65535, run.supply_v, np.ones(len(run))])[flying]
    first = int(FITTED_SHARE * len(truth))
    weights = np.linalg.lstsq(inputs[:first], truth[:first], rcond=None)[0]
    yield _scored(truth[first:], inputs[first:] @ weights)
    for model in models:
        assert model.body is not None
        speed = drive_run(model, run).rotor_rev_s
        lift = model.body.thrust_per_mass * (speed**2).sum(axis=1)
        upward = (rotation_matrix(run.attitude)[:, 2, 2] * lift)[flying]
        yield _scored(truth[first:], upward[first:])


def _scored(truth: Array, made: Array) -> str:
    left = truth - made
    share = 1.0 - float(left @ left) / float(np.sum((truth - truth.mean()) ** 2))
    return f"{np.sqrt(np.mean(left**2)):.3f} m/s^2, R^2 {share:.2f}"


def _by_steps(models: Sequence[Model], run: Run, velocity: Array) -> list[list[float]]:
    """Mean Euclidean errors of velocity in m/s, then rates in rad/s, by ``STEPS``: the first value
    held, then each model."""
    ahead = [predict_ahead(one, run, np.arange(1, STEPS[-1] + 1), stride=STRIDE) for one in models]
    out = []
    for step in STEPS:
        errors = []
        for made in ahead:
            force = np.einsum("mgij,mgj->mgi", rotation_matrix(made.attitude), made.accelerometer)
            gained = (force - [0.0, 0.0, GRAVITY])[:, :step].sum(axis=1) * run.period_s
            truth = velocity[made.rows + step] - velocity[made.rows]
            errors += [_mean_length(truth), _mean_length(truth - gained)]
        out.append([errors[0], *errors[1::2]])
    for step in STEPS:
        errors = []
        for made in ahead:
            truth = run.gyro[made.rows + step]
            errors += [_mean_length(truth - run.gyro[made.rows])]
            errors += [_mean_length(truth - made.gyro[:, step - 1])]
        out.append([errors[0], *errors[1::2]])
    return out


def _mean_length(errors: Array) -> float:
    return float(np.mean(np.linalg.norm(errors, axis=1)))
