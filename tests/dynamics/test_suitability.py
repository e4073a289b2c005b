"""One judgement says what a model is good for: an axis is as good as the worst that is known."""

import msgspec
import pytest

from groundstation.control.design import require_certain
from groundstation.dynamics.meanings import Use, suitability, verdict
from groundstation.dynamics.model import THESIS, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.errors import BadInputError

VEHICLE = BUILT_IN["crazyflie21"]
PLAIN = vehicle_model(VEHICLE)


def fitted(c0=0.02, c1=0.02, c2=0.02, times=1.0, delay_s=None, **account):
    """A model whose constants are known to these shares, c2 so many times the profile's."""
    body = msgspec.structs.replace(PLAIN.body, c2=times * PLAIN.body.c2)
    names, shares = ["c0", "c1", "c2"], [c0, c1, c2]
    values = [body.c0, body.c1, body.c2]
    errors = [share * value for share, value in zip(shares, values, strict=True)]
    if delay_s is not None:
        names, values, errors = [*names, "dead_time.delay_s"], [*values, 0.01], [*errors, delay_s]
    covariance = [[e * e if i == j else 0.0 for j in range(len(names))]
                  for i, e in enumerate(errors)]  # fmt: skip
    found = {"names": names, "values": values, "stderr": errors, "covariance": covariance}
    fit = {"body": {"what": "body", "estimates": found, **account}}
    return msgspec.structs.replace(PLAIN, body=body, fit=fit)


def failing(channel):
    return {f"{channel} rate": {"cross_correlation": {"passes": False}}}


NOT_LATE = {"left_out": ["dead_time"], "fitted_along": {"dead_time.delay_s": {"value": 1e-3}}}
LATE = {"left_out": ["dead_time"], "fitted_along": {"dead_time.delay_s": {"value": 4e-3}}}
DOUBTS = [
    ({}, Use.DESIGN),
    (NOT_LATE, Use.DESIGN),
    ({"validation": {"gyro_yaw_fit_percent_20ms": 90.0}}, Use.DESIGN),
    ({"times": 2.0}, Use.DESIGN),
    (LATE, Use.FIRST_DESIGN),
    ({"c2": 0.12}, Use.FIRST_DESIGN),
    ({"times": 2.6}, Use.FIRST_DESIGN),
    ({"times": 0.39}, Use.FIRST_DESIGN),
    ({"residual_tests": failing("yaw")}, Use.FIRST_DESIGN),
    ({"crossed": ["yaw"]}, Use.FIRST_DESIGN),
    ({"contradictions": ["yaw turns against gyro_z"]}, Use.FIRST_DESIGN),
    ({"validation": {"gyro_yaw_fit_percent_50ms": -3.0}}, Use.FIRST_DESIGN),
    ({"validation": {"accelerometer_z_fit_percent": -3.0}}, Use.FIRST_DESIGN),
    ({"validation": {"gyro_yaw_fit_percent_20ms": -3.0}}, Use.SIMULATION),
    ({"c2": 0.2}, Use.SIMULATION),
    ({"c2": float("nan")}, Use.SIMULATION),
    ({"delay_s": 0.003}, Use.SIMULATION),
    ({"not_identified": {"c2": "yaw is hardly excited"}}, Use.NOTHING),
]


@pytest.mark.parametrize(("doubt", "use"), DOUBTS)
def test_each_doubt_lowers_what_yaw_is_good_for_and_a_design_keeps_to_it(doubt, use):
    model = fitted(**doubt)
    found = suitability(model)["yaw"]
    assert found.use == use
    assert bool(found.reasons) == (use != Use.DESIGN)
    if found.designs:
        require_certain(model, ["yaw"])
    else:
        with pytest.raises(BadInputError, match=r"yaw: the model is .*record"):
            require_certain(model, ["yaw"])


def test_the_gravest_reason_is_said_and_axes_with_the_same_are_said_together():
    said = verdict(suitability(fitted(c0=0.2, c1=0.2, times=3.0, residual_tests=failing("roll"))))
    assert said == (
        "Yaw: for a first, cautious design (c2 is 3 times the profile's); roll and pitch: for a"
        " rough simulation only (known to 20 % only)"
    )


def test_a_refusal_names_what_is_refused_and_how_to_design_the_rest():
    model = fitted(c0=0.3, record={"c2": "500 rows a second"}, not_identified={"c2": "rows fold"})
    with pytest.raises(BadInputError) as refusal:
        require_certain(model, ["roll", "pitch", "yaw"])
    said = str(refusal.value)
    assert "roll: the model is for a rough simulation only (c0: known to 30 % only)" in said
    assert "yaw: the model is not identified (c2: the file has the profile's c2)" in said
    assert "roll doublets" in said
    assert "500 rows a second" in said
    assert said.endswith("the rest can be designed: --axis pitch")


def test_a_constant_that_is_tied_to_another_is_as_good_as_that():
    model = fitted(c0=0.2)
    found = {k: v[::2] for k, v in model.fit["body"]["estimates"].items() if k != "covariance"}
    fit = {"body": {"what": "body", "estimates": found}}
    tied = suitability(msgspec.structs.replace(model, fit=fit))
    assert [one.use for one in tied.values()] == [Use.SIMULATION, Use.SIMULATION, Use.DESIGN]


@pytest.mark.parametrize("model", [PLAIN, THESIS])
def test_of_a_model_without_a_fit_nothing_is_known_and_nothing_refused(model):
    assert suitability(model) == {}
    require_certain(model, ["roll", "pitch", "yaw"])
