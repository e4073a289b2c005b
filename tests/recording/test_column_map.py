import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from groundstation.cli.app import app
from groundstation.errors import BadInputError, RecordingError
from groundstation.recording.column_map import read_mapped_csv
from groundstation.recording.csv_file import read_csv
from groundstation.recording.formats import open_recording
from groundstation.recording.map_document import NAMED, UNITS, load_column_map
from groundstation.recording.mcap_file import write_mcap
from groundstation.telemetry.packet import STANDARD_GRAVITY, TICK_S

ROOT = Path(__file__).parents[2]
FIELD_OF = {
    "battery": ("battery", lambda samples: samples.battery_v),
    "duty": ("duty.m3", lambda samples: samples.duty[:, 2]),
    "gyro": ("gyro.y", lambda samples: samples.gyro[:, 1]),
    "accelerometer": ("accelerometer.z", lambda samples: samples.accelerometer[:, 2]),
    "attitude": ("attitude.pitch", lambda samples: samples.attitude[:, 1]),
    "rotor": ("rotor.m4", lambda samples: samples.rotor_rev_s[:, 3]),
}
ONE_SI_UNIT_IS = {
    "battery": {"V": 1, "mV": 1000},
    "duty": {
        **{"fraction": 1, "%": 100, "8-bit": 255, "12-bit": 4096, "16-bit": 65535},
        **{"dshot": 2047, "pwm-us": 2000},
    },
    "gyro": {"rad/s": 1, "deg/s": 57.29578, "counts": 57.29578 * 16.384},
    "accelerometer": {
        **{"m/s^2": 1, "g": 1 / 9.80665, "counts": 4096 / 9.80665},
        "g/2048": 2048 / 9.80665,
    },
    "attitude": {"rad": 1, "deg": 57.29578, "counts": 5729.578},
    "rotor": {"rev/s": 1, "rpm": 60, "rad/s": 2 * math.pi},
}


def read(folder, csv, toml):
    (folder / "log.csv").write_text(csv)
    (folder / "map.toml").write_text(toml)
    return read_mapped_csv(folder / "log.csv", folder / "map.toml")


def refusal(folder, csv, toml):
    with pytest.raises(BadInputError) as caught:
        read(folder, csv, toml)
    assert "\n" not in str(caught.value)
    return str(caught.value)


TIME = '[time]\ncolumn = "t"\nunit = "s"\n'


def test_a_foreign_log_in_its_own_units_axes_and_signs(tmp_path):
    recording = read(
        tmp_path,
        "t;wx;az;note;V\n1000;90;-9,80665;on ground;3700\n1002,5;-45;-19,6133;up;\n",
        """
        time = { column = "t", unit = "ms" }
        gyro.x = { column = "wx", unit = "deg/s", sign = -1 }
        accelerometer.z = { column = "az", unit = "m/s^2", sign = -1 }
        battery = { column = "V", unit = "mV" }
        """,
    )
    samples = recording.samples
    assert recording.kind == "csv"
    assert recording.raw is None
    assert samples.time_s == pytest.approx([1.0, 1.0025])
    assert samples.gyro[:, 0] == pytest.approx([-math.pi / 2, math.pi / 4])
    assert samples.accelerometer[:, 2] == pytest.approx([STANDARD_GRAVITY, 2 * STANDARD_GRAVITY])
    assert samples.battery_v == pytest.approx([3.7, np.nan], nan_ok=True)
    assert np.isnan(samples.gyro[:, 1:]).all()
    assert recording.metadata["column_map"] == {
        "time": "t ms",
        "gyro.x": "wx -deg/s",
        "accelerometer.z": "az -m/s^2",
        "battery": "V mV",
    }


@pytest.mark.parametrize(
    ("quantity", "unit"), [(q, unit) for q, units in ONE_SI_UNIT_IS.items() for unit in units]
)
def test_every_unit_has_its_size(tmp_path, quantity, unit):
    key, channel = FIELD_OF[quantity]
    value = ONE_SI_UNIT_IS[quantity][unit]
    mapping = f'{TIME}[{key}]\ncolumn = "v"\nunit = "{unit}"\n'
    samples = read(tmp_path, f"t,v\n0,{value!r}\n", mapping).samples
    assert channel(samples)[0] == pytest.approx(1.0, rel=1e-6)


def test_no_unit_is_left_untested():
    assert {q: set(units) for q, units in UNITS.items() if q not in ("time", "quaternion")} == {
        q: set(units) for q, units in ONE_SI_UNIT_IS.items()
    }


@pytest.mark.parametrize(
    ("unit", "value"),
    [("s", "2.5"), ("ms", "2500"), ("us", "2500000"), ("ns", "2.5e9"), ("ticks", "2465753.42")],
)
def test_every_unit_of_time_has_its_size(tmp_path, unit, value):
    mapping = f'[time]\ncolumn = "t"\nunit = "{unit}"\n'
    samples = read(tmp_path, f"t,v\n{value},0\n", mapping).samples
    assert samples.time_s[0] == pytest.approx(2.5, abs=TICK_S)
    assert samples.tick_s == (TICK_S if unit == "ticks" else 1e-9)


