import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.errors import BadInputError
from groundstation.recording.microsd import longest_in_order, read_microsd
from groundstation.recording.motor_columns import gyro_unit_of, is_command
from support.foreign_logs import FIXED, header_bytes, log_bytes, record_bytes

LOG16 = Path(__file__).parents[2] / "recordings" / "microsd_log16"

EVERY_TYPE = {
    **{"i.b": "b", "u.b": "B", "i.h": "h", "u.h": "H", "i.i": "i", "u.i": "I"},
    **{"i.q": "q", "u.q": "Q", "f.f": "f", "f.d": "d"},
}
EVENTS = {
    FIXED: ("fixedFrequency", {"gyro.x": "f", "gyro.y": "f", "gyro.z": "f", "motor.m1": "H"}),
    0: ("pose", {"locSrv.x": "f", "locSrv.y": "f"}),
    1: ("trigger", {}),
}


def mixed_records(rows=200):
    """A 500 Hz event with a pose every fifth row and a trigger every seventh."""
    records = []
    for row in range(rows):
        time_us = 30_000_000 + 2000 * row
        records.append((FIXED, time_us, (0.5 * row, -1.0, 900.0, 1000 + row)))
        if row % 5 == 0:
            records.append((0, time_us + 300, (0.01 * row, -0.01 * row)))
        if row % 7 == 0:
            records.append((1, time_us + 500, ()))
    return records


def saved(folder, data):
    path = folder / "log"
    path.write_bytes(data)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("microsd")


def test_the_real_log_has_all_its_rows_and_a_matching_checksum():
    recording = read_microsd(LOG16)
    assert recording.kind == recording.link == "microsd"
    assert recording.damage == []
    assert list(recording.tables) == ["fixedFrequency"]
    table = recording.tables["fixedFrequency"]
    assert len(table.time_s) == len(recording.samples) == 47182
    assert {name: str(values.dtype) for name, values in table.columns.items()} == {
        **{f"acc.{axis}": "float32" for axis in "xyz"},
        **{f"gyro.{axis}": "float32" for axis in "xyz"},
        **{f"motor.m{motor}": "uint32" for motor in range(1, 5)},
    }
    assert recording.samples.ticks[0] == 16895788
    assert recording.samples.tick_s == 1e-6


def test_the_real_log_in_si_units():
    recording = read_microsd(LOG16)
    table, samples = recording.tables["fixedFrequency"].columns, recording.samples
    assert np.degrees(samples.gyro[:, 1]) == pytest.approx(table["gyro.y"], rel=1e-6)
    assert samples.accelerometer[:, 2] == pytest.approx(table["acc.z"] * 9.80665, rel=1e-6)
    assert samples.duty[:, 3] == pytest.approx(table["motor.m4"] / 65535, rel=1e-6)
    assert np.isnan(samples.attitude).all()
    assert np.isnan(samples.battery_v).all()
    assert recording.metadata["microsd"] == {
        "version": "2",
        "gyro_unit": "deg/s",
        "gyro_unit_because": "the peak of 1294 is beyond the sensor's range in rad/s",
    }


@given(st.data())
def test_every_event_and_value_of_every_type_comes_back(folder, data):
    version = data.draw(st.sampled_from([1, 2]))
    ranges = {"b": 8, "B": 8, "h": 16, "H": 16, "i": 32, "I": 32, "q": 64, "Q": 64}
    cells = [
        st.floats(width=32 if letter == "f" else 64)
        if letter in "fd"
        else st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        if letter.islower()
        else st.integers(0, 2**bits - 1)
        for letter in EVERY_TYPE.values()
        for bits in [ranges.get(letter, 0)]
    ]
    events = {FIXED: ("fixedFrequency", EVERY_TYPE), 7: ("other", {"x.y": "h"})}
    record = st.one_of(
        st.tuples(st.just(FIXED), st.integers(0, 2**32 - 1), st.tuples(*cells)),
        st.tuples(st.just(7), st.integers(0, 2**32 - 1), st.tuples(st.integers(-9, 9))),
    )
    records = data.draw(st.lists(record, max_size=12))
    recording = read_microsd(saved(folder, log_bytes(events, records, version)))
    assert recording.damage == []
    for number, (name, variables) in events.items():
        mine = [entry for entry in records if entry[0] == number]
        table = recording.tables[name]
        unit_s = 1e-3 if version == 1 else 1e-6
        assert table.time_s == pytest.approx([time * unit_s for _, time, _ in mine], rel=1e-12)
        for place, (variable, letter) in enumerate(variables.items()):
            column = table.columns[variable]
            assert column.dtype == np.dtype("<" + letter)
            stored = np.array([values[place] for _, _, values in mine], column.dtype)
            assert column.tobytes() == stored.tobytes()


