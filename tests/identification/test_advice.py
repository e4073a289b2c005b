"""A fit begins with what it is good for, what to do next and at most three warnings."""

import pytest

from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.report import advice_of, good_for, next_of

MODEL = vehicle_model(BUILT_IN["crazyflie21"])

FILES = {"recordings": [{"file": "a.mcap"}, {"file": "b.mcap"}], "held_out": [{"file": "c.mcap"}]}


def account(c0=0.02, c1=0.02, c2=0.02, **more):
    """A body fit whose constants are known to these shares."""
    names, shares = ["c0", "c1", "c2", "thrust_per_mass"], [c0, c1, c2, 0.001]
    estimates = {"names": names, "values": [1.0] * 4, "stderr": shares}
    return {"what": "body", "estimates": estimates, "rate_hz": 500.0, **FILES, **more}


def test_a_model_that_knows_every_axis_is_good_enough_to_design_with():
    said, kind = good_for(MODEL, account())
    assert said.startswith("Good enough to design roll, pitch and yaw with.")
    assert "roll to 2 %" in said
    assert kind == "good"
    assert "groundstation discrepancy" in next_of(account())
    assert advice_of(account(), []) == []


def test_an_axis_that_is_not_identified_is_said_with_what_to_fly():
    reason = {"c2": "yaw is hardly excited: 2e-05 +- 0.0002"}
    one = account(c2=9.0, not_identified=reason)
    said, kind = good_for(MODEL, one)
    assert "Good enough to design roll and pitch with; yaw: not identified" in said
    assert "yaw to" not in said
    assert kind == "neutral"
    assert next_of(one).startswith("fly yaw steps of 60 degrees both ways")
    (first,) = advice_of(one, [])
    assert first.what == "Yaw is not identified: yaw is hardly excited: 2e-05 +- 0.0002"
    assert first.fly.startswith("Fly yaw steps")


@pytest.mark.parametrize(
    ("share", "words"), [(0.12, "first, cautious design"), (0.5, "rough simulation only")]
)
def test_what_is_known_worse_is_good_for_less(share, words):
    said, _ = good_for(MODEL, account(c0=share, c1=share))
    assert f"oll and pitch: for a {words}" in said
    assert [one.what for one in advice_of(account(c0=share), [])] == [
        f"Roll is known to {100 * share:.0f} % only"
    ]


def test_what_no_manoeuvre_tells_is_to_be_recorded_otherwise():
    one = account(c2=1.0, not_identified={"c2": "rows fold"}, record={"c2": "500 rows a second"})
    assert next_of(one) == "record 500 rows a second, and fit both recordings together."
    assert advice_of(one, [])[0].fly == "Record 500 rows a second"


def test_what_shows_and_was_left_out_is_offered_as_the_next_command():
    one = account(left_out=["dead_time", "rotor_acceleration_torque"])
    assert next_of(one).endswith(
        "groundstation fit body a.mcap b.mcap --validate c.mcap -o NEW_FILE --with"
        " dead_time,rotor_acceleration_torque"
    )


def test_slow_samples_and_inputs_that_still_show_are_told():
    slow, left = advice_of(account(rate_hz=100.0), ["yaw rate"])
    assert slow.what == "100 samples a second show one in 5.0 of the motors' settings"
    assert left.what == "The input still shows in what is left of yaw rate"
