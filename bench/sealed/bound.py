"""The Cramer-Rao bound of every hidden size, from what really happened in the flights.

The generator's own rule for what a search may be asked to find: nothing of it comes from the
search. Written for this purpose in plain numpy, on the truth that the stand-in kept: along the
true trajectory each parameter changes three kinds of rows by a known signal,

- the step of each gyro axis (rad/s): torque over a pass, in white noise of the torque and in the
  difference of the gyro's noise,
- the step of each angle less the gyro's own (rad): differences of the angle's noise,
- each axis of the accelerometer (m/s^2),

and once per flight the mean vertical force, which is known where a flight begins and ends at
rest. Whitened by the noise spectrum of each row (from the plant's settings; the faithful plant's
vibration from a quiet flight), their inner products are the Fisher information of all parameters
together: the base model's four, the motor's three with the bench's covariance, and every effect
that is present. The size of an effect in standard errors is what its own columns keep after all
others have taken what they can explain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.sealed.hidden import UNBOUNDED
from bench.sealed.signals import DT, Array, Columns, G, Signals, base_signals, effect_signals
from firmware_sim.physics import parameters, present_effects
from firmware_sim.settings import StandInSettings

VERTICAL_M_S2 = 2e-3
"""How well a flight's mean vertical force is known."""
ALWAYS = 1e3
"""Significance given to what is there or not there, far above every limit."""


def significances(
    settings: StandInSettings,
    flights: Sequence[NDArray[np.void]],
    motor_covariance: Array | None = None,
) -> dict[str, float]:
    """Size of every present effect in standard errors of the Cramer-Rao bound; 0 where no column
    shows it, so that no search is asked for it.

    settings: of the craft that flew. flights: the truth of each, row by row, 500 rows a second
    heard without loss; slower telemetry tells less. motor_covariance: (3, 3) of the bench's a0,
    a1, a2; None: 1e-3 of each.
    """
    present = present_effects(settings)
    names = [name for name in present if name not in ("attitude_filter_lean", *UNBOUNDED)]
    p = parameters(settings)[0]
    total: Array | None = None
    labels: list[str] = []
    for truth in flights:
        rows = len(truth)
        history = Signals(p, truth)
        signals = {
            **base_signals(history),
            **{
                f"{n}.{k}": s
                for n in names
                for k, s in effect_signals(history, n, present[n]).items()
            },
        }
        labels = list(signals)
        information = _information(history, list(signals.values()), _spectra(settings, rows - 1))
        total = information if total is None else total + information
    assert total is not None
    total = total + _bench(labels, p, motor_covariance)
    found = {name: _significance(total, labels, name) for name in names}
    if "attitude_filter_lean" in present:
        found["attitude_filter_lean"] = ALWAYS
    return found | {name: 0.0 for name in UNBOUNDED if name in present}


def _information(h: Signals, signals: list[Columns], spectra: dict[str, Array]) -> Array:
    """Fisher information (p, p) of the signals in one flight."""
    flying = (h.flying[1:] & h.flying[:-1]).astype(float)[:, None]
    total = np.zeros((len(signals), len(signals)))
    rows = len(flying)
    for kind in ("rate", "angle", "force"):
        step = DT if kind == "rate" else 1.0
        for axis in range(3):
            table = np.zeros((len(signals), rows))
            for place, signal in enumerate(signals):
                if kind in signal:
                    one = signal[kind][:, axis]
                    mean = 0.5 * (one[1:] + one[:-1]) if kind == "rate" else one[1:]
                    table[place] = step * mean * flying[:, 0]
            if not table.any():
                continue
            waves = np.fft.rfft(table, axis=1)
            weight = np.full(waves.shape[1], 2.0)
            weight[0] = 1.0
            weighted = waves * (weight / (rows * spectra[kind][axis]))
            total += (weighted @ waves.conj().T).real
    vertical = np.zeros(len(signals))
    up = h.turn[1:, 2, :]
    for place, signal in enumerate(signals):
        if "force" in signal and "felt" not in signal:
            vertical[place] = np.mean((signal["force"][1:] * up).sum(axis=1) * flying[:, 0])
    return np.asarray(total + np.outer(vertical, vertical) / VERTICAL_M_S2**2)


