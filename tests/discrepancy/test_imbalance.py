"""A propeller out of balance is named with its rotor and its size, and no balanced one is."""

import math
from dataclasses import replace

import numpy as np
import pytest

from groundstation.comparison.comparison import compare
from groundstation.discrepancy.acceptance import LEAST_T, SHAKEN, refusal
from groundstation.discrepancy.disturbances import shaken_most, windows_of, with_imbalance
from groundstation.discrepancy.engine import find_effects
from groundstation.discrepancy.proof import FittedRows, Reason, Verdict
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import Frame, point_of, spin_rotors
from groundstation.identification.likelihood.problem import Problem
from support.flights import base_model
from support.flights import searched as flights

FRAME = Frame(load_vehicle("crazyflie1"))
POINT = point_of(base_model())
TORQUE = 5e-5
COUPLE_G_MM2 = 1e9 * TORQUE / (2.0 * math.pi * 250.0) ** 2


def windows(runs, every=1):
    """Flights in windows, of which only each so many-th row was recorded."""
    found = []
    for flight in prepare(runs):
        speed = spin_rotors(flight, POINT, FRAME).end
        if every > 1:
            run = flight.run
            parts = {
                name: getattr(run, name)[::every]
                for name in ("gyro", "accelerometer", "attitude", "duty", "supply_v")
            }
            thinner = replace(run, period_s=every * run.period_s, **parts)
            known, speed = flight.known[::every], speed[::every]
            first, last = flight.first // every, flight.last // every
            flight = replace(flight, run=thinner, known=known, first=first, last=last)
        found.append(windows_of(flight, speed, FRAME.craft(POINT), (0.0, 0.0)))
    return found


def most(seed, effects=None, **more):
    runs, _ = flights(seed, effects, span_s=40.0, **more)
    return shaken_most(windows(runs))


def told(shaken):
    return {name: one.value for name, one in shaken.parameters.items()}


def test_balanced_propellers_show_nothing():
    assert most(31).t < LEAST_T


def test_four_that_shake_alike_are_not_blamed_on_one():
    """Those of the faithful plant, whose worst has 1.2 times the mean's."""
    shaken = most(34, plant="faithful")
    assert shaken.alone < LEAST_T


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_the_rotor_is_the_one_and_both_sizes_are_right(rotor):
    hidden = {"rotor": float(rotor), "imbalance_g_mm": 0.02, "couple_g_mm2": 0.15}
    shaken = most(35 + rotor, {"propeller_imbalance": hidden})
    assert told(shaken) == pytest.approx(hidden, rel=0.06)
    assert shaken.alone > LEAST_T


def test_rows_half_as_fast_fold_it_elsewhere_and_tell_the_same():
    """At 250 rows a second a rotor of 250 rev/s is folded to nothing: what is faster is told."""
    hidden = {"rotor": 2.0, "imbalance_g_mm": 0.1, "couple_g_mm2": 1.0}
    runs, _ = flights(41, {"propeller_imbalance": hidden}, span_s=40.0)
    shaken = shaken_most(windows(runs, every=2))
    assert told(shaken)["rotor"] == 2.0
    assert told(shaken) == pytest.approx(hidden, rel=0.25)


def test_rows_too_slow_for_any_vibration_are_not_asked():
    runs, _ = flights(41)
    assert windows(runs, every=5) == [None, None]


@pytest.fixture(scope="module")
def bent():
    """A whole search on flights of a bent propeller: findings, and the judge of fitted samples."""
    effects = {"bent_propeller": {"rotor": 3.0, "torque_n_m": TORQUE}}
    runs, _ = flights(42, effects)
    judged = FittedRows(compare(runs, base_model()))
    return find_effects(runs, base_model(), judged=judged), judged, runs


def test_a_bent_propeller_is_named_and_nothing_else(bent):
    findings, *_ = bent
    assert findings.verdict is Verdict.EFFECTS_FOUND
    (found,) = findings.effects
    assert found.name == "propeller_imbalance"
    assert found.parameters["rotor"].value == 3.0
    couple = found.parameters["couple_g_mm2"]
    assert couple.value == pytest.approx(COUPLE_G_MM2, abs=4.0 * couple.stderr)
    assert {"gyro_x", "gyro_y"} <= set(found.channels)
    (candidate,) = [one for one in findings.candidates if one.name == found.name]
    assert candidate.accepted


def test_no_prediction_is_changed_by_what_nobody_can_foresee(bent):
    findings, judged, *_ = bent
    with_it, without = judged.judge(findings.model), judged.judge(findings.base)
    assert not with_it.worse
    assert with_it.gaps == pytest.approx(without.gaps, rel=1e-3)


def test_a_model_that_has_it_already_keeps_it(bent):
    findings, _, runs = bent
    problem = Problem(prepare(runs), base_model(), POINT)
    assert with_imbalance(findings, problem, POINT) is findings


def test_what_shakes_no_more_than_the_others_is_refused_with_the_rotor_that_does_most():
    shaken = most(36, {"propeller_imbalance": {"rotor": 1.0}})
    assert refusal(SHAKEN, shaken) is None
    refused = refusal(SHAKEN, replace(shaken, alone=2.0))
    assert refused.reason is Reason.NOT_ALONE
    assert "rotor 1" in refused.words
    assert np.isfinite(shaken.recordings).all()
