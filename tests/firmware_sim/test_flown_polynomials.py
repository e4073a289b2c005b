"""The stand-in turns by the ARX polynomials of a model, with their delay."""

import msgspec
import numpy as np
import pytest

from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.present import present_effects
from groundstation.comparison.gap import ahead_errors, pooled_rms
from groundstation.dynamics.model import ArxAxis, EffectTerm, Estimate, save_model, vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError
from groundstation.identification.arx.data import arx_data
from groundstation.identification.arx.fit import Criterion, search_arx
from groundstation.identification.recordings import flights_of
from groundstation.identification.runs import runs_of
from support.flights import CARRYING_GAINS, recorded

BODY = vehicle_model(load_vehicle("crazyflie1"))
DELAY, GAIN = 3, 0.7
"""Rows late, and less agile than the body: what flies is not the body."""


def polynomials(kind, c):
    """A free body of acceleration c u', its rate damped at 2/s, as rates or as angles."""
    ts, damped = 0.002, 0.996
    if kind == "gyro":
        return ArxAxis(1, 1, DELAY, (-damped,), (c * ts,), ts)
    return ArxAxis(2, 1, DELAY, (-1.0 - damped, damped), (c * ts * ts,), ts)


def model_of(kind, **more):
    c0, c1, c2 = (GAIN * one for one in (BODY.body.c0, BODY.body.c1, BODY.body.c2))
    arx = {"roll": polynomials(kind, c0), "pitch": polynomials(kind, c1)}
    arx["yaw"] = polynomials(kind, c2)
    fit = {"arx": {"channel": kind}}
    return msgspec.structs.replace(BODY, arx=arx, fit=fit, **more)


@pytest.fixture(scope="module", params=["gyro", "attitude"])
def flown(request, tmp_path_factory):
    """(kind, path of the model, samples of its flight)"""
    path = tmp_path_factory.mktemp("flown") / "arx.json"
    save_model(model_of(request.param), path)
    settings = {"plant": "model", "craft": str(path), "gains": CARRYING_GAINS, "seed": 3}
    samples, truth = recorded(25.0, **settings)
    assert truth["position_m"][:, 2].max() > 0.7
    return request.param, path, samples


def test_what_flies_is_found_again_with_its_delay(flown):
    kind, _, samples = flown
    run = runs_of(samples, "flight")[0][3000:]
    found = arx_data(run, "roll", BODY.motor, channel="gyro")
    orders = (range(1, 2), range(1, 2), range(9))
    best = search_arx([found], [found], *orders, criterion=Criterion.PREDICTION).chosen.axis
    assert best.nk in (DELAY, DELAY + 1)
    assert best.b[0] == pytest.approx(GAIN * BODY.body.c0 * 0.002, rel=0.05), kind


@pytest.mark.parametrize("flown", ["gyro"], indirect=True)
def test_prediction_by_the_same_polynomials_is_better_than_by_the_body(flown):
    """Rates: from angles that are held for two rows no free run begins well."""
    kind, _, samples = flown
    (run,) = flights_of(samples, "flight")
    by_arx, by_body = (
        pooled_rms(ahead_errors(run, model_of(kind), turning=one).horizons)[:3]
        for one in ("arx", "body")
    )
    assert (by_arx < 0.5 * by_body).all()


def test_what_turns_or_delays_the_craft_is_in_the_polynomials_already(tmp_path):
    late = EffectTerm("dead_time", {"delay_s": Estimate(0.004)})
    sag = EffectTerm("supply_sag", {"resistance_ohm": Estimate(0.1)})
    path = tmp_path / "arx.json"
    save_model(model_of("attitude", effects=(late, sag)), path)
    for plant in ("model", "faithful"):
        found = present_effects(StandInSettings(plant=plant, craft=str(path)))
        assert set(found) - {"battery_reading_lag"} == {"supply_sag"}
    told = StandIn(StandInSettings(plant="model", craft=str(path))).added_by_plant
    assert told.startswith("the craft turns by its ARX polynomials (roll ARX(2,1,3), ")
    body = StandInSettings(plant="model", craft=str(path), attitude="body")
    assert "dead_time" in present_effects(body)


def test_polynomials_of_a_decimated_fit_are_stepped_with_the_loop(tmp_path):
    """What adds up every row, and the same as it adds up means of four rows."""
    every_row, fourth = {}, {}
    for axis, one in model_of("gyro").arx.items():
        every_row[axis] = msgspec.structs.replace(one, nk=4)
        b = (4 * 0.625 * one.b[0], 4 * 0.375 * one.b[0])
        fourth[axis] = ArxAxis(1, 2, 1, (-((-one.a[0]) ** 4),), b, 4 * one.ts)
    rolls = []
    for name, arx in (("row", every_row), ("fourth", fourth)):
        path = tmp_path / f"{name}.json"
        save_model(msgspec.structs.replace(model_of("gyro"), arx=arx), path)
        settings = {"plant": "model", "craft": str(path), "gains": CARRYING_GAINS, "seed": 3}
        samples, _ = recorded(12.0, **settings)
        rolls.append(np.degrees(samples.attitude[-3000:, 0]))
    assert rolls[0].std() > 0.5
    assert (rolls[0] - rolls[1]).std() < 0.1 * rolls[0].std()


def test_polynomials_that_the_loop_cannot_step_are_refused(tmp_path):
    model = model_of("gyro")
    odd = {axis: msgspec.structs.replace(one, ts=0.003) for axis, one in model.arx.items()}
    path = tmp_path / "odd.json"
    save_model(msgspec.structs.replace(model, arx=odd), path)
    with pytest.raises(BadInputError, match="a step every 3 ms, the craft's loop every 2 ms"):
        StandIn(StandInSettings(craft=str(path)))