def _spectra(settings: StandInSettings, rows: int) -> dict[str, Array]:
    """Variance per row of each kind and axis at the frequencies of ``rows`` rows, (3, m)."""
    p = parameters(settings)[0]
    frequency: Array = np.fft.rfftfreq(rows).astype(np.float64)
    difference = 2.0 - 2.0 * np.cos(2 * math.pi * frequency)
    mean = 0.5 + 0.5 * np.cos(2 * math.pi * frequency)
    gyro_lsb = math.radians(1 / 16.384)
    gyro = np.full((3, len(frequency)), p["gyro_noise"] ** 2 + gyro_lsb**2 / 12)
    lsb = math.radians(0.01)
    # fresh every second row: at the full rate that is worth twice the variance
    angle = 2.0 * (p["angle_noise"] ** 2 + lsb**2 / 12)
    force = np.full((3, len(frequency)), p["accel_noise"] ** 2 + (G / 4096) ** 2 / 12)
    force += p["force_noise"] ** 2
    if np.any(p["shake"]):
        gyro, force = (
            gyro + _shaken(settings, "gyro", frequency),
            force + _shaken(settings, "accelerometer", frequency),
        )
    torque = (p["torque_noise"][:, None] * DT) ** 2
    return {
        "rate": torque + difference * gyro,
        "angle": difference * angle + DT**2 * mean * gyro,
        "force": force,
    }


def _shaken(settings: StandInSettings, channel: str, frequency: Array) -> Array:
    """Spectrum (3, m) of the vibration that reaches a sensor, by flying without other noise."""
    import msgspec
    from scipy.signal import welch

    from firmware_sim.craft import StandIn
    from groundstation.telemetry.decoder import decode_all
    from groundstation.telemetry.samples import RawBatch

    still = msgspec.structs.replace(
        settings,
        sensor_noise=0.0,
        torque_noise=0.0,
        truth=True,
        effects={},
        program="hover",
        loss=msgspec.structs.replace(settings.loss, good_loss=0.0),
    )
    craft = StandIn(still)
    packets, heard_s = craft.advance(20.0)
    samples, _ = decode_all(RawBatch(packets, np.rint(heard_s * 1e9).astype(np.int64)))
    measured = getattr(samples, channel)[6000:].astype(np.float64)
    bins, density = welch(measured, nperseg=1024, axis=0, detrend="linear")
    return np.stack([np.interp(frequency, bins, density[:, i] / 2) for i in range(3)])


def _bench(labels: list[str], p: Any, covariance: Array | None) -> Array:
    """What the motor bench knows: information of a0, a1, a2 in shares of their values."""
    scale = np.array([np.mean(p[name]) for name in ("a0", "a1", "a2")])  # of the four rotors
    if covariance is None:
        covariance = np.diag((1e-3 * scale) ** 2)
    relative = covariance / np.outer(scale, scale)
    total = np.zeros((len(labels), len(labels)))
    rows = [labels.index(name) for name in ("a0", "a1", "a2")]
    total[np.ix_(rows, rows)] = np.linalg.inv(relative)
    return total


def _significance(information: Array, labels: list[str], name: str) -> float:
    """Size of an effect at its true value, all other parameters unknown."""
    own = [i for i, label in enumerate(labels) if label.split(".")[0] == name]
    rest = [i for i in range(len(labels)) if i not in own]
    scale = np.sqrt(np.maximum(np.diag(information), 1e-30))
    unit = information / np.outer(scale, scale)
    cross = unit[np.ix_(rest, own)]
    left = unit[np.ix_(own, own)] - cross.T @ np.linalg.pinv(unit[np.ix_(rest, rest)]) @ cross
    size = scale[own]  # every signal is taken at its true value: all parameters are 1
    return float(math.sqrt(max(size @ left @ size, 0.0)))
