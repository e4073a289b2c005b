"""One flight as other programs write it, read back as what it was."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from groundstation.cli.app import app
from groundstation.errors import BadInputError
from groundstation.recording.csv_file import write_table_csv
from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_file import write_mcap
from groundstation.recording.mcap_scan import recover
from groundstation.recording.quality import inspect_recording
from groundstation.recording.session import Rows
from support.foreign_logs import (
    write_betaflight,
    write_cfclient,
    write_crazyswarm2,
    write_ros1,
    write_ros2,
    write_service_events,
    write_ulog,
)
from support.programs import run_program

GROUNDSTATION = Path(sys.executable).parent / "groundstation"
FLIGHT = Path(__file__).parents[2] / "recordings" / "stand_in_flight.mcap"


@pytest.fixture(scope="module")
def flight():
    """Two seconds in the air, on whole ms as most of these clocks are, with a heading."""
    samples = open_recording(FLIGHT).samples[4000:5000]
    samples.ticks[:] = np.arange(len(samples)) * round(0.002 / samples.tick_s)
    samples.attitude[:, 2] += 2.0
    return samples


ANYTHING = {"gyro": 1e-4, "accelerometer": 1e-3, "attitude": 1e-5, "duty": 1e-5, "battery_v": 1e-4}
WRITTEN = {
    "cfclient": (write_cfclient, "log.csv", ANYTHING),
    "betaflight": (
        write_betaflight,
        "log.csv",
        {"gyro": 0.01, "accelerometer": 0.0025, "duty": 3e-4, "battery_v": 6e-4},
    ),
    "px4": (write_ulog, "log.ulg", ANYTHING),
    "px4 before 1.13": (
        lambda at, flight: write_ulog(at, flight, "actuator_outputs"),
        "log.ulg",
        {**ANYTHING, "duty": 1e-4},
    ),
    "mcap": (
        lambda at, flight: write_ros2(at, flight, "mcap"),
        "bag",
        {key: ANYTHING[key] for key in ("gyro", "accelerometer", "attitude", "battery_v")},
    ),
    "db3": (
        lambda at, flight: write_ros2(at, flight, "sqlite3"),
        "bag",
        {key: ANYTHING[key] for key in ("gyro", "accelerometer", "attitude", "battery_v")},
    ),
    "crazyswarm2": (write_crazyswarm2, "bag", ANYTHING),
}
SLOW = {"px4", "px4 before 1.13", "mcap", "db3"}
"""These write the battery once in 50 rows and more."""


def same(angle):
    return np.remainder(angle + np.pi, 2 * np.pi) - np.pi


@pytest.mark.parametrize("kind", WRITTEN)
def test_a_flight_is_recognised_and_read_as_what_it_was(kind, flight, tmp_path):
    write, name, expected = WRITTEN[kind]
    write(tmp_path / name, flight)
    recording = open_recording(tmp_path / name)
    found = recording.samples
    assert recording.damage == []
    assert len(found) == len(flight)
    np.testing.assert_allclose(np.diff(found.time_s), 0.002, atol=2e-6)
    for channel in ("gyro", "accelerometer", "attitude", "duty", "battery_v"):
        values = getattr(found, channel)
        if channel not in expected:
            assert np.isnan(values).all()
            continue
        apart = values - getattr(flight, channel)
        if channel == "attitude":
            apart = same(apart)
        if channel == "battery_v" and kind in SLOW:
            apart = values[::500] - flight.battery_v[::500]
        assert np.abs(apart).max() < expected[channel], channel
    write_mcap(recording, tmp_path / "kept.mcap")
    kept = open_recording(tmp_path / "kept.mcap")
    assert np.array_equal(kept.samples.gyro, found.gyro)
    assert kept.metadata["vehicle"] == recording.metadata["vehicle"]
    assert "family" in recording.metadata["vehicle"]


def test_a_file_of_a_bag_reads_like_its_folder(flight, tmp_path):
    for storage in ("mcap", "sqlite3"):
        write_ros2(tmp_path / storage, flight, storage)
        (file,) = (one for one in (tmp_path / storage).iterdir() if one.suffix != ".yaml")
        whole = open_recording(tmp_path / storage)
        assert np.array_equal(open_recording(file).samples.gyro, whole.samples.gyro)


def test_pulses_that_never_rest_may_be_dshot_and_are_asked_for(flight, tmp_path):
    write_betaflight(tmp_path / "log.csv", flight, pwm=True)
    pulses = open_recording(tmp_path / "log.csv", column_map="betaflight_pwm")
    assert np.abs(pulses.samples.duty - flight.duty).max() < 1e-3
    assert "may be" not in inspect_recording(pulses)["verdict"]
    unclear = open_recording(tmp_path / "log.csv")
    assert np.abs(unclear.samples.duty - flight.duty).max() > 0.1
    assert "may be dshot or pwm-us" in inspect_recording(unclear)["verdict"]
    write_table_csv(unclear, tmp_path / "table.csv")
    again = open_recording(tmp_path / "table.csv")
    assert again.samples.duty == pytest.approx(unclear.samples.duty)
    assert "the motors' duty is not known" in inspect_recording(again)["verdict"]


@pytest.mark.parametrize("pwm", [False, True])
def test_motors_that_rest_tell_pulses_from_dshot(pwm, flight, tmp_path):
    flight = flight[:400]
    flight.duty[:200] = 0.0
    write_betaflight(tmp_path / "log.csv", flight, pwm=pwm)
    found = open_recording(tmp_path / "log.csv")
    assert np.abs(found.samples.duty - flight.duty).max() < 1e-3
    assert found.metadata["column_map"]["duty.m1"].endswith("pwm-us" if pwm else "dshot")
    assert "unclear" not in found.metadata


@pytest.mark.parametrize("limits", ["48,2047", "1000,2000"])
def test_what_the_explorer_says_before_its_header_holds(limits, flight, tmp_path):
    low = 1000 if limits.startswith("1000") else 48
    write_betaflight(tmp_path / "log.csv", flight, pwm=low == 1000)
    header, *rows = (tmp_path / "log.csv").read_text().splitlines()
    names = [one.strip().partition(" (")[0] for one in header.split(",")]
    said = ['"Product","Blackbox"', '"acc_1G","1024"', f'"motorOutput","{limits}"']
    lines = [*said, ",".join(f'"{name}"' for name in names), *rows]
    (tmp_path / "explorer.csv").write_text("\n".join(lines))
    found = open_recording(tmp_path / "explorer.csv").samples
    assert np.abs(found.duty - flight.duty).max() < 1e-3
    assert found.accelerometer[:, 2] == pytest.approx(2 * flight.accelerometer[:, 2], abs=0.006)


def test_one_log_block_alone_is_read_for_what_it_has(flight, tmp_path):
    write_cfclient(tmp_path / "block.csv", flight, extra=False)
    recording = open_recording(tmp_path / "block.csv")
    assert np.isfinite(recording.samples.duty).all()
    assert np.isnan(recording.samples.attitude).all()
    assert recording.metadata["vehicle"]["family"] == "unknown"
    (tmp_path / "other.csv").write_text("Timestamp,a,b\n0,1,2\n2,1,2\n")
    verdict = inspect_recording(open_recording(tmp_path / "other.csv"))["verdict"]
    assert verdict.startswith("bad: no channel has data: there are a, b")


def test_a_swarms_bag_says_which_craft_there_are_and_takes_a_map_of_ones_own(flight, tmp_path):
    flight = flight[:200]
    write_crazyswarm2(tmp_path / "bag", flight, robots=("cf1", "cf2"))
    several = "topics of several crafts or sensors: /cf1, /cf2; .*--only topic=/cf1"
    for source in (None, "crazyswarm2"):
        with pytest.raises(BadInputError, match=several):
            open_recording(tmp_path / "bag", column_map=source)
    (tmp_path / "cf2.toml").write_text(
        """
        kind = "rosbag"
        rows = "/cf2/imu"
        time = { column = "/cf2/imu.timestamp", unit = "ms" }
        gyro.z = { column = "/cf2/imu.values[2]", unit = "deg/s" }
        duty.m1 = { column = "/cf2/motors.values[0]", unit = "16-bit" }
        """
    )
    found = open_recording(tmp_path / "bag", column_map=tmp_path / "cf2.toml").samples
    assert np.abs(found.gyro[:, 2] - flight.gyro[:, 2]).max() < 1e-4
    assert np.abs(found.duty[:, 0] - flight.duty[:, 0]).max() < 1e-5


def test_a_topic_of_a_ulog_without_its_clock_is_left_out(flight, tmp_path):
    write_ulog(tmp_path / "log.ulg", flight[:200])
    whole = (tmp_path / "log.ulg").read_bytes()
    clock = b"battery_status:uint64_t timestamp"
    assert clock in whole
    (tmp_path / "log.ulg").write_bytes(whole.replace(clock, clock[:-1] + b"q"))
    samples = open_recording(tmp_path / "log.ulg").samples
    assert np.isfinite(samples.gyro).all()
    assert np.isnan(samples.battery_v).all()


def test_a_damaged_number_of_a_ulog_that_numpy_warns_of_spoils_no_other(flight, tmp_path):
    samples = flight[:200]
    samples.duty[100, 0] = 0.4321
    write_ulog(tmp_path / "log.ulg", samples)
    whole = (tmp_path / "log.ulg").read_bytes()
    number = np.float32(0.4321).tobytes()
    assert whole.count(number) == 1
    (tmp_path / "log.ulg").write_bytes(whole.replace(number, b"\x01\x00\xa0\x7f"))
    duty = open_recording(tmp_path / "log.ulg").samples.duty
    others = np.arange(200) != 100
    assert duty[others] == pytest.approx(samples.duty[others], abs=1e-5)
    assert duty[100, 1:] == pytest.approx(samples.duty[100, 1:], abs=1e-5)


def test_one_craft_of_a_swarms_bag_becomes_a_file_by_the_command_that_is_named(flight, tmp_path):
    flight = flight[:200]
    write_crazyswarm2(tmp_path / "bag", flight, robots=("cf1", "cf2"))
    made = tmp_path / "one.mcap"
    words = ["convert", str(tmp_path / "bag"), str(made), "--only"]
    for only in ("topic=/cf3", "uri=/cf1"):
        assert CliRunner().invoke(app, [*words, only]).exit_code != 0
    done = CliRunner().invoke(app, [*words, "topic=/cf2"])
    assert done.exit_code == 0, done.output
    found = open_recording(made).samples
    assert np.abs(found.gyro - flight.gyro).max() < 1e-4
    assert np.abs(found.duty - flight.duty).max() < 1e-5
    (file,) = (tmp_path / "bag").glob("*.db3")
    assert len(open_recording(file, rows=Rows(("topic", "/cf1"))).samples) == len(flight)


def test_what_acts_is_the_last_command_known_at_a_row(flight, tmp_path):
    """PX4 sets its motors behind the sensors: what stands in a row is what was set before it."""
    samples = flight[:200]
    write_ulog(tmp_path / "log.ulg", samples, motors_late_us=1000)
    found = open_recording(tmp_path / "log.ulg").samples
    assert np.isnan(found.duty[0]).all()
    assert np.abs(found.duty[1:] - samples.duty[:-1]).max() < 1e-5


@pytest.mark.parametrize(
    ("name", "columns", "message"),
    [
        ("log.ulg", "cfclient", "cfclient is a map of csv"),
        ("log.ulg", "ros2", "ros2 is a map of rosbag"),
        ("log.csv", "px4", "px4 is a map of ulog files"),
        ("bag", "px4", "px4 is a map of ulog"),
        ("bag", "crazyswarm2", "the file has none of the columns"),
        ("log.ulg", "none.toml", "no column 'sensor_gyro.x'.*sensor_combined"),
    ],
)
def test_a_map_that_does_not_fit_is_refused_in_one_line(name, columns, message, flight, tmp_path):
    short = flight[:5]
    write_ulog(tmp_path / "log.ulg", short)
    write_cfclient(tmp_path / "log.csv", short)
    write_ros2(tmp_path / "bag", short, "mcap")
    (tmp_path / "none.toml").write_text(
        'kind = "ulog"\nrows = "sensor_combined"\n'
        'time = { column = "sensor_combined.timestamp", unit = "us" }\n'
        'gyro.x = { column = "sensor_gyro.x", unit = "rad/s" }\n'
    )
    source = tmp_path / columns if columns.endswith("toml") else columns
    with pytest.raises(BadInputError, match=message) as caught:
        open_recording(tmp_path / name, column_map=source)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["log.ulg", "bag.mcap", "bag.db3"])
@pytest.mark.parametrize("cut", [0.02, 0.5, 0.97])
def test_a_torn_file_is_an_error_or_shorter_never_a_traceback(name, cut, flight, tmp_path):
    short = flight[:200]
    write_ulog(tmp_path / "log.ulg", short)
    for storage, suffix in (("mcap", "mcap"), ("sqlite3", "db3")):
        write_ros2(tmp_path / storage, short, storage)
        (file,) = (tmp_path / storage).glob(f"*.{suffix}")
        file.rename(tmp_path / f"bag.{suffix}")
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: int(cut * len(whole))])
    done = run_program([GROUNDSTATION, "inspect", tmp_path / name, "--json"])
    if done.returncode == 0:
        assert 0 < json.loads(done.stdout)["samples"] <= len(short)
    else:
        assert done.returncode == 1
        assert done.stderr.startswith("groundstation: ")
        assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(("name", "package"), [("log.ulg", "pyulog"), ("bag", "rosbags")])
def test_without_the_library_the_hint_installs_it_from_here(name, package, flight, tmp_path):
    write_ulog(tmp_path / "log.ulg", flight[:5])
    write_ros2(tmp_path / "bag", flight[:5], "mcap")
    program = (
        f"import sys; sys.modules[{package!r}] = None; "
        "from groundstation.cli.main import main; main()"
    )
    done = run_program([sys.executable, "-c", program, "inspect", tmp_path / name])
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert f"{package} reads: pip install 'crazyflie-groundstation[logs]'" in done.stderr


def test_a_bag_of_ros_1_reads_like_one_of_ros_2(flight, tmp_path):
    write_ros1(tmp_path / "flight.bag", flight[:200])
    found = open_recording(tmp_path / "flight.bag")
    assert found.samples.gyro == pytest.approx(flight.gyro[:200], abs=1e-6)
    assert found.samples.accelerometer == pytest.approx(flight.accelerometer[:200], abs=1e-5)


def test_a_type_that_does_not_parse_is_left_out_and_told_where_it_is_needed(flight, tmp_path):
    write_service_events(tmp_path / "bag.mcap", flight[:200])
    found = open_recording(tmp_path / "bag.mcap")
    assert found.samples.gyro == pytest.approx(flight.gyro[:200], abs=1e-6)
    (tmp_path / "map.toml").write_text(
        'kind = "rosbag"\nrows = "/arm/_service_event"\n'
        'time = { column = "/arm/_service_event.time", unit = "s" }\n'
    )
    with pytest.raises(BadInputError, match="types that do not parse: my_interfaces/srv/Arm_Event"):
        open_recording(tmp_path / "bag.mcap", column_map=tmp_path / "map.toml")


def test_a_recovered_bag_is_still_a_bag(flight, tmp_path):
    write_service_events(tmp_path / "bag.mcap", flight[:200])
    whole = (tmp_path / "bag.mcap").read_bytes()
    (tmp_path / "torn.mcap").write_bytes(whole[:-200])
    recover(tmp_path / "torn.mcap", tmp_path / "whole.mcap")
    found = open_recording(tmp_path / "whole.mcap")
    assert found.samples.gyro == pytest.approx(flight.gyro[:200], abs=1e-6)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"MAV_TYPE": 22}, "MAV_TYPE 22, a VTOL"),
        ({"MAV_TYPE": 1}, "MAV_TYPE 1, a fixed wing"),
        ({"MAV_TYPE": 13, "CA_ROTOR_COUNT": 6}, "MAV_TYPE 13, a hexarotor"),
        ({"CA_ROTOR_COUNT": 8}, "CA_ROTOR_COUNT 8"),
        ({"MAV_TYPE": 2, "CA_ROTOR_COUNT": 4}, None),
    ],
)
def test_motors_of_another_craft_are_no_quadrotor_s(parameters, said, flight, tmp_path):
    write_ulog(tmp_path / "log.ulg", flight[:200], parameters=parameters)
    found = open_recording(tmp_path / "log.ulg")
    assert np.isfinite(found.samples.gyro).all()
    assert np.isnan(found.samples.duty).all() == (said is not None)
    if said:
        verdict = inspect_recording(found)["verdict"]
        assert f"not of a quadrotor ({said}): its motors are left out" in verdict


@pytest.mark.parametrize(
    ("dropouts", "said"),
    [
        ((), None),
        ((12,), "the logger dropped 12 ms in one place"),
        ((0, 26, 31, 62), "the logger dropped 119 ms in 4 places, the longest 62 ms"),
    ],
)
def test_what_a_logger_dropped_is_summed(dropouts, said, flight, tmp_path):
    write_ulog(tmp_path / "log.ulg", flight[:200], dropouts_ms=dropouts)
    assert open_recording(tmp_path / "log.ulg").damage == ([said] if said else [])
