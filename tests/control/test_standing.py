"""A craft that takes off must stand still, level and on the floor."""

import pytest

from groundstation.control.programme import STAND_S, Standing, trouble_of


def answer(height_m=0.01, **changes):
    said = {"gyro_dps": [0.4, -0.6, 0.1], "roll_deg": 1.0, "pitch_deg": -2.0, "age_s": 0.01}
    said |= changes
    return {"telemetry": said, "height_m": height_m}


@pytest.mark.parametrize(
    ("changes", "trouble"),
    [
        ({}, ""),
        ({"height_m": None}, ""),
        ({"gyro_dps": [0.0, 0.0, 6.0]}, "it moves (6 deg/s"),
        ({"gyro_dps": [0.0, None, 0.0]}, "it moves"),
        ({"gyro_dps": [0.0, 0.0, float("nan")]}, "it moves"),
        ({"roll_deg": -12.0}, "it is tilted by 12 deg"),
        ({"pitch_deg": float("nan")}, "it is tilted"),
        ({"age_s": 9.0}, "it says nothing"),
        ({"age_s": float("nan")}, "it says nothing"),
        ({"height_m": 0.8}, "it is 0.80 m above the floor"),
    ],
)
def test_what_moves_leans_or_is_not_on_the_floor_does_not_stand(changes, trouble):
    assert trouble_of(answer(**changes)).startswith(trouble)
    assert bool(trouble_of(answer(**changes))) == bool(trouble)


def test_a_craft_that_says_what_keeps_it_from_flying_is_not_ready():
    said = "the craft is not armed"
    assert trouble_of({**answer(), "hindrance": said}) == said
    assert trouble_of({**answer(), "hindrance": ""}) == ""


def test_it_must_have_stood_for_three_seconds_without_a_break():
    """Held in a hand it is still for a moment at most."""
    standing = Standing()
    stood = []
    for tick in range(100):
        time_s = 0.1 * tick
        rocks = tick == 40
        turned = answer(gyro_dps=[77.0, 0.0, 0.0]) if rocks else answer()
        stood.append(standing.look(time_s, turned))
        assert bool(standing.trouble) == rocks
    assert stood.index(True) == round(10 * STAND_S)
    assert not any(stood[40:71])
    assert all(stood[71:])