def test_interleaved_events_keep_their_own_clocks(folder):
    recording = read_microsd(saved(folder, log_bytes(EVENTS, mixed_records())))
    assert {name: len(table.time_s) for name, table in recording.tables.items()} == {
        "fixedFrequency": 200,
        "pose": 40,
        "trigger": 29,
    }
    assert np.diff(recording.tables["pose"].time_s) == pytest.approx(0.01)
    assert recording.tables["pose"].columns["locSrv.x"][-1] == np.float32(1.95)
    assert np.diff(recording.samples.ticks).tolist() == [2000] * 199
    assert recording.samples.host_time_ns[0] == 30_000_000_000


def test_version_one_counts_milliseconds(folder):
    records = [(FIXED, 100 + 2 * row, (1.0, 2.0, 3.0, 4)) for row in range(5)]
    samples = read_microsd(saved(folder, log_bytes(EVENTS, records, version=1))).samples
    assert samples.time_s == pytest.approx([0.1, 0.102, 0.104, 0.106, 0.108])


@given(st.data())
def test_a_flipped_byte_is_reported_and_costs_at_most_its_record(folder, data):
    sound = log_bytes(EVENTS, mixed_records())
    place = data.draw(st.integers(len(header_bytes(EVENTS)), len(sound) - 1))
    flip = data.draw(st.integers(1, 255))
    damaged = bytearray(sound)
    damaged[place] ^= flip
    recording = read_microsd(saved(folder, bytes(damaged)))
    assert recording.damage
    assert all("\n" not in line for line in recording.damage)
    kept = sum(len(table.time_s) for table in recording.tables.values())
    assert 268 <= kept <= 269
    assert np.all(np.diff(recording.samples.ticks) >= 0)
    assert len(recording.samples) >= 199


def test_damage_that_makes_a_signalling_nan_is_a_nan_like_any_other(folder):
    events = {FIXED: ("fixedFrequency", {f"gyro.{axis}": "f" for axis in "xyz"})}
    records = [(FIXED, 2000 * row, (1.0, 2.0, 3.0)) for row in range(4)]
    records.append((FIXED, 8000, (12345.0, 2.0, 3.0)))
    sound = log_bytes(events, records)
    damaged = sound.replace(struct.pack("<f", 12345.0), b"\x01\x00\xa0\x7f")
    recording = read_microsd(saved(folder, damaged))
    assert np.isnan(recording.samples.gyro[-1, 0])
    assert np.isfinite(recording.samples.gyro[:-1]).all()
    assert recording.damage


@given(st.data())
def test_a_torn_file_keeps_every_whole_record(folder, data):
    records = mixed_records()
    sound = log_bytes(EVENTS, records)
    first = len(header_bytes(EVENTS))
    cut = data.draw(st.integers(first, len(sound) - 1))
    recording = read_microsd(saved(folder, sound[:cut]))
    end, whole = first, 0
    for record in records:
        end += len(record_bytes(EVENTS, *record))
        whole += end <= cut
    assert sum(len(table.time_s) for table in recording.tables.values()) == whole
    assert len(recording.damage) == 1
    assert "torn" in recording.damage[0]


def test_a_hole_in_the_middle_costs_only_what_it_covers(folder):
    sound = bytearray(log_bytes(EVENTS, mixed_records()))
    size = len(record_bytes(EVENTS, *mixed_records()[0]))
    middle = len(sound) // 2
    sound[middle : middle + 20 * size] = bytes(20 * size)
    recording = read_microsd(saved(folder, bytes(sound)))
    assert 200 - 22 <= len(recording.samples) <= 200 - 15
    assert any("no records" in line for line in recording.damage)
    assert recording.samples.ticks[-1] == 30_000_000 + 2000 * 199


def test_an_id_flipped_into_another_event_s_id_brings_no_false_record(folder):
    """The ids 0 and 1 differ by one bit: the record after the damage gives it away."""
    records = mixed_records()
    sound = bytearray(log_bytes(EVENTS, records))
    position = len(header_bytes(EVENTS)) + len(record_bytes(EVENTS, *records[0]))
    assert sound[position] == 0
    sound[position] = 1
    recording = read_microsd(saved(folder, bytes(sound)))
    assert len(recording.tables["pose"].time_s) == 39
    assert len(recording.tables["trigger"].time_s) == 29
    assert len(recording.samples) == 200
    assert f"bytes {position}..{position + 17} are no records" in recording.damage[0]


