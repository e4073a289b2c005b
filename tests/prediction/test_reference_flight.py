"""Made inputs: a model along a reference reports what its sensors would show."""

import numpy as np
import pytest

from groundstation.dynamics.simulation import RATE, attitude_of
from groundstation.errors import BadInputError
from groundstation.prediction.prediction import BUILT_IN, fly_reference, load_reference
from support.flights import BASE, MEDIUM, affected

HEAD = "time_s,roll_deg,pitch_deg,yaw_deg"


def short(tmp_path, rows="0,0,0,0\n0.2,0,0,0\n0.2,10,0,0\n0.8,10,-5,20\n", head=HEAD):
    path = tmp_path / "wanted.csv"
    path.write_text(f"{head}\n{rows}")
    return load_reference(path)


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_craft_follows_a_built_in_programme(name):
    reference = load_reference(name)
    made = fly_reference(BASE, reference)
    angle = attitude_of(made.states)
    error = np.degrees(np.abs(reference.attitude - angle))
    # At the end of each rest it is where it should be.
    third = len(reference) // 3
    assert error[third - 10 :: third].max() < 0.6
    if name != "hover":
        assert np.degrees(angle.max(axis=0)) == pytest.approx(9.5, abs=2.0)
    assert np.abs(made.states[:, 2] - 1.0).max() < 0.05


def test_without_effects_it_reports_the_truth(tmp_path):
    made = fly_reference(BASE, short(tmp_path))
    np.testing.assert_allclose(made.gyro[1:], made.states[1:, RATE], atol=1e-8)
    fresh = np.arange(2, len(made.gyro), 2)
    np.testing.assert_allclose(made.attitude[fresh], attitude_of(made.states)[fresh], atol=1e-8)
    np.testing.assert_array_equal(made.attitude[fresh + 1 - 2], made.attitude[fresh - 2])
    assert np.abs(made.accelerometer[:, :2]).max() < 1e-12


@pytest.mark.parametrize("name", MEDIUM)
def test_it_flies_with_every_effect(tmp_path, name):
    reference = short(tmp_path)
    made = fly_reference(affected(name), reference)
    tilt = np.degrees(np.abs(attitude_of(made.states)[:, :2] - reference.attitude[:, :2]))
    assert tilt.max() < 35.0
    assert np.isfinite(made.gyro).all()
    assert np.isfinite(made.attitude).all()


def test_dead_time_makes_the_report_late(tmp_path):
    made = fly_reference(affected("dead_time", {"delay_s": 0.006}), short(tmp_path))
    np.testing.assert_allclose(made.gyro[4:], made.states[1:-3, RATE], atol=1e-6)


def test_a_file_may_ask_for_heights(tmp_path):
    rows = "0,0,0,0,1\n0.5,0,0,0,1\n2,0,0,0,1.5\n4,0,0,0,1.5\n"
    made = fly_reference(BASE, short(tmp_path, rows, f"{HEAD},height_m"))
    assert made.states[-1, 2] == pytest.approx(1.5, abs=0.02)


@pytest.mark.parametrize(
    ("head", "rows", "reason"),
    [
        ("time_s,roll_deg", "0,0\n1,0\n", "no column pitch_deg, yaw_deg"),
        (HEAD, "0,0,0,0\n", "two rows or more"),
        (HEAD, "0,0,0,0\n1,left,0,0\n", "line 3"),
        (HEAD, "0,0,0,0\n1,nan,0,0\n", "finite"),
        (HEAD, "1,0,0,0\n0,0,0,0\n", "ascending"),
        (HEAD, "0,0,0,0\n1,80,0,0\n", "a tilt of 80 deg"),
        (HEAD, "0,0,0,0\n1e6,0,0,0\n", "must last"),
    ],
)
def test_a_file_that_cannot_be_flown_is_refused(tmp_path, head, rows, reason):
    with pytest.raises(BadInputError, match=reason):
        short(tmp_path, rows, head)


def test_an_unknown_programme_is_refused_with_those_there_are():
    with pytest.raises(BadInputError, match="hover, step, doublet, sine"):
        load_reference("loop")


def test_a_supply_that_cannot_carry_the_craft_is_refused():
    with pytest.raises(BadInputError, match="give more voltage"):
        fly_reference(BASE, load_reference("hover"), 2.3)
