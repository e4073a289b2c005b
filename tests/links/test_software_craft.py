"""The software craft on its own clock is commanded as one behind the daemon."""

import itertools

import numpy as np
import pytest

from groundstation.cli.flying import Interrupts, Room, fly_by_height
from groundstation.cli.learn import CLIENT, FastPlace
from groundstation.errors import BadInputError
from groundstation.learn.planning import FlightPlan, Limits, library
from groundstation.links.software_craft import SoftwareCraft
from groundstation.recording.formats import open_recording

SETTINGS = '[stand_in]\nplant = "{plant}"\ncraft = "{craft}"\n{more}'


def settings(tmp_path, craft="crazyflie21", more="", plant="reduced"):
    path = tmp_path / "craft.toml"
    path.write_text(SETTINGS.format(craft=craft, more=more, plant=plant))
    return str(path)


def plan_of(*names):
    known = library(Limits())
    return FlightPlan(tuple(known[name] for name in names), "")


def place(*how, **more):
    return FastPlace(settings(*how, **more), 0.5, 1.0)


class Watched(SoftwareCraft):
    """Keeps where it really was, every 10 ms: position (m) and velocity (m/s)."""

    def __init__(self, *how, **more):
        super().__init__(*how, **more)
        self.track = []

    def wait(self, seconds=0.01):
        super().wait(seconds)
        self.track.append((*self.position_m, *self.velocity_m_s))


def flown(source, *names, craft=SoftwareCraft, reach_m=1.0):
    flying = craft(source, CLIENT, seed=1)
    flying.arm()
    with Interrupts() as signals:
        ended = fly_by_height(
            flying, plan_of(*names), Room(0.5, 0.0, reach_m), signals,
            tells_battery=True, clock=flying,
        )  # fmt: skip
    return flying, ended


@pytest.mark.parametrize("craft", ["crazyflie21", "brushless"])
def test_it_flies_a_programme_comes_back_and_tells_what_was_commanded(tmp_path, craft):
    flying, ended = flown(settings(tmp_path, craft), "roll doublets", "yaw steps", reach_m=2.0)
    assert (ended.why, ended.motors) == ("", "landed, motors are off")
    assert np.hypot(*flying.position_m[:2]) < 0.3
    assert flying.position_m[2] < 0.01
    flying.save(tmp_path / "flight.mcap")
    recording = open_recording(tmp_path / "flight.mcap")
    assert recording.metadata["vehicle"]["profile"] == craft
    sent = [entry for entry in recording.commands if entry["kind"] == "setpoint"]
    leans = [entry["roll_deg"] for entry in sent]
    assert max(leans) > 8.0
    rolled = np.degrees(np.interp(
        [entry["time_ns"] + 200_000_000 for entry in sent],
        recording.samples.host_time_ns, recording.samples.attitude[:, 0],
    ))  # fmt: skip
    assert np.corrcoef(leans, rolled)[0, 1] > 0.5  # in the signs of the telemetry
    marks = [(event["text"], event["details"].get("name")) for event in recording.events]
    assert marks == [
        ("pid fly programme", None),
        ("pid fly manoeuvre", "roll doublets"),
        ("pid fly holds", "roll doublets"),
        ("pid fly manoeuvre", "yaw steps"),
        ("pid fly holds", "yaw steps"),
        ("pid fly landing", None),
    ]


WRONG_CRAFTS = {
    "IMU turned by 1 deg": (
        "[stand_in.effects.imu_misalignment]\nroll_deg = 1.0\npitch_deg = 0.0\nyaw_deg = 0.0\n",
        "",
    ),
    "IMU turned by 2 deg": (
        "[stand_in.effects.imu_misalignment]\nroll_deg = 0.0\npitch_deg = 2.0\nyaw_deg = 0.0\n",
        "",
    ),
    "one rotor 40 % weak": (
        "[stand_in.effects.rotor_mismatch]\nrotor = 1.0\nexcess = -0.4\n",
        "position: manoeuvres carried it off 7 times in this flight",
    ),
    "height sticks": ("range_sticks_s = 9.0\nrange_stuck_m = 0.3\n", "height sensor: it says 0.3"),
    "height is always 0": (
        "range_sticks_s = 0.0\nrange_stuck_m = 0.0\n",
        "height sensor: it says 0.0",
    ),
    "mass x 2": (
        "[stand_in.effects.mass_change]\npercent = 100.0\n",
        "no take-off: 0.00 m high 2 s after the start",
    ),
}