def test_the_thesis_s_own_layout_through_a_map_is_what_the_csv_reader_says(tmp_path):
    excerpt = ROOT / "recordings" / "thesis_excerpt.csv"
    parts = ['[time]\ncolumn = "Timestamp"\nunit = "ticks"', '[battery]\ncolumn = 2\nunit = "mV"']
    parts += [f'[duty.m{m}]\ncolumn = "Motor{m}"\nunit = "12-bit"' for m in range(1, 5)]
    for axis in "xyz":
        parts.append(f'[gyro.{axis}]\ncolumn = "Gyro{axis.upper()}"\nunit = "counts"')
        parts.append(f'[accelerometer.{axis}]\ncolumn = "Acc{axis.upper()}"\nunit = "counts"')
    parts += [f'[attitude.{a}]\ncolumn = "{a.title()}"\nunit = "counts"' for a in ("roll", "yaw")]
    parts.append('[attitude.pitch]\ncolumn = "Pitch"\nunit = "counts"\nsign = -1')
    parts.append('[debug]\ncolumn = "Debug"')
    mapped = read(tmp_path, excerpt.read_text(), "\n".join(parts)).samples
    own = read_csv(excerpt).samples
    assert mapped.tick_s == own.tick_s
    for name in ("ticks", "segment", "host_time_ns", "debug"):
        assert np.array_equal(getattr(mapped, name), getattr(own, name)), name
    for name in ("battery_v", "duty", "gyro", "accelerometer", "attitude"):
        assert getattr(mapped, name) == pytest.approx(getattr(own, name), rel=1e-6), name


def test_a_file_without_a_header_is_mapped_by_numbers(tmp_path):
    mapping = '[time]\ncolumn = 1\nunit = "s"\n[gyro.z]\ncolumn = 3\nunit = "rad/s"\n'
    samples = read(tmp_path, "0.0,9,1.5\n0.002,9,2.5\n", mapping).samples
    assert samples.gyro[:, 2].tolist() == [1.5, 2.5]
    assert samples.time_s.tolist() == [0.0, 0.002]


def test_a_clock_that_runs_backwards_starts_a_segment(tmp_path):
    samples = read(tmp_path, "t,v\n5,0\n6,0\n1,0\n2,0\n", TIME).samples
    assert samples.segment.tolist() == [0, 0, 1, 1]
    assert np.all(np.diff(samples.host_time_ns) > 0)


def test_a_clock_before_zero_still_gives_host_stamps_a_file_can_hold(tmp_path):
    samples = read(tmp_path, "t,v\n-1.5,0\n-1.0,0\n", TIME).samples
    assert samples.time_s.tolist() == [-1.5, -1.0]
    assert samples.host_time_ns.tolist() == [0, 500_000_000]


def column(key, name="v", unit="deg/s", extra=""):
    return f'{TIME}[{key}]\ncolumn = "{name}"\nunit = "{unit}"\n{extra}'


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        ('[gyro.x]\ncolumn = "v"\nunit = "deg/s"', "missing required field `time`"),
        ('[time]\nunit = "s"', "needs either a column or a step"),
        (column("gyro.x", extra="sign = 2"), "$.gyro.x.sign"),
        (column("gyro.x", extra="factor = 2"), "unknown field `factor` - at `$.gyro.x`"),
        (column("gyro.w"), "unknown field `w` - at `$.gyro`"),
        (column("gyroscope.x"), "unknown field `gyroscope`"),
        (column("gyro.x", name=""), "length >= 1 - at `$.gyro.x.column`"),
        (column("gyro.x", unit="dps"), "gyro.x.unit is 'dps'; choose one of rad/s, deg/s, counts"),
        (TIME.replace('"s"', '"min"'), "time.unit is 'min'; choose one of s, ms, us, ns, ticks"),
        (column("gyro.x", name="w"), "no column 'w' (gyro.x in"),
        (column("gyro.x", name="vv"), "did you mean 'v'?"),
        (TIME.replace('"t"', "3"), "time.column is 3, but"),
        (TIME.replace('"t"', "0"), ">= 1 - at `$.time.column`"),
        ("[time", "not a column map"),
    ],
)
def test_a_wrong_map_is_refused_with_its_key(tmp_path, toml, message):
    assert message in refusal(tmp_path, "t,v\n0,1\n", toml)


def test_a_name_that_stands_twice_in_the_header_is_not_guessed(tmp_path):
    refused = refusal(tmp_path, "t,v,v\n0,1,2\n", column("gyro.x"))
    assert "2 columns are named 'v'" in refused


