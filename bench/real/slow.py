"""The slow component in rotation: how much of it the moment of velocity is.

Below some 4 Hz the mixer's torque does not turn the craft: it balances slow moments, which a model
of squared rotor speeds alone has no name for (arXiv 2512.14450 leaves it as an open problem). The
missing moment is the angular acceleration less the torque's; here it is regressed on the body
velocity (``velocity_moment``), gains and the spectrum of what is left found in turn as in
``reference``, and judged by bands on flights that were not fitted. The velocity is the motion
capture's, as the log's state estimate carries it: this asks what is there, not what the program can
find without.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.real.reference import AXES, LEADS_S, MIXER_X
from groundstation.dynamics.rotations import rotation_matrix
from groundstation.recording.open_recording import open_recording
from groundstation.report.figure import figure, png
from groundstation.report.theme import BAD, GOOD, MEASURED, NEUTRAL

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FITTED_HZ = (0.3, 18.0)
BANDS_HZ = (0.3, 0.6, 1.0, 2.0, 4.0)
DELAYS_S = tuple(np.arange(0.006, 0.021, 0.002).tolist())
SMOOTHED_HZ, ROUNDS, FLYING_DUTY = 2.0, 12, 0.25
CASES = (
    ("brushless a", "imrc", ("eckart00", "eckart22", "eckart34"), ("eckart12", "eckart27")),
    ("brushless b", "imrc", ("eckart12", "eckart27"), ("eckart00", "eckart34")),
    ("brushed", "imrc_brushed", ("jana01",), ("jana02", "jana03")),
    ("with payload", "imrc_payload", ("eckart06", "eckart20"), ("eckart12", "eckart26")),
)
"""Label, folder, fitted, held out."""


@dataclass(frozen=True, slots=True)
class Spectra:
    """Of one axis of a flight, tapered."""

    hz: Array
    acceleration: Complex
    torque: Complex
    velocity: Complex
    """In the sign of ``velocity_moment``: v on roll, -u on pitch."""


@dataclass(frozen=True, slots=True)
class Slow:
    """gains: (2,) of torque and velocity. share: (bands,) of the missing moment's power on the
    held-out flights that the velocity's moment explains."""

    gains: Array
    delay_s: float
    lead_s: float
    share: Array


def slow_component(fitted: Sequence[Spectra], held: Sequence[Spectra]) -> Slow:
    """Fit on some flights, judge by bands on others."""
    best: tuple[float, Array, float, float] | None = None
    for delay in DELAYS_S:
        for lead in LEADS_S:
            level, gains = _fit(fitted, delay, lead)
            if best is None or level < best[0]:
                best = level, gains, delay, lead
    assert best is not None
    _, gains, delay, lead = best
    missing, left = np.zeros((2, len(BANDS_HZ) - 1))
    for one in held:
        _, before, after = np.abs(moments(one, gains, delay, lead)) ** 2
        for number, (low, high) in enumerate(itertools.pairwise(BANDS_HZ)):
            band = (one.hz >= low) & (one.hz < high)
            missing[number] += before[band].sum()
            left[number] += after[band].sum()
    return Slow(gains, delay, lead, 1.0 - left / missing)


def moments(one: Spectra, gains: Array, delay: float, lead: float) -> Complex:
    """(3, bins): the torque's acceleration, what is missing, left of it after the velocity's."""
    made = gains[0] * one.torque * _shape(one.hz, delay, lead)
    missing = one.acceleration - made
    return np.stack([made, missing, missing - gains[1] * one.velocity])


def table(data: Path) -> Iterator[str]:
    """A row per craft and axis: gain, and the share explained by band."""
    heads = [f"{low:g}..{high:g} Hz" for low, high in itertools.pairwise(BANDS_HZ)]
    yield ""
    yield f"| flights | axis | velocity_moment, rad/s^2 per m/s | {' | '.join(heads)} |"
    yield "|---" * (3 + len(heads)) + "|"
    for label, folder, fitted, held in CASES:
        if not (data / folder).is_dir():
            continue
        for axis in ("roll", "pitch"):
            parts = [
                [read_spectra(data / folder / name, axis) for name in names]
                for names in (fitted, held)
            ]
            found = slow_component(*parts)
            shares = " | ".join(f"{100 * one:.0f} %" for one in found.share)
            yield f"| {label} | {axis} | {found.gains[1]:.1f} | {shares} |"


