"""What columns are guessed to be, by names, units and numbers, and that the reason is said."""

import struct
import zlib

import numpy as np
import pytest

from groundstation.errors import BadInputError
from groundstation.recording.formats import open_recording
from groundstation.recording.map_document import Chosen, ColumnMap, map_text, rows_of
from groundstation.recording.map_guess import KEYS, FileColumn, columns_of, guess_map
from support import RECORDINGS
from support.foreign_logs import FIXED, log_bytes, write_ros2, write_ulog

TIME_MS = np.arange(0.0, 2000.0, 2.0)
WAVE = np.sin(TIME_MS / 150.0)


def guessed(**columns):
    """Guesses for a table with these columns, each (1000,)."""
    return guess_map([FileColumn(name, name, "", values) for name, values in columns.items()])


def found(*names, values=WAVE):
    """Channel -> column, for names alone."""
    columns = [FileColumn("t_ms", "t_ms", "", TIME_MS)]
    columns += [FileColumn(name, name, "", values) for name in names]
    channels = guess_map(columns).channels
    return {key: one.column.name for key, one in channels.items() if key != "time"}


@pytest.fixture(scope="module")
def flight():
    return open_recording(RECORDINGS / "stand_in_flight.mcap").samples[4000:6000]


@pytest.mark.parametrize("names", [
    ("gyro.x", "gyro.y", "gyro.z"), ("GyroX", "GyroY", "GyroZ"), ("wx", "wy", "wz"),
    ("gyroADC[0]", "gyroADC[1]", "gyroADC[2]"), ("p", "q", "r"), ("gx", "gy", "gz"),
    ("imu.angular_velocity.x", "imu.angular_velocity.y", "imu.angular_velocity.z"),
    ("rollRate", "pitchRate", "yawRate"), ("gyro_x_dps", "gyro_y_dps", "gyro_z_dps"),
    ("s.gyro_rad[0]", "s.gyro_rad[1]", "s.gyro_rad[2]"), ("omega_x", "omega_y", "omega_z"),
])  # fmt: skip
def test_a_gyro_is_found_in_the_spellings_that_people_use(names):
    assert found(*names) == dict(zip(("gyro.x", "gyro.y", "gyro.z"), names, strict=True))


@pytest.mark.parametrize("names", [
    ("motor.m1", "motor.m2", "motor.m3", "motor.m4"), ("M1", "M2", "M3", "M4"),
    ("motor[0]", "motor[1]", "motor[2]", "motor[3]"), ("pwm1", "pwm2", "pwm3", "pwm4"),
    ("duty_1", "duty_2", "duty_3", "duty_4"), ("u1", "u2", "u3", "u4"),
    ("motor_1_cmd", "motor_2_cmd", "motor_3_cmd", "motor_4_cmd"),
])  # fmt: skip
def test_motors_are_found_whether_they_count_from_0_or_1(names):
    assert found(*names, values=0.5 + 0.4 * WAVE) == {
        f"duty.m{n}": name for n, name in enumerate(names, 1)
    }


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("accelerometer.z", "az"),
        ("accelerometer.z", "accZ"),
        ("accelerometer.x", "linear_acceleration.x"),
        ("attitude.roll", "stateEstimate.roll"),
        ("attitude.pitch", "theta"),
        ("attitude.yaw", "yaw_deg"),
        ("battery", "Vbat"),
        ("battery", "pm.vbatMV"),
        ("battery", "Voltage (V)"),
        ("quaternion.w", "qw"),
        ("rotor.m3", "rpm.m3"),
        ("rotor.m2", "m2_rads"),
    ],
)
def test_a_column_is_found_by_its_name(key, name):
    assert found(name) == {key: name}


def test_what_was_wanted_or_is_known_of_a_value_is_not_the_value():
    assert found("target_roll", "roll", "roll_var") == {"attitude.roll": "roll"}
    assert found("rollRate", "roll") == {"gyro.x": "rollRate", "attitude.roll": "roll"}


def test_more_than_four_motors_are_not_guessed_and_that_is_said():
    columns = [FileColumn(f"motor[{n}]", n + 1, "", 0.5 + 0.1 * WAVE) for n in range(6)]
    guesses = guess_map(columns)
    assert not guesses.channels
    assert guesses.notes == ["6 motors are no quadrotor's: none is guessed."]


GRAVITY = 1 + 0.1 * WAVE