@pytest.mark.parametrize(("more", "why"), WRONG_CRAFTS.values(), ids=WRONG_CRAFTS)
def test_a_craft_that_is_not_well_stays_in_its_room_comes_down_softly_and_says_why(
    tmp_path, more, why
):
    """Attitude setpoints alone carry each of them away, or to the ceiling."""
    source = settings(tmp_path, more=more, plant="faithful")
    flying, ended = flown(source, "roll doublets", "pitch doublets", "yaw steps", craft=Watched)
    assert ended.why.startswith(why)
    assert bool(ended.why) == bool(why)
    assert "motors are off" in ended.motors
    for _ in itertools.repeat(None, 200):
        flying.wait()  # to where it falls
    track = np.array(flying.track)
    assert np.hypot(track[:, 0], track[:, 1]).max() < 1.6
    assert track[:, 2].max() < (1.2 if "sensor" in why else 0.8)
    touches = track[np.flatnonzero(track[:, 2] > 0.01)[-1:]]
    if "sensor" not in why:  # nothing tells such a one where the ground is
        assert np.hypot(touches[:, 3], touches[:, 4]).max(initial=0.0) < 0.3
        assert (-touches[:, 5]).max(initial=0.0) < 0.6


def test_a_flight_is_the_same_for_its_seed(tmp_path):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        place(tmp_path).fly(plan_of("hover"), tmp_path / f"{name}.mcap", seed=seed)
    gyro = [open_recording(tmp_path / f"{name}.mcap").samples.gyro for name in "abc"]
    assert np.array_equal(gyro[0], gyro[1])
    assert not np.array_equal(gyro[0], gyro[2])


def test_a_battery_that_is_low_ends_the_flight_and_what_was_flown_is_kept(tmp_path):
    low = place(tmp_path, more="charge = 0.01\n")
    ended = low.fly(plan_of("hover", "thrust steps"), tmp_path / "low.mcap", seed=1)
    assert "battery" in ended.aborted or "telemetry" in ended.aborted
    assert len(open_recording(tmp_path / "low.mcap").samples) > 1000


def test_a_craft_on_its_back_is_refused_before_anything_turns(tmp_path):
    with pytest.raises(BadInputError, match="on its back"):
        place(tmp_path, more="upside_down = true\n").fly(
            plan_of("hover"), tmp_path / "back.mcap", seed=1
        )
    samples = open_recording(tmp_path / "back.mcap").samples
    assert not samples.duty[samples.time_s > 2.5].any()  # the firmware tests its motors before


def test_gains_fly_that_were_written_before(tmp_path):
    gains = {"pid_rate.roll_kp": 200.0}
    ended = place(tmp_path).fly(plan_of("hover"), tmp_path / "g.mcap", seed=1, gains=gains)
    assert ended.gains["pid_rate.roll_kp"] == 200.0
    assert ended.gains["pid_rate.pitch_kp"] == 250.0


@pytest.mark.parametrize("source", ["zeppelin", "nowhere.toml"])
def test_settings_that_are_none_are_refused(source):
    with pytest.raises(BadInputError, match=source):
        SoftwareCraft(source, CLIENT)


def test_a_craft_with_firmware_that_holds_nothing_is_refused():
    with pytest.raises(BadInputError, match="holds neither height nor place"):
        SoftwareCraft("crazyflie1", CLIENT)
