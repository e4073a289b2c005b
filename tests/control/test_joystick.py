"""A joystick and a battery over time on the whole loop, from a file and from a recorded flight."""

from pathlib import Path

import numpy as np
import pytest

from groundstation.control.joystick import follow, joystick_of_recording, load_joystick
from groundstation.control.pid import PidGains
from groundstation.dynamics.mixer import PWM_FULL
from groundstation.dynamics.model import load_model
from groundstation.errors import BadInputError
from groundstation.recording.session import Recording
from groundstation.telemetry.samples import empty_samples

MODEL = load_model(Path(__file__).parent / "data" / "body.json")
LEVEL = PidGains(60.0, 2.0, 30.0)
GAINS = {"roll": LEVEL, "pitch": LEVEL, "yaw": PidGains(800.0, 0.0, 300.0)}
HEAD = "time_s,roll_deg,pitch_deg,yaw_deg"
START_NS = 10**18


def written(folder, text):
    path = folder / "inputs.csv"
    path.write_text(text)
    return path


def test_a_sagging_battery_is_made_up_for_and_the_stick_followed(tmp_path):
    rows = ["0,0,0,0,4.0", "3,0,0,0,3.8", "3.5,8,0,10,3.7", "8,8,0,10,3.4"]
    inputs = load_joystick(written(tmp_path, f"{HEAD},battery_v\n" + "\n".join(rows)))
    followed = follow(MODEL, GAINS, inputs)
    assert np.degrees(followed.response.angles[-1]) == pytest.approx([8.0, 0.0, 10.0], abs=0.3)
    duty = followed.response.pwm.mean(axis=1) / PWM_FULL
    assert duty[-1] / duty[0] == pytest.approx(4.0 / 3.4, rel=0.01)
    told = followed.as_dict()
    assert told["seconds"] == pytest.approx(8.0)
    assert told["battery_v"] == pytest.approx([3.4, 4.0], abs=1e-3)
    assert told["axes"]["pitch"]["largest_deg"] < 1.0 < told["axes"]["roll"]["largest_deg"]


def test_thrust_is_a_share_of_full_and_motors_at_their_stop_are_counted(tmp_path):
    rows = ["0,0,0,0,1.0", "2,0,0,0,1.0"]
    inputs = load_joystick(written(tmp_path, f"{HEAD},thrust\n" + "\n".join(rows)))
    followed = follow(MODEL, GAINS, inputs)
    assert (followed.response.pwm[0] == PWM_FULL).all()
    assert followed.as_dict()["at_stops_pct"] == 100.0


def flown(yaw_dps=20.0):
    """A flight of 4 s: rest, then roll 6 deg and a yaw rate."""
    samples = empty_samples(2000)
    samples.host_time_ns[:] = START_NS + 2_000_000 * np.arange(2000)
    samples.battery_v[:] = np.linspace(4.0, 3.6, 2000)
    commands = [
        {"kind": "setpoint", "time_ns": START_NS + 10_000_000 * k, "roll_deg": 6.0 * (k > 200),
         "pitch_deg": 0.0, "yaw_dps": yaw_dps * (k > 200), "thrust": 30000 * (k >= 100)}
        for k in range(400)
    ]  # fmt: skip
    return Recording(Path("flight.mcap"), "mcap", samples, commands=commands)


def test_a_recorded_flight_gives_what_was_sent_and_the_battery_it_had():
    inputs = joystick_of_recording(flown())
    assert len(inputs.attitude) * 0.002 == pytest.approx(2.99, abs=0.01)
    assert np.degrees(inputs.attitude[-1]) == pytest.approx([6.0, 0.0, 20.0 * 1.98], abs=0.5)
    assert inputs.supply_mv[[0, -1]] == pytest.approx([3900.0, 3601.0], abs=2.0)
    followed = follow(MODEL, GAINS, inputs)
    assert np.degrees(followed.response.angles[-1, 0]) == pytest.approx(6.0, abs=0.5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time_s,roll_deg\n0,1\n1,1\n", "no column pitch_deg, yaw_deg"),
        (f"{HEAD},thrust\n0,0,0,0,2\n1,0,0,0,2\n", "thrust is a share of full"),
        (f"{HEAD},battery_v\n0,0,0,0,37\n1,0,0,0,37\n", "battery_v must be 2.5..20 V"),
        (f"{HEAD}\n0,80,0,0\n1,80,0,0\n", "a tilt of 80 deg"),
        (f"{HEAD}\n0,0,0,0\n1,0,0,190\n", "yaw goes to 190 deg"),
    ],
)
def test_inputs_that_cannot_be_flown_are_refused_by_what_is_wrong(tmp_path, text, said):
    with pytest.raises(BadInputError, match=said):
        load_joystick(written(tmp_path, text))


def test_a_recording_without_setpoints_and_gains_that_lose_the_craft_are_said(tmp_path):
    silent = flown()
    silent.commands.clear()
    with pytest.raises(BadInputError, match="no setpoints that fly"):
        joystick_of_recording(silent)
    inputs = load_joystick(written(tmp_path, f"{HEAD}\n0,0,0,0\n1,10,0,0\n20,10,0,0\n"))
    with pytest.raises(BadInputError, match=r"the craft is lost after \d"):
        follow(MODEL, {"roll": PidGains(400.0, 0.0, -30.0)}, inputs)