@pytest.mark.parametrize(
    ("name", "key", "values", "unit"),
    [
        *(("t", "time", TIME_MS * scale, unit)
          for unit, scale in (("ms", 1.0), ("s", 1e-3), ("us", 1e3), ("ns", 1e6))),
        *(("wx", "gyro.x", size * WAVE, unit)
          for size, unit in ((200.0, "deg/s"), (2.0, "rad/s"), (20000.0, "counts"))),
        *(("az", "accelerometer.z", size * GRAVITY, unit)
          for size, unit in ((9.8, "m/s^2"), (1.0, "g"), (4096.0, "counts"), (2048.0, "g/2048"))),
        *(("motor1", "duty.m1", np.linspace(low, high, 1000), unit)
          for low, high, unit in (
              (0.1, 0.9, "fraction"), (5, 95, "%"), (10, 240, "8-bit"), (1000, 1900, "pwm-us"),
              (48, 1500, "dshot"), (200, 4000, "12-bit"), (0, 60000, "16-bit"),
          )),
    ],
)  # fmt: skip
def test_a_unit_is_told_by_the_numbers(name, key, values, unit):
    """Of time by its steps, of an accelerometer by gravity, of others by their range."""
    guess = guessed(**({} if key == "time" else {"t_ms": TIME_MS}), **{name: values}).channels[key]
    assert (guess.unit, guess.sign) == (unit, 1)
    assert key != "accelerometer.z" or f"gravity in {unit}" in guess.why


def test_a_clock_without_a_name_is_the_column_that_always_grows():
    guesses = guessed(index=np.arange(1000.0), u=WAVE, k=TIME_MS + 7.0)
    assert guesses.channels["time"].column.name == "k"
    assert "always grows" in guesses.channels["time"].why


@pytest.mark.parametrize("unit", ["rad/s", "deg/s"])
@pytest.mark.parametrize("said", ["roll_deg", "roll_rad"])
def test_the_unit_of_a_gyro_is_told_by_how_fast_the_attitude_turns(unit, said):
    angle = 0.2 * WAVE
    rate = np.gradient(angle, TIME_MS * 1e-3)
    columns = {
        said: np.degrees(angle) if said == "roll_deg" else angle,
        "wx": np.degrees(rate) if unit == "deg/s" else rate,
    }
    guess = guessed(t_ms=TIME_MS, **columns).channels["gyro.x"]
    assert guess.unit == unit
    assert f"turns as fast as roll in {unit}" in guess.why


def test_axes_of_a_craft_that_looks_forward_right_down_are_turned_into_ours(flight, tmp_path):
    down, nose_up = np.array([1, -1, -1]), np.array([1, -1, -1])
    rows = np.column_stack([
        np.rint((flight.time_s - flight.time_s[0]) * 1e3), np.degrees(flight.gyro) * down,
        flight.accelerometer * down, np.degrees(flight.attitude) * nose_up, flight.duty,
        flight.battery_v,
    ])  # fmt: skip
    names = "t_ms,wx,wy,wz,ax,ay,az,phi,theta,psi,M1,M2,M3,M4,Vbat (V)"
    lines = [",".join(f"{one:.9g}" for one in row) for row in rows]
    file, made = tmp_path / "flight.csv", tmp_path / "map.toml"
    file.write_text("\n".join([names, *lines]) + "\n")
    found = guess_map(columns_of(file).columns).channels.values()
    chosen = [Chosen(one.key, one.column.reference, one.unit, one.sign) for one in found]
    made.write_text(map_text(chosen, file.name))
    read = open_recording(file, column_map=made).samples
    for name in ("gyro", "accelerometer", "attitude", "duty", "battery_v"):
        assert getattr(read, name) == pytest.approx(getattr(flight, name), abs=1e-4)


@pytest.mark.parametrize(
    ("kind", "write"),
    [
        ("ulog", write_ulog),
        ("rosbag", lambda at, samples: write_ros2(at, samples, "mcap")),
    ],
)
def test_a_log_of_many_series_is_read_by_the_map_of_its_guesses(kind, write, flight, tmp_path):
    write(tmp_path / "log", flight)
    found = columns_of(tmp_path / "log")
    channels = guess_map(found.columns).channels
    chosen = [
        Chosen(one.key, one.column.reference, one.unit, one.sign) for one in channels.values()
    ]
    rows = rows_of(found.series, chosen)
    made = tmp_path / "map.toml"
    made.write_text(map_text(chosen, "log", found.kind, rows))
    read = open_recording(tmp_path / "log", column_map=made).samples
    assert found.kind == kind
    assert read.gyro == pytest.approx(flight.gyro, abs=1e-4)
    assert read.accelerometer == pytest.approx(flight.accelerometer, abs=1e-3)
    assert np.diff(read.time_s) == pytest.approx(0.002, abs=1e-4)
    assert read.attitude[1:] == pytest.approx(flight.attitude[1:], abs=1e-3)
    if kind == "ulog":  # the four that turn: in whose order, only the craft's parameters say
        assert np.sort(read.duty) == pytest.approx(np.sort(flight.duty), abs=1e-3)