def picture(data: Path) -> bytes:
    """Root mean square by frequency on held-out flights of the brushless and the brushed craft."""
    made, axes = figure(9.0, 6.0, 2, 2, sharex=True)
    shown = [(case, axis) for case in (CASES[0], CASES[2]) for axis in ("roll", "pitch")]
    for panel, ((label, folder, fitted, held), axis) in zip(axes, shown, strict=True):
        parts = [read_spectra(data / folder / name, axis) for name in fitted]
        found = slow_component(parts, parts[:1])
        one = read_spectra(data / folder / held[0], axis)
        lines = moments(one, found.gains, found.delay_s, found.lead_s)
        names = ("torque of the rotors", "missing moment", "left after velocity_moment")
        drawn = [("angular acceleration", one.acceleration), *zip(names, lines, strict=True)]
        band = (one.hz >= FITTED_HZ[0]) & (one.hz <= FITTED_HZ[1])
        for (name, values), colour in zip(drawn, (MEASURED, NEUTRAL, BAD, GOOD), strict=True):
            level = np.convolve(np.abs(values) ** 2, np.ones(3) / 3, "same")
            panel.loglog(one.hz[band], np.sqrt(level[band]), color=colour, label=name)
        panel.set_title(f"{label.removesuffix(' a')}, {axis}")
        panel.set_ylabel("rad/s², spectrum")
    for panel in axes[2:]:
        panel.set_xlabel("Hz")
    axes[1].legend(loc="upper right")
    return png(made)


def read_spectra(path: Path, axis: str) -> Spectra:
    """A microSD log with measured rotor speeds and the state estimate's velocity."""
    recording = open_recording(path)
    samples, state = recording.samples, recording.tables["fixedFrequency"].columns
    time, period = samples.time_s, float(np.median(np.diff(samples.time_s)))
    rows = np.flatnonzero((samples.duty > FLYING_DUTY).all(axis=1))
    grid = np.arange(time[rows[0]], time[rows[-1]], period)

    def even(values: NDArray[np.generic]) -> Array:
        return np.asarray(np.interp(grid, time, values.astype(np.float64)))

    attitude = np.column_stack([even(np.unwrap(one)) for one in samples.attitude.T])
    world = np.column_stack([even(state[f"stateEstimate.v{a}"]) for a in "xyz"])
    forward, left, _ = np.einsum("nji,nj->in", rotation_matrix(attitude), world)
    gyro = np.column_stack([even(one) for one in samples.gyro.T])
    square = np.column_stack([even(one) for one in samples.rotor_rev_s.T]) ** 2
    number = AXES.index(axis)
    hz = np.fft.rfftfreq(len(grid), period)
    window = np.hanning(len(grid))

    def spectrum(values: Array) -> Complex:
        return np.asarray(np.fft.rfft((values - values.mean()) * window) / np.sqrt(len(grid)))

    return Spectra(
        hz,
        2j * np.pi * hz * spectrum(gyro[:, number]),
        spectrum(square @ MIXER_X[axis]),
        spectrum(left if axis == "roll" else -forward),
    )


def smoothed(power: Array, hz: Array) -> Array:
    """Moving mean over ``SMOOTHED_HZ``, (bins,)."""
    half = max(1, round(SMOOTHED_HZ / 2 / float(hz[1] - hz[0])))
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    return np.asarray(np.convolve(np.pad(power, half, mode="reflect"), kernel, "valid"))


def _shape(hz: Array, delay: float, lead: float) -> Complex:
    turn = 2j * np.pi * hz
    return np.asarray(np.exp(-turn * delay) * (1 + turn * lead))


def _fit(flights: Sequence[Spectra], delay: float, lead: float) -> tuple[float, Array]:
    """Whittle: sum of the log spectrum of what is left, and the gains (2,)."""
    parts = []
    for one in flights:
        columns = np.stack([one.torque * _shape(one.hz, delay, lead), one.velocity])
        parts.append((one, columns, (one.hz >= FITTED_HZ[0]) & (one.hz <= FITTED_HZ[1])))
    noise = [np.ones(len(one.hz)) for one, _, _ in parts]
    gains = np.zeros(2)
    for _ in range(ROUNDS):
        matrix, right = np.zeros((2, 2)), np.zeros(2)
        for (one, columns, band), level in zip(parts, noise, strict=True):
            weighted = columns[:, band].conj() / level[band]
            matrix += (weighted @ columns[:, band].T).real
            right += (weighted @ one.acceleration[band]).real
        gains = np.linalg.solve(matrix, right)
        noise = [
            smoothed(np.abs(one.acceleration - gains @ columns) ** 2, one.hz)
            for one, columns, _ in parts
        ]
    total = sum(
        float(np.log(level[band]).sum()) for (_, _, band), level in zip(parts, noise, strict=True)
    )
    return total, gains
