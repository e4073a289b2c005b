"""Files that every reader takes and a fit fell over: fitted, or refused with the reason."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from groundstation.cli.app import app
from groundstation.dynamics.model import load_model
from groundstation.recording.csv_file import write_table_csv
from groundstation.recording.formats import open_recording
from groundstation.recording.session import Recording
from support.foreign_logs import FIXED, log_bytes, write_crazyswarm2

FLIGHT = Path(__file__).parents[2] / "recordings" / "stand_in_flight.mcap"


@pytest.fixture(scope="module")
def flight():
    return open_recording(FLIGHT).samples


def run(*arguments):
    found = CliRunner().invoke(app, [str(one) for one in arguments])
    error = found.exception
    assert error is None or isinstance(error, SystemExit | Exception)
    return found


def table(folder, samples):
    path = folder / "flight.csv"
    write_table_csv(Recording(path, "csv", samples), path)
    return path


@pytest.mark.parametrize(("rows", "every"), [(2300, 2), (8000, 10)])
def test_a_short_or_a_slow_flight_is_fitted_or_refused_and_never_a_traceback(
    flight, tmp_path, rows, every
):
    file = table(tmp_path, flight[4000 : 4000 + rows : every])
    found = run("fit", "body", file, "--vehicle", "crazyflie1", "-o", tmp_path / "m.json")
    if found.exit_code == 0:
        assert load_model(tmp_path / "m.json").fit
    else:
        assert type(found.exception).__name__ in ("BadInputError", "TooShortError")


def test_the_folder_of_a_bag_is_fitted_as_its_file_is(tmp_path):
    samples = open_recording(FLIGHT.with_name("nanobench_trefoil.mcap")).samples
    samples.ticks[:] -= samples.ticks[0]
    write_crazyswarm2(tmp_path / "bag", samples)
    found = run("fit", "body", tmp_path / "bag", "--vehicle", "crazyflie21", "-o", tmp_path / "m")
    assert found.exit_code == 0, found.output
    (file,) = load_model(tmp_path / "m").fit["body"]["recordings"]
    assert (file["file"], len(file["sha256"])) == ("bag", 64)
    assert "duty is not known" in found.output


def test_six_motors_are_the_reason_why_nothing_is_fitted(flight, tmp_path):
    file = table(tmp_path, flight[4000:8000])
    lines = file.read_text().splitlines()
    head, rows = lines[0], lines[1:]
    place = head.split(",").index("duty_1")
    more = [",".join([row, row.split(",")[place], row.split(",")[place + 1]]) for row in rows]
    file.write_text("\n".join([f"{head},duty_5,duty_6", *more]) + "\n")
    found = run("fit", "body", file, "--vehicle", "crazyflie1", "-o", tmp_path / "m")
    assert "6 motors move" in str(found.exception)


def test_a_card_log_of_unknown_variables_names_them_and_is_read_by_a_map(tmp_path):
    names = [f"controller.r_{axis}" for axis in ("roll", "pitch", "yaw")]
    events = {FIXED: ("fixedFrequency", {**dict.fromkeys(names, "f"), "controller.accelz": "f"})}
    random = np.random.default_rng(1)
    records = [
        (FIXED, 1_000_000 + 10_000 * row, (*random.normal(0, 0.1, 3), 1.0)) for row in range(300)
    ]
    log = tmp_path / "log00"
    log.write_bytes(log_bytes(events, records))
    found = run("inspect", log)
    assert found.exit_code != 0
    assert "bad: no channel has data: there are controller.r_roll" in found.output
    (tmp_path / "map.toml").write_text(
        '[time]\ncolumn = "time"\nunit = "us"\n'
        + "".join(
            f'[gyro.{axis}]\ncolumn = "{name}"\nunit = "rad/s"\n'
            for axis, name in zip("xyz", names, strict=True)
        )
    )
    recording = open_recording(log, column_map=tmp_path / "map.toml")
    assert recording.kind == "microsd"
    assert len(recording.samples) == 300
    assert recording.samples.gyro.std(axis=0) == pytest.approx(0.1, abs=0.01)


def test_an_orientation_that_the_sensor_does_not_measure_is_missing(flight, tmp_path):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    named = types.types
    kinds = [named[f"geometry_msgs/msg/{name}"] for name in ("Quaternion", "Vector3")]
    unmeasured = np.array([-1.0, *[0.0] * 8])
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        imu = bag.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=types)
        for row in range(200):
            stamp_ns = 1_790_000_000_000_000_000 + row * 10_000_000
            stamp = named["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
            one = named["sensor_msgs/msg/Imu"](
                named["std_msgs/msg/Header"](stamp, "body"),
                kinds[0](0.0, 0.0, 0.0, 1.0), unmeasured,
                kinds[1](*map(float, flight.gyro[4000 + row])), np.zeros(9),
                kinds[1](*map(float, flight.accelerometer[4000 + row])), np.zeros(9),
            )  # fmt: skip
            bag.write(imu, stamp_ns, types.serialize_cdr(one, imu.msgtype))
    samples = open_recording(tmp_path / "bag").samples
    assert np.isnan(samples.attitude).all()
    assert np.isfinite(samples.gyro).all()
    said = run("attitude", tmp_path / "bag").output
    assert "nan" not in said
