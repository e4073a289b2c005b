"""The software craft on its own clock is commanded as one behind the daemon."""

import numpy as np
import pytest

from groundstation.cli.learn_flights import CLIENT, Onlooker, Place
from groundstation.cli.pid_manoeuvres import fly_programme
from groundstation.errors import BadInputError
from groundstation.learn.manoeuvres import FlightPlan, Limits, library
from groundstation.links.software_craft import SoftwareCraft
from groundstation.recording.open_recording import open_recording

SETTINGS = '[stand_in]\nplant = "reduced"\ncraft = "{craft}"\n{more}'


def settings(tmp_path, craft="crazyflie21", more=""):
    path = tmp_path / "craft.toml"
    path.write_text(SETTINGS.format(craft=craft, more=more))
    return str(path)


def plan_of(*names):
    known = library(Limits())
    return FlightPlan(tuple(known[name] for name in names), "")


@pytest.mark.parametrize("craft", ["crazyflie1", "brushless"])
def test_it_flies_a_programme_stays_in_its_place_and_tells_what_was_commanded(tmp_path, craft):
    flying = SoftwareCraft(settings(tmp_path, craft), CLIENT, seed=1)
    flying.arm()
    sticks = Onlooker(flying, 0.5, places=True)
    plan = plan_of("roll doublets")
    assert fly_programme(flying, plan, sticks, tells_battery=True, clock=flying) == ""
    assert flying.stop() == "stopped"
    assert np.hypot(*flying.position_m[:2]) < 0.3
    flying.save(tmp_path / "flight.mcap")
    recording = open_recording(tmp_path / "flight.mcap")
    assert recording.metadata["vehicle"]["profile"] == craft
    leans = [entry["roll_deg"] for entry in recording.commands if entry["client"] == CLIENT]
    assert max(leans) > 8.0
    rolled = np.degrees(np.interp(
        [entry["time_ns"] + 200_000_000 for entry in recording.commands],
        recording.samples.host_time_ns, recording.samples.attitude[:, 0],
    ))  # fmt: skip
    assert np.corrcoef(leans, rolled)[0, 1] > 0.5  # in the signs of the telemetry
    assert [event["text"] for event in recording.events] == [
        "pid fly programme",
        "pid fly landing",
    ]


def test_a_craft_that_shakes_is_let_down_and_not_dropped(tmp_path):
    """Turning to and fro by hundreds of deg/s is how it flies, and not the ground."""
    shakes = """
    [stand_in.effects.motor_braking_asymmetry]
    factor = 0.6075
    [stand_in.effects.gyro_low_pass]
    bandwidth_hz = 16.0
    [stand_in.effects.attitude_filter_lean]
    strength = 1.0
    """
    flying = SoftwareCraft(settings(tmp_path, more=shakes), CLIENT, seed=1)
    flying.arm()
    sticks = Onlooker(flying, 0.5, places=True)
    plan = plan_of("hover")
    assert fly_programme(flying, plan, sticks, tells_battery=True, clock=flying) == ""
    assert flying.position_m[2] < 0.15


def test_a_flight_is_the_same_for_its_seed(tmp_path):
    place = Place("software:" + settings(tmp_path), 0.5)
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        place.fly(plan_of("hover"), tmp_path / f"{name}.mcap", seed=seed)
    gyro = [open_recording(tmp_path / f"{name}.mcap").samples.gyro for name in "abc"]
    assert np.array_equal(gyro[0], gyro[1])
    assert not np.array_equal(gyro[0], gyro[2])


def test_a_battery_that_is_low_ends_the_flight_and_what_was_flown_is_kept(tmp_path):
    place = Place("software:" + settings(tmp_path, more="charge = 0.01\n"), 0.5)
    flown = place.fly(plan_of("hover", "thrust steps"), tmp_path / "low.mcap", seed=1)
    assert "battery" in flown.aborted or "telemetry" in flown.aborted
    assert len(open_recording(tmp_path / "low.mcap").samples) > 1000


def test_a_craft_on_its_back_is_refused_before_anything_turns(tmp_path):
    place = Place("software:" + settings(tmp_path, more="upside_down = true\n"), 0.5)
    with pytest.raises(BadInputError, match="on its back"):
        place.fly(plan_of("hover"), tmp_path / "back.mcap", seed=1)
    samples = open_recording(tmp_path / "back.mcap").samples
    assert not samples.duty[samples.time_s > 2.5].any()  # the firmware tests its motors before


def test_gains_fly_that_were_written_before(tmp_path):
    place = Place("software:" + settings(tmp_path), 0.5)
    gains = {"pid_rate.roll_kp": 200.0}
    flown = place.fly(plan_of("hover"), tmp_path / "g.mcap", seed=1, gains=gains)
    assert flown.gains["pid_rate.roll_kp"] == 200.0
    assert flown.gains["pid_rate.pitch_kp"] == 250.0


@pytest.mark.parametrize("source", ["zeppelin", "nowhere.toml"])
def test_settings_that_are_none_are_refused(source):
    with pytest.raises(BadInputError, match=source):
        SoftwareCraft(source, CLIENT)