def test_a_pause_of_the_logger_is_not_damage_beside_damage_elsewhere(folder):
    records = [
        (n, time + (60_000_000 if row > 99 else 0), values)
        for row, (n, time, values) in enumerate(mixed_records())
    ]
    torn = log_bytes(EVENTS, records)[:-1]
    recording = read_microsd(saved(folder, torn))
    assert sum(len(table.time_s) for table in recording.tables.values()) == len(records)
    assert len(recording.damage) == 1


def test_a_log_without_the_fixed_frequency_event_has_tables_but_no_samples(folder):
    events = {1: ("pose", {"locSrv.x": "f"})}
    recording = read_microsd(saved(folder, log_bytes(events, [(1, 5, (1.5,)), (1, 6, (2.5,))])))
    assert recording.tables["pose"].columns["locSrv.x"].tolist() == [1.5, 2.5]
    assert len(recording.samples) == 0
    assert recording.damage == ["no fixed-frequency event: there are tables but no samples"]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "the file is empty"),
        (b"\x89MCAP0\r\n", "not a microSD log"),
        (b"\xbc\x03\x00\x01\x00", "version 3"),
        (b"\xbc\x02\x00", "header of the microSD log is damaged"),
        (header_bytes(EVENTS)[:-5], "header of the microSD log is damaged: a name at byte"),
        (header_bytes({1: ("e", {"a.b": "Z"})}), "variable a.b(Z) has no known type"),
        (header_bytes({1: ("e", {}), 2: ("e", {})}), "event 'e' is there twice"),
        (b"\xbc\x02\x00\x01\x00\x01\x00\xff\x00", "the name at byte 7 is no text"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line(folder, data, message):
    with pytest.raises(BadInputError) as caught:
        read_microsd(saved(folder, data))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@given(st.binary(max_size=300))
def test_arbitrary_bytes_behind_the_magic_never_crash_the_reader(folder, data):
    try:
        recording = read_microsd(saved(folder, b"\xbc\x02\x00" + data))
    except BadInputError:
        return
    assert (
        recording.damage
        or zlib.crc32(b"\xbc\x02\x00" + data[:-4]) == struct.unpack("<I", data[-4:])[0]
    )


@given(st.binary(max_size=400))
def test_arbitrary_records_behind_a_header_never_crash_the_reader(folder, data):
    recording = read_microsd(saved(folder, header_bytes(EVENTS) + data))
    assert np.all(np.diff(recording.samples.ticks) >= 0)


def flight(*, rate_unit, rows=1500):
    """A roll swing of +-0.3 rad with its quaternion, and the gyro in ``rate_unit``."""
    time_s = np.arange(rows) * 0.002
    roll, pitch = 0.3 * np.sin(4 * time_s), np.full(rows, 0.1)
    roll_rate = 1.2 * np.cos(4 * time_s) / rate_unit
    w, x = np.cos(roll / 2), np.sin(roll / 2)
    c, s = np.cos(0.05), np.sin(0.05)
    events = {
        FIXED: (
            "fixedFrequency",
            {
                **{f"gyro.{axis}": "f" for axis in "xyz"},
                **{f"stateEstimate.q{part}": "f" for part in "wxyz"},
                **{"pm.vbatMV": "H", "rpm.m1": "H", "pwm.m2_pwm": "H"},
            },
        )
    }
    records = [
        (
            FIXED,
            5_000_000 + 2000 * row,
            (
                roll_rate[row],
                0,
                0,
                c * w[row],
                c * x[row],
                s * w[row],
                -s * x[row],
                3750,
                15000,
                32768,
            ),
        )
        for row in range(rows)
    ]
    return log_bytes(events, records), roll, pitch


@pytest.mark.parametrize(("unit", "size"), [("rad/s", 1.0), ("deg/s", np.pi / 180)])
def test_the_attitude_says_which_unit_the_gyro_has(folder, unit, size):
    data, roll, pitch = flight(rate_unit=size)
    recording = read_microsd(saved(folder, data))
    assert recording.metadata["microsd"]["gyro_unit"] == unit
    samples = recording.samples
    assert samples.gyro[0, 0] == pytest.approx(1.2)
    assert samples.attitude[:, 0] == pytest.approx(roll, abs=1e-5)
    assert samples.attitude[:, 1] == pytest.approx(pitch, abs=1e-5)
    assert samples.attitude[:, 2] == pytest.approx(0, abs=1e-5)
    assert samples.battery_v[0] == pytest.approx(3.75)
    assert samples.rotor_rev_s[0] == pytest.approx([250, np.nan, np.nan, np.nan], nan_ok=True)
    assert samples.duty[0, 1] == pytest.approx(0.5, abs=1e-4)


def test_a_gyro_that_says_nothing_is_taken_as_the_firmware_logs_it():
    quiet = np.full((500, 3), 0.01)
    unit, why = gyro_unit_of(quiet, np.full((500, 3), np.nan, np.float32), np.arange(500) * 0.002)
    assert unit == "deg/s"
    assert "the data do not say" in why


def test_euler_angles_in_degrees_turn_into_our_signs(folder):
    names = {f"stateEstimate.{angle}": "f" for angle in ("roll", "pitch", "yaw")}
    data = log_bytes({FIXED: ("fixedFrequency", names)}, [(FIXED, 1, (10, 20, 30))])
    attitude = read_microsd(saved(folder, data)).samples.attitude[0]
    assert np.degrees(attitude) == pytest.approx([10, -20, 30])


@given(st.lists(st.integers(0, 30), max_size=12))
def test_the_rows_kept_in_order_are_in_order_and_as_many_as_can_be(times):
    keep = longest_in_order(np.array(times, np.int64))
    kept = np.array(times)[keep]
    assert np.all(np.diff(kept) >= 0)
    best = [0] * len(times)
    for row, time in enumerate(times):
        best[row] = 1 + max((best[b] for b in range(row) if times[b] <= time), default=0)
    assert keep.sum() == max(best, default=0)


def motors_log(folder, columns):
    """A log of 400 rows of these motor columns (n,)."""
    names = dict.fromkeys(columns, "f")
    rows = zip(*(np.asarray(one, float).tolist() for one in columns.values()), strict=True)
    records = [(FIXED, 5_000_000 + 2000 * row, values) for row, values in enumerate(rows)]
    return read_microsd(saved(folder, log_bytes({FIXED: ("fixedFrequency", names)}, records)))


def moving(names, seed):
    draw = np.random.default_rng(seed).integers(20_000, 40_000, (400, len(names)))
    return {name: draw[:, k] for k, name in enumerate(names)}


ASKED = moving([f"motor.m{m}" for m in range(1, 5)], 1)
GIVEN = moving([f"pwm.m{m}_pwm" for m in range(1, 5)], 2)


def test_some_pwm_beside_all_commands_are_not_mixed_with_them(folder):
    recording = motors_log(folder, {**ASKED, "pwm.m1_pwm": GIVEN["pwm.m1_pwm"]})
    assert recording.samples.duty[:, 0] * 65535 == pytest.approx(ASKED["motor.m1"], abs=0.01)
    assert "the motors' duty is not known" in recording.metadata["unclear"]["duty"]
    assert recording.metadata["notes"]["1"].startswith("only pwm.m1_pwm of pwm.m1_pwm to m4_pwm")


@pytest.mark.parametrize("rest", [0.0, np.nan])
def test_pwm_that_rests_while_the_commands_move_is_not_the_duty(folder, rest):
    recording = motors_log(folder, {**ASKED, **{name: np.full(400, rest) for name in GIVEN}})
    assert recording.samples.duty[:, 2] * 65535 == pytest.approx(ASKED["motor.m3"], abs=0.01)
    assert "the motors' duty is not known" in recording.metadata["unclear"]["duty"]
    assert "never change" in recording.metadata["notes"]["1"]


@pytest.mark.parametrize("more", [("pwm.m5_pwm", "pwm.m6_pwm"), ("motor.m5", "motor.m6")])
def test_six_motors_that_move_are_no_quadrotors_on_the_card_either(folder, more):
    recording = motors_log(folder, {**GIVEN, **moving(more, 3)})
    assert np.isnan(recording.samples.duty).all()
    assert "6 motors move" in recording.metadata["unclear"]["duty"]


def test_of_a_quaternion_that_rests_and_angles_that_move_the_angles_are_taken(folder):
    angles = {f"stateEstimate.{name}": np.arange(400) / 40 for name in ("roll", "pitch", "yaw")}
    rest = {f"stateEstimate.q{part}": np.full(400, float(part == "w")) for part in "wxyz"}
    attitude = motors_log(folder, {**angles, **rest}).samples.attitude
    assert np.degrees(attitude[200]) == pytest.approx([5, -5, 5], abs=1e-5)


@pytest.mark.parametrize(
    "name",
    ["motor.m1", "motor_m2", "log_motor_m3", "log.motor.m4", "motor/m1", "/cf1/log/motor.m2"],
)
def test_the_firmwares_motors_are_known_under_any_spelling(name):
    assert is_command(name)


@pytest.mark.parametrize("name", ["m1", "motor.m5", "pwm.m1_pwm", "motor.m1req", "promotor_m1"])
def test_other_motors_are_not_the_firmwares_command(name):
    assert not is_command(name)


def test_where_the_map_names_the_craft_only_the_firmwares_own_name_is_doubted():
    assert is_command("motor.m1", craft_known=True)
    assert not is_command("motor_motor_m1", craft_known=True)
