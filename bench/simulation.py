"""Flight with effects: long simulations, predictions ahead, and their error over the noise."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import msgspec
import numpy as np

from bench.table import Row
from bench.timing import best
from firmware_sim.craft import StandIn, StandInSettings
from groundstation.dynamics.craft import craft_of_model, craft_of_vehicle
from groundstation.dynamics.model import EffectTerm, Estimate, Model, vehicle_model
from groundstation.dynamics.reference import load_reference
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.simulation import simulate
from groundstation.dynamics.state import craft_state
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.runs import Run, runs_of
from groundstation.prediction.observer import gains_of
from groundstation.prediction.prediction import observe_run, predict_ahead
from groundstation.prediction.reference_flight import fly_reference
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch

VEHICLE = BUILT_IN["crazyflie1"]
BASE = vehicle_model(VEHICLE)
STEPS = 200_000
HORIZONS = (10, 25)
MANY = ("dead_time", "rotor_acceleration_torque", "inertia_coupling", "rotor_drag", "supply_sag")


def rows() -> Iterator[Row]:
    """What, measured, reference in the same run, unit."""
    voltage = np.full((STEPS, 4), 2400.0)
    start = craft_state(rates=(0.1, 0.2, 0.3), rotor_rev_s=250)
    plain = best(
        lambda: simulate(craft_of_vehicle(VEHICLE), start, voltage), 7, clock=time.process_time
    )
    many = craft_of_model(_with(*MANY))
    supply = np.full(STEPS, 3700.0)
    full = best(
        lambda: simulate(many, start, voltage, supply_mv=supply), 7, clock=time.process_time
    )
    yield Row("6-DOF with five effects (none)", STEPS / full / 1e6, STEPS / plain / 1e6, "M/s")
    run = _flight()
    for label, model in (("base model", BASE), ("five effects", _with(*MANY))):
        seen = best(partial(observe_run, model, run), 7, clock=time.process_time)
        yield Row(f"observer, {label}", run.seconds / seen, 1.0, "x real time")
        ahead = best(partial(predict_ahead, model, run, HORIZONS), 7, clock=time.process_time)
        yield Row(
            f"predictions 20 and 50 ms ahead, {label}", run.seconds / ahead, 1.0, "x real time"
        )
    error = predict_ahead(BASE, run, HORIZONS).errors(run)
    for k, horizon in enumerate(HORIZONS):
        rms = np.sqrt(np.mean(error[:, k] ** 2, axis=0))
        floor = gains_of(BASE, run.period_s).expected(horizon)
        yield Row(
            f"clean flight, {2 * horizon} ms: worst error over noise", max(rms / floor), 1.0, ""
        )
    reference = load_reference("doublet")
    taken = best(lambda: fly_reference(BASE, reference), 3, clock=time.process_time)
    yield Row("9 s along a reference (real time)", taken, 9.0, "s")


def _with(*names: str) -> Model:
    terms = tuple(
        EffectTerm(name, {p.name: Estimate(p.default) for p in EFFECTS[name].parameters})
        for name in names
    )
    return msgspec.structs.replace(BASE, effects=terms)


def _flight() -> Run:
    settings: dict[str, Any] = {"plant": "reduced", "seed": 1}
    packets, heard_s = StandIn(StandInSettings(**settings)).advance(60.0)
    samples, _ = decode_all(RawBatch(packets, np.rint(heard_s * 1e9).astype(np.int64)))
    (run,) = runs_of(samples)
    return run
