"""Files as people have them: fitted as what they are, or refused with what is wrong with them."""

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.dynamics.model import load_model
from groundstation.errors import BadInputError, GroundStationError
from groundstation.recording.csv_file import write_table_csv
from groundstation.recording.formats import open_recording
from groundstation.recording.session import Recording
from support.commands import run
from support.daemons import in_process
from support.foreign_logs import FIXED, log_bytes, write_crazyswarm2

RECORDINGS = Path(__file__).parents[2] / "recordings"
C0 = 0.00425
"""Of the craft that flew (``recordings/stand_in_flight.mcap``)."""


@pytest.fixture(scope="module")
def flight():
    return open_recording(RECORDINGS / "stand_in_flight.mcap").samples


def written(path, samples, **channels):
    write_table_csv(Recording(path, "csv", replace(samples, **channels)), path)
    return path


def fit_body(file, tmp_path):
    model = tmp_path / "model.json"
    said = run("fit", "body", file, "--vehicle", "crazyflie1", "-o", model)
    return load_model(model), said


def test_a_gyro_in_another_unit_gives_no_constants(flight, tmp_path):
    file = written(tmp_path / "rad.csv", flight, gyro=flight.gyro / np.float32(57.3))
    with pytest.raises(BadInputError, match=r"c0 is .*by the profile.*turns .* as gyro_x says"):
        fit_body(file, tmp_path)
    assert not (tmp_path / "model.json").exists()


def test_a_battery_in_another_unit_is_the_reason_that_is_given(flight, tmp_path):
    for scale in (1000.0, 0.001):
        volts = flight.battery_v * np.float32(scale)
        file = written(tmp_path / f"{scale}.csv", flight, battery_v=volts)
        with pytest.raises(BadInputError, match=r"battery up to .* V, which cannot be"):
            fit_body(file, tmp_path)


def test_motors_with_another_zero_predict_nothing_and_are_no_model(flight, tmp_path):
    file = written(tmp_path / "pwm.csv", flight, duty=0.476 + 0.5 * flight.duty)
    with pytest.raises(BadInputError, match=r"predicted worse than by its mean.*lies still"):
        fit_body(file, tmp_path)


def test_motors_of_100_hz_in_rows_of_500_are_fitted_as_what_they_are(flight, tmp_path):
    slow = flight.duty[np.arange(len(flight)) // 5 * 5]
    model, said = fit_body(written(tmp_path / "slow.csv", flight, duty=slow), tmp_path)
    assert "what the motors are set to is renewed 100 times a second in 500 rows" in said
    estimates = model.fit["body"]["estimates"]
    error = estimates["stderr"][estimates["names"].index("c0")]
    assert abs(model.body.c0 - C0) < 3 * error < 1.5 * C0


def test_motors_of_10_hz_are_refused_for_what_they_are(flight, tmp_path):
    slow = flight.duty[np.arange(len(flight)) // 50 * 50]
    with pytest.raises(BadInputError, match=r"set to is renewed 10 times a second in 500"):
        fit_body(written(tmp_path / "slow.csv", flight, duty=slow), tmp_path)


def test_late_stamps_do_not_cut_a_fit(flight, tmp_path):
    late = np.random.default_rng(1).exponential(6e-4, len(flight))
    stamps = np.maximum.accumulate(flight.time_s + late)
    samples = replace(flight, ticks=np.rint(stamps * 1e9).astype(np.int64), tick_s=1e-9)
    model, _ = fit_body(written(tmp_path / "late.csv", samples), tmp_path)
    assert model.body.c0 == pytest.approx(C0, rel=0.03)


def test_nothing_is_bad_and_nothing_is_made_of_it(tmp_path):
    empty = tmp_path / "empty.csv"
    empty.write_text("Timestamp,gyro.x,gyro.y,gyro.z\n")
    with pytest.raises(GroundStationError, match=r"no samples"):
        run("inspect", empty)
    with pytest.raises(GroundStationError, match=r"no samples"):
        run("convert", empty, tmp_path / "made.mcap")
    assert not (tmp_path / "made.mcap").exists()


@pytest.mark.parametrize(("rows", "every"), [(2300, 2), (8000, 10)])
def test_a_short_or_a_slow_flight_is_fitted_or_refused_and_never_a_traceback(
    flight, tmp_path, rows, every
):
    file = written(tmp_path / "flight.csv", flight[4000 : 4000 + rows : every])
    with contextlib.suppress(BadInputError):
        model, _ = fit_body(file, tmp_path)
        assert model.fit


def test_the_folder_of_a_bag_is_fitted_as_its_file_is(tmp_path):
    samples = open_recording(RECORDINGS / "nanobench_trefoil.mcap").samples
    samples.ticks[:] -= samples.ticks[0]
    write_crazyswarm2(tmp_path / "bag", samples)
    said = run("fit", "body", tmp_path / "bag", "--vehicle", "crazyflie21", "-o", tmp_path / "m")
    (file,) = load_model(tmp_path / "m").fit["body"]["recordings"]
    assert (file["file"], len(file["sha256"])) == ("bag", 64)
    assert "duty is not known" in said


def test_six_motors_are_the_reason_why_nothing_is_fitted(flight, tmp_path):
    file = written(tmp_path / "flight.csv", flight[4000:8000])
    lines = file.read_text().splitlines()
    head, rows = lines[0], lines[1:]
    place = head.split(",").index("duty_1")
    more = [",".join([row, row.split(",")[place], row.split(",")[place + 1]]) for row in rows]
    file.write_text("\n".join([f"{head},duty_5,duty_6", *more]) + "\n")
    with pytest.raises(BadInputError, match="6 motors move"):
        fit_body(file, tmp_path)


def test_a_card_log_of_unknown_variables_names_them_and_is_read_by_a_map(tmp_path):
    names = [f"controller.r_{axis}" for axis in ("roll", "pitch", "yaw")]
    events = {FIXED: ("fixedFrequency", {**dict.fromkeys(names, "f"), "controller.accelz": "f"})}
    random = np.random.default_rng(1)
    records = [
        (FIXED, 1_000_000 + 10_000 * row, (*random.normal(0, 0.1, 3), 1.0)) for row in range(300)
    ]
    log = tmp_path / "log00"
    log.write_bytes(log_bytes(events, records))
    bad = in_process("inspect", log)
    assert bad.returncode == 1
    assert "bad: no channel has data: there are controller.r_roll" in bad.stdout
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
    assert "nan" not in run("attitude", tmp_path / "bag")