def test_a_name_cannot_be_found_without_a_header(tmp_path):
    assert "no header line" in refusal(tmp_path, "0,1\n0,2\n", TIME)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("0,1\n1,x\n", "line 3, column v: 'x' is not a number"),
        ("0,1\n1e30,2\n", "line 3, column t: 1e+30 cannot be time"),
        ("0,1\n1\n2,3\n", "line 3: 1 fields, but the lines before have 2"),
    ],
)
def test_a_bad_cell_is_named_with_line_and_column(tmp_path, rows, message):
    assert message in refusal(tmp_path, "t,v\n" + rows, column("gyro.x"))


def test_a_missing_map_is_one_line(tmp_path):
    with pytest.raises(RecordingError, match=r"map\.toml: cannot be read: No such file"):
        read_mapped_csv(tmp_path / "log.csv", tmp_path / "map.toml")


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40), st.sampled_from([1, -1]))
def test_any_column_of_numbers_comes_back_with_its_sign(tmp_path_factory, values, sign):
    folder = tmp_path_factory.mktemp("any")
    rows = "".join(f"{row * 0.002:.3f}\t{value!r}\n" for row, value in enumerate(values))
    mapping = column("gyro.z", unit="rad/s", extra=f"sign = {sign}\n")
    samples = read(folder, "t\tv\n" + rows, mapping).samples
    assert samples.gyro[:, 2].tolist() == (sign * np.array(values, np.float32)).tolist()


def test_the_documented_example_is_a_valid_map_that_reads_its_documented_log(tmp_path):
    text = (ROOT / "docs" / "formats.md").read_text()
    toml = re.search(r"```toml\n(.*?)```", text, re.DOTALL)[1]
    csv = re.search(r"```csv\n(t_ms.*?)```", text, re.DOTALL)[1]
    recording = read(tmp_path, csv, toml)
    assert load_column_map(tmp_path / "map.toml").time.unit == tomllib.loads(toml)["time"]["unit"]
    assert len(recording.samples) == csv.count("\n") - 1
    assert np.degrees(recording.samples.gyro[0, 0]) == pytest.approx(-12.5)


def a_nanobench_file(folder, drop=()):
    """Two rows with the header of NanoBench; a column's value is its place in the row."""
    mapping = load_column_map(NAMED["nanobench"])
    axes = [f"{kind}_{axis}" for kind in ("imu_acc", "imu_gyro") for axis in "xyz"]
    angles = [f"att_stateEstimate_{angle}" for angle in ("roll", "pitch", "yaw")]
    motors = [f"motor_motor_m{m}" for m in range(1, 5)]
    tables = [column for columns in mapping.tables.values() for column in columns]
    names = ["t", "roll", *axes, *angles, *motors, *tables, "pwr_pm_vbat"]
    names = [name for name in names if name not in drop]
    rows = [",".join(str(place + row) for place in range(len(names))) for row in (0, 1)]
    (folder / "flight.csv").write_text("\n".join([",".join(names), *rows]) + "\n")
    return folder / "flight.csv", names.index


def test_a_header_that_can_only_be_nanobench_is_recognised(tmp_path):
    path, place = a_nanobench_file(tmp_path)
    recording = read_csv(path)
    first = recording.samples[:1]
    assert first.duty[0, 3] == pytest.approx(place("motor_motor_m4") / 65535)
    assert first.accelerometer[0, 2] == pytest.approx(place("imu_acc_z") * STANDARD_GRAVITY)
    assert first.attitude[0, 1] == pytest.approx(-math.radians(place("att_stateEstimate_pitch")))
    assert recording.metadata["vehicle"] == {"profile": "crazyflie21"}
    by_name = read_mapped_csv(path, "nanobench")
    assert np.array_equal(by_name.samples.gyro, recording.samples.gyro)


def test_columns_that_are_no_channel_are_kept_as_tables_through_mcap(tmp_path):
    path, place = a_nanobench_file(tmp_path)
    write_mcap(read_csv(path), tmp_path / "flight.mcap")
    kept = open_recording(tmp_path / "flight.mcap").tables
    assert list(kept) == ["vicon", "setpoint", "controller"]
    column = kept["controller"].columns["pid_controller_yaw"]
    assert column.tolist() == [place("pid_controller_yaw"), place("pid_controller_yaw") + 1]


def test_a_header_that_lacks_a_column_is_read_for_what_it_has_and_names_no_craft(tmp_path):
    path, _ = a_nanobench_file(tmp_path, drop=["imu_gyro_z"])
    found = read_csv(path)
    assert np.isfinite(found.samples.gyro[:, :2]).all()
    assert np.isnan(found.samples.gyro[:, 2]).all()
    assert found.metadata["vehicle"]["family"] == "unknown"
    with pytest.raises(BadInputError, match=r"no column 'imu_gyro_z' \(gyro.z in .*nanobench"):
        read_mapped_csv(path, "nanobench")


@pytest.mark.parametrize("name", NAMED)
def test_every_map_that_ships_says_what_it_is_for_and_is_listed(name):
    assert load_column_map(NAMED[name]).title
    listed = CliRunner().invoke(app, ["convert", "--list-columns"])
    assert (listed.exit_code, name in listed.output) == (0, True)
