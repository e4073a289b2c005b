"""The load that swings: how much of the force in the rotors' plane a pendulum explains.

What the accelerometer shows in the plane is drag, which goes with the velocity, and with a load on
a line what that pulls. A pendulum of any angle, hung straight where a flight begins, is driven by
the measured specific force; its pull on the craft, per unit of mass, is regressed beside the
velocity within ``BAND_HZ``. Length and damping are those that explain most of the fitted flights;
judged is on others. The velocity is the motion capture's, as in ``slow``.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.real.slow import CASES, FLYING_DUTY
from groundstation.dynamics.rotations import rotation_matrix
from groundstation.recording.open_recording import open_recording
from groundstation.telemetry.packet import STANDARD_GRAVITY

Array = NDArray[np.float64]

BAND_HZ = (0.25, 4.0)
LENGTHS_M = tuple(np.geomspace(0.1, 1.5, 41).tolist())
DAMPINGS_PER_S = (0.1, 0.2, 0.4, 0.8, 1.6)
BEGIN_S, EDGE_S = 0.3, 0.5
"""Left out after the rotors are up, and at both ends of the filtered rows."""


@dataclass(frozen=True, slots=True)
class Flown:
    """A flight on even rows. rotation: (n, 3, 3) body to inertial; velocity, force: (n, 3) in body
    axes, m/s and m/s^2."""

    period_s: float
    rotation: Array
    velocity: Array
    force: Array


@dataclass(frozen=True, slots=True)
class Swing:
    """gains: minus drag over mass in 1/s, and the load's mass over the craft's. plain, explained:
    share of the force's power on the held-out flights, by drag alone and with the swing."""

    length_m: float
    damping_per_s: float
    gains: Array
    plain: float
    explained: float


def find_swing(fitted: Sequence[Flown], held: Sequence[Flown], axis: int) -> Swing:
    """Fit on some flights, judge on others. axis: 0 forward, 1 left."""
    grid = np.array(list(itertools.product(LENGTHS_M, DAMPINGS_PER_S)))
    rows = [[_columns(one, axis, grid) for one in flights] for flights in (fitted, held)]

    def share(which: int, number: int | None, gains: Array | None = None) -> tuple[float, Array]:
        force = np.concatenate([one[0] for one in rows[which]])
        parts = [np.concatenate([one[1] for one in rows[which]])]
        if number is not None:
            parts.append(np.concatenate([one[2][:, number] for one in rows[which]]))
        signals = np.column_stack(parts)
        if gains is None:
            gains = np.linalg.lstsq(signals, force, rcond=None)[0]
        return 1.0 - float(((force - signals @ gains) ** 2).sum() / (force**2).sum()), gains

    best = max(range(len(grid)), key=lambda number: share(0, number)[0])
    gains, drag = share(0, best)[1], share(0, None)[1]
    plain, explained = share(1, None, drag)[0], share(1, best, gains)[0]
    return Swing(*grid[best].tolist(), gains, plain, explained)


def table(data: Path) -> Iterator[str]:
    """A row per craft and axis."""
    yield ""
    yield (
        "| flights | axis | explained by drag | with a swing | length, m | damping, 1/s |"
        " load over craft |"
    )
    yield "|---|---|---|---|---|---|---|"
    for label, folder, fitted, held in CASES:
        if not (data / folder).is_dir():
            continue
        parts = [[read_flight(data / folder / name) for name in names] for names in (fitted, held)]
        for axis, name in enumerate(("forward", "left")):
            found = find_swing(*parts, axis)
            yield (
                f"| {label} | {name} | {100 * found.plain:.0f} % | {100 * found.explained:.0f} % |"
                f" {found.length_m:.2f} | {found.damping_per_s:g} | {found.gains[1]:.3f} |"
            )


def read_flight(path: Path) -> Flown:
    """A microSD log with the state estimate's velocity."""
    recording = open_recording(path)
    samples, state = recording.samples, recording.tables["fixedFrequency"].columns
    time, period = samples.time_s, float(np.median(np.diff(samples.time_s)))
    flying = np.flatnonzero((samples.duty > FLYING_DUTY).all(axis=1))
    grid = np.arange(time[flying[0]] + BEGIN_S, time[flying[-1]], period)

    def even(values: NDArray[np.generic]) -> Array:
        return np.asarray(np.interp(grid, time, values.astype(np.float64)))

    rotation = rotation_matrix(
        np.column_stack([even(np.unwrap(one)) for one in samples.attitude.T])
    )
    world = np.column_stack([even(state[f"stateEstimate.v{a}"]) for a in "xyz"])
    force = np.column_stack([even(one) for one in samples.accelerometer.T])
    if abs(float(force[:, 2].mean())) < 0.5 * STANDARD_GRAVITY:
        force = force * STANDARD_GRAVITY  # logged in g
    return Flown(period, rotation, np.einsum("nji,nj->ni", rotation, world), force)


def pulls(flight: Flown, grid: Array) -> Array:
    """Pull of each pendulum (length, damping) per unit of its mass, (n, pendulums, 3) body axes."""
    length, damping = grid.T[:, :, None]
    felt = np.einsum("nij,nj->ni", flight.rotation, flight.force)
    line = np.tile([0.0, 0.0, -1.0], (len(grid), 1))
    slope = np.zeros((len(grid), 3))
    found = np.empty((len(felt), len(grid), 3))
    for row, force in enumerate(felt):
        along = line @ force
        square = (slope**2).sum(axis=1)
        found[row] = np.maximum(length[:, 0] * square - along, 0.0)[:, None] * line
        across = force - along[:, None] * line
        slope -= flight.period_s * (across / length + damping * slope + square[:, None] * line)
        line += flight.period_s * slope
        line /= np.linalg.norm(line, axis=1, keepdims=True)
        slope -= (slope * line).sum(axis=1, keepdims=True) * line
    return np.einsum("nji,nkj->nki", flight.rotation, found)


def _columns(flight: Flown, axis: int, grid: Array) -> tuple[Array, Array, Array]:
    """Force, velocity and pulls along an axis, from the band that counts."""
    from scipy.signal import butter, sosfiltfilt

    sections = butter(2, BAND_HZ, "band", fs=1.0 / flight.period_s, output="sos")
    edge = round(EDGE_S / flight.period_s)

    def band(values: Array) -> Array:
        return np.asarray(sosfiltfilt(sections, values, axis=0)[edge:-edge])

    made = pulls(flight, grid)[:, :, axis]
    return band(flight.force[:, axis]), band(flight.velocity[:, axis]), band(made)
