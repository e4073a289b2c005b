"""The firmware's loops on a craft that its ARX polynomials turn."""

import msgspec
import numpy as np
import pytest

from groundstation.control.evaluate import evaluate
from groundstation.control.firmware_loop import CascadeJudge, cascade_margins, step_response
from groundstation.control.pid import AXES
from groundstation.control.plant import plant_of_model
from groundstation.control.uncertainty import moved
from groundstation.dynamics.model import ArxAxis, EffectTerm, Estimate, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN

TS = 0.002
CALM = {
    f"{loop}.{axis}_{gain}": value
    for axis in ("roll", "pitch")
    for loop, gain, value in (
        ("pid_rate", "kp", 12.0),
        ("pid_attitude", "kp", 2.0),
        ("pid_attitude", "ki", 1.0),
    )
}


def body_that_is_late(rows, vehicle="crazyflie1"):
    base = vehicle_model(BUILT_IN[vehicle])
    term = EffectTerm("dead_time", {"delay_s": Estimate(rows * TS)})
    return base.__class__(vehicle=vehicle, motor=base.motor, body=base.body, effects=(term,))


def as_polynomials(body, rows, kind, every=1):
    """The body itself, c / s of a rate or c / s^2 of an angle, as polynomials of so many rows."""
    ts, found = every * TS, {}
    for axis, c in zip(AXES, (body.body.c0, body.body.c1, body.body.c2), strict=True):
        if kind == "gyro":
            first = 0.5 * (1.0 + 1.0 / every)  # of a mean over rows that add up
            a, b = (-1.0,), (c * ts * first, c * ts * (1.0 - first))
        else:
            a, b = (-2.0, 1.0), (0.5 * c * ts * ts,) * 2
        found[axis] = ArxAxis(len(a), 2, rows // every, a, b, ts)
    return msgspec.structs.replace(body, arx=found, fit={"arx": {"channel": kind}})


@pytest.mark.parametrize("vehicle", ["crazyflie1", "crazyflie21"])
@pytest.mark.parametrize(("rows", "every", "apart"), [(2, 1, 1e-3), (4, 4, 5e-3), (0, 4, 5e-3)])
def test_polynomials_of_the_body_s_rates_fly_as_the_late_body_does(vehicle, rows, every, apart):
    body = body_that_is_late(rows, vehicle)
    plants = [plant_of_model(one) for one in (body, as_polynomials(body, rows, "gyro", every))]
    gains = CALM if vehicle == "crazyflie1" else {}
    for axis in ("roll", "yaw"):
        by_body, by_arx = (step_response(plant, gains, axis) for plant in plants)
        assert np.abs(by_body).max() > 0.9
        assert np.abs(by_body - by_arx).max() < apart
        ours, theirs = (cascade_margins(plant, gains, axis) for plant in plants)
        assert ours.max_sensitivity == pytest.approx(theirs.max_sensitivity, rel=5 * apart)
        assert ours.delay_s == pytest.approx(theirs.delay_s, abs=1e-4)


@pytest.mark.parametrize("every", [1, 4])
def test_polynomials_of_angles_are_heard_without_another_filter(every):
    """Late by a row more, the slope over two; and without the filter's lean at low frequency."""
    arx = as_polynomials(body_that_is_late(4), 4, "attitude", every)
    body = plant_of_model(body_that_is_late(5), fusion=False)
    assert not plant_of_model(arx).fusion
    by_arx, by_body = (step_response(one, CALM, "roll") for one in (plant_of_model(arx), body))
    assert np.abs(by_arx - by_body).max() < 0.01


def test_the_loop_becomes_unstable_at_its_delay_margin():
    arx = as_polynomials(body_that_is_late(4), 4, "gyro")
    margin = cascade_margins(plant_of_model(arx), CALM, "roll").delay_s

    def calm(share):
        late = {
            axis: msgspec.structs.replace(one, nk=one.nk + round(share * margin / TS))
            for axis, one in arx.arx.items()
        }
        plant = plant_of_model(msgspec.structs.replace(arx, arx=late))
        swings = [
            np.ptp(one) for one in np.split(step_response(plant, CALM, "roll", 8.0)[1000:], 3)
        ]
        return swings[2] < swings[1]

    assert calm(0.85)
    assert not calm(1.15)


@pytest.mark.parametrize("pole", [-3.0, 3.0])
def test_an_unstable_pole_is_judged_for_what_it_is(pole):
    """Its loop must turn around -1 once: more gain holds it, little gain does not."""
    arx = as_polynomials(body_that_is_late(1), 1, "gyro")
    grown = {
        axis: msgspec.structs.replace(one, a=(-np.exp(pole * TS),)) for axis, one in arx.arx.items()
    }
    plant = plant_of_model(msgspec.structs.replace(arx, arx=grown))
    names = plant.firmware.gain_names("roll")
    judge = CascadeJudge([plant], "roll", 4.0)
    firm = {**plant.firmware.stock, **CALM}
    weak = {**firm, "pid_rate.roll_kp": 0.4}
    held, also = (
        bool(np.isfinite(judge(np.array([[g[n] for n in names]]))[0, 4])) for g in (firm, weak)
    )
    assert held
    assert also == (pole < 0.0)
    flown = step_response(plant, weak, "roll", 8.0)
    assert (np.abs(flown[-500:]).max() < 2.0) == (pole < 0.0)


def test_the_gain_of_polynomials_is_as_uncertain_as_the_body_s():
    arx = as_polynomials(body_that_is_late(2), 2, "gyro")
    more = moved(arx, {"c0": 0.1 * arx.body.c0})
    assert more.arx["roll"].b == pytest.approx([1.1 * b for b in arx.arx["roll"].b])
    assert more.arx["pitch"] == arx.arx["pitch"]


def test_either_can_be_asked_for():
    arx = as_polynomials(body_that_is_late(2), 2, "gyro")
    slow = {axis: msgspec.structs.replace(one, nk=12) for axis, one in arx.arx.items()}
    model = msgspec.structs.replace(arx, arx=slow)
    left = [
        evaluate(model, CALM, "firmware", turning=turning)[0].margins.delay_s
        for turning in ("body", "arx", None)
    ]
    assert left[0] - left[1] == pytest.approx(10 * TS, abs=1e-4)
    assert left[1] == left[2]
    assert plant_of_model(replace_given(model)).polynomials.turns == 0


def replace_given(model):
    """Polynomials that no fit made, as those of the thesis."""
    return msgspec.structs.replace(model, fit={})
