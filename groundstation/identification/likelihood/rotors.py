"""Rotor speeds behind a flight: measured, or simulated with the effects of supply and motors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from groundstation.dynamics.craft import add_effects
from groundstation.dynamics.effect import Craft, Supply
from groundstation.dynamics.model import rotor_motors
from groundstation.dynamics.simulation import steady_rev_s
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.frame import Frame
from groundstation.identification.likelihood.laws import Acting, in_order
from groundstation.identification.likelihood.parameters import SENSOR_LAG, value
from groundstation.identification.runs import Run
from groundstation.identification.torque import squares_between
from groundstation.telemetry.arrays import Array

SUBSTEPS = 1
FASTEST_REV_S = 2000.0
"""What a search tries need not be a motor: it must stay a number."""
SMALL_MV = 1e-3
"""Step of a difference: far below what a law limits."""
KNOT_S = 10.0
"""The cell's own voltage is straight over so long."""


@dataclass(slots=True)
class Rotors:
    """end: (n, 4) rev/s at the rows. square: (n, 4) mean square over the period before. halves: the
    same (2 n, 4) of half periods, where rows tell two settings."""

    end: Array
    square: Array
    halves: Rotors | None = None


def spin_rotors(flight: Flight, point: Mapping[str, float], frame: Frame) -> Rotors:
    """Rotor speeds of a flight at a point."""
    run, record = flight.run, frame.record(point)
    if flight.rotors is not None:
        rotors = Rotors(np.sqrt(flight.rotors.end), flight.rotors.square)
        lag = value(point, SENSOR_LAG)
        return rotors if lag == 0.0 else _before_sensor(rotors, lag, run.period_s)
    there = list(frame.acting(point).values())
    settings = run.settings
    supply = np.repeat(1000.0 * run.supply_v, len(settings) // len(run))
    start = steady_rev_s(rotor_motors(frame.model(point)), run.duty[0] * supply[0])
    craft = frame.craft(point)
    keeps = {one: _keep(one, craft, supply[0], run.period_s) for one in in_order(there, "supply")}
    prompt = [one for one, keep in keeps.items() if keep == 0.0]
    acting = [*prompt, *in_order(there, "motor")]
    add_effects(record, [(one.effect, one.named) for one in acting])
    for keep in (keep for keep in keeps.values() if keep != 0.0):
        turned = _run(run, settings, record, supply, start)
        back = (settings * (turned.halves or turned).end) @ record["back_emf_mv"]
        supply = supply + _behind(flight, settings, supply, back, keep)
    return _run(run, settings, record, supply, start)


def _before_sensor(rotors: Rotors, lag_s: float, period_s: float) -> Rotors:
    """True speeds behind a sensor that lags by the first order."""
    end = np.maximum(rotors.end + lag_s * np.gradient(rotors.end, period_s, axis=0), 0.0)
    return Rotors(end, squares_between(end).square)


def _run(run: Run, settings: Array, record: np.void, supply: Array, start: Array) -> Rotors:
    """settings: (m, 4); supply: (m,) mV under each."""
    from groundstation.dynamics.kernels import run_motors

    each = len(settings) // len(run)
    behind = supply[each:]
    voltage = np.ascontiguousarray(settings[each:] * behind[:, None])
    speed, square = np.empty((len(voltage) + 1, 4)), np.empty_like(voltage)
    run_motors(record, voltage, behind, run.period_s / each, SUBSTEPS, start, speed, square)
    before = np.tile(start, (each, 1))
    end, mean = np.vstack([before[1:], speed]), np.vstack([before**2, square])
    np.clip(np.nan_to_num(end, copy=False), 0.0, FASTEST_REV_S, out=end)
    np.clip(np.nan_to_num(mean, copy=False), 0.0, FASTEST_REV_S**2, out=mean)
    if each == 1:
        return Rotors(end, mean)
    rows = mean.reshape(-1, each, 4).mean(axis=1)
    return Rotors(end[each - 1 :: each].copy(), rows, Rotors(end, mean))


def _keep(one: Acting, craft: Craft, supply_mv: float, period_s: float) -> float:
    """k of a report r that remembers, r_i = k r_(i-1) + (1 - k) v: 0 where it does not.

    The law gives the voltage v behind the report, so k is in its slopes.
    """
    still = (0.0, 0.0, 0.0, 0.0)

    def behind(now: float, before: float) -> float:
        given = Supply(now, before, period_s, still, still)
        return float(one.effect.law(one.values, craft, given, now))

    near = supply_mv + SMALL_MV
    nothing = behind(supply_mv, supply_mv)
    return (nothing - behind(supply_mv, near)) / (behind(near, supply_mv) - nothing)


def _behind(flight: Flight, settings: Array, reported: Array, back: Array, keep: float) -> Array:
    """Real less reported voltage (m,) mV, under each setting, of a report that remembers the share
    ``keep`` of itself from row to row. settings: (m, 4); back: (m,) mV, what the rotors' speeds
    induce, each weighed by its setting.

    The reading itself cannot be differentiated: its steps of a millivolt would be amplified. The
    cell can be modelled: E(t) - A sum d^2 V + B sum d n, lagged, is fitted to the report, which
    is what ``identification/motor/supply.py`` does on a bench; E is linear between knots. A row
    that tells two settings holds what was read under the second.
    """
    from groundstation.identification.likelihood.kernels import first_order

    run, count = flight.run, len(reported)
    each = count // len(run)
    read = slice(each - 1, None, each)
    load = (settings**2).sum(axis=1) * reported
    knots = np.linspace(0, count - 1, max(2, round(len(run) * run.period_s / KNOT_S)) + 1)
    hats = np.maximum(0.0, 1.0 - np.abs(np.arange(count)[:, None] - knots) / (knots[1] - knots[0]))
    plain = np.column_stack([hats, -load, back])
    lagged = np.empty_like(plain)
    first_order(np.ascontiguousarray(plain), keep ** (1.0 / each), lagged)
    first = each * min(flight.first, len(run) // 4)
    used, told = lagged[first:][read], reported[first:][read]
    normal = used.T @ used
    scale = np.sqrt(np.diag(normal)) + 1e-12
    scaled = normal / np.outer(scale, scale), used.T @ told / scale
    weights = np.linalg.lstsq(*scaled, rcond=1e-10)[0] / scale
    return (plain - np.repeat(lagged[read], each, axis=0)) @ weights