def test_gravity_is_found_in_a_file_without_names(tmp_path):
    lines = [f"{0.01 * n};{0.1 * np.sin(n)};0.2;9.8" for n in range(200)]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    channels = guess_map(columns_of(tmp_path / "log.csv").columns).channels
    assert {key: one.column.reference for key, one in channels.items()} == {
        **{"time": 1, "accelerometer.x": 2, "accelerometer.y": 3, "accelerometer.z": 4}
    }


def test_a_column_whose_name_another_has_goes_by_its_number(tmp_path):
    (tmp_path / "log.csv").write_text("t,wx,wx\n0,1,2\n1,1,3\n2,2,4\n")
    assert [one.reference for one in columns_of(tmp_path / "log.csv").columns] == ["t", 2, 3]


@pytest.mark.parametrize("name", ['a "quoted" name', "back\\slash", "grad °", "tab\tin", "x"])
def test_any_name_of_a_column_is_kept_in_a_map(name, tmp_path):
    import msgspec

    text = map_text([Chosen("time", 1, "s"), Chosen("gyro.x", name, "rad/s", -1)], "log.csv")
    gyro = msgspec.toml.decode(text.encode(), type=ColumnMap).gyro
    assert (gyro.x.column, gyro.x.sign) == (name, -1)


def test_a_map_of_nothing_but_time_is_refused():
    with pytest.raises(BadInputError, match="no channel was given a column"):
        map_text([Chosen("time", 1, "s")], "log.csv")


def test_the_variables_of_a_microsd_log_can_be_named(tmp_path):
    variables = {"controller.r_roll": "f", "controller.accelz": "f", "ctrl.count": "H"}
    records = [(FIXED, 10_000 * n, [np.sin(n / 9), 1.0 + 0.1 * np.cos(n), n]) for n in range(300)]
    (tmp_path / "log00").write_bytes(log_bytes({FIXED: ("fixedFrequency", variables)}, records))
    channels = guess_map(columns_of(tmp_path / "log00").columns).channels
    assert {key: (one.column.name, one.unit) for key, one in channels.items()} == {
        "time": ("time", "us"),
        "gyro.x": ("controller.r_roll", "rad/s"),
        "accelerometer.z": ("controller.accelz", "g"),
    }
    chosen = [Chosen(one.key, one.column.reference, one.unit) for one in channels.values()]
    (tmp_path / "map.toml").write_text(map_text(chosen, "log00"))
    read = open_recording(tmp_path / "log00", column_map=tmp_path / "map.toml").samples
    assert read.gyro[:, 0] == pytest.approx([one[0] for *_, one in records])


def test_a_number_that_signals_that_it_is_none_is_none(tmp_path):
    """What a damaged card holds, of which numpy warns where it makes another number of it."""
    names = (*(f"gyro.{axis}" for axis in "xyz"), *(f"acc.{axis}" for axis in "xyz"))
    records = [(FIXED, 10_000 * n, [np.sin(n / 9), 0.1, 0.2, 0.0, 0.1, 1.0]) for n in range(300)]
    records[7][2][0] = 1234.5
    whole = log_bytes({FIXED: ("fixedFrequency", dict.fromkeys(names, "f"))}, records)
    body = whole.replace(struct.pack("<f", 1234.5), b"\x01\x00\xa0\x7f")[:-4]
    log = tmp_path / "log00"
    log.write_bytes(body + struct.pack("<I", zlib.crc32(body)))
    guesses = guess_map(columns_of(log).columns).channels
    chosen = [Chosen(one.key, one.column.reference, one.unit) for one in guesses.values()]
    (tmp_path / "map.toml").write_text(map_text(chosen, "log00"))
    for source in (None, tmp_path / "map.toml"):
        gyro = open_recording(log, column_map=source).samples.gyro
        assert np.flatnonzero(np.isnan(gyro[:, 0])).tolist() == [7]


@pytest.mark.parametrize("name", ["stand_in_flight.mcap", "README.md"])
def test_what_takes_no_column_map_is_refused_in_words(name):
    with pytest.raises(BadInputError, match=f"{name}: (its channels|no table)"):
        columns_of(RECORDINGS / name)


def test_every_channel_that_is_asked_for_is_one_of_a_map():
    for key in KEYS[1:]:
        quantity, _, part = key.partition(".")
        group = getattr(ColumnMap, quantity)
        assert group is not None
        assert not part or part in key
