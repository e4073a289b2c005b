"""What stands before, in and below the header of a delimited file."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.recording.column_map import read_mapped_csv
from groundstation.recording.delimited import base_name, open_table
from groundstation.recording.formats import open_recording

HEADER = "Timestamp,gyro.x,gyro.y,gyro.z,acc.z"
ROWS = [f"{2 * k},{k % 7},{-k % 5},{k % 3},0.98" for k in range(40)]
REMARK = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=30)


def written(path, *lines):
    path.write_text("\n".join(lines) + "\n")
    return path


def gyro(path, **options):
    return np.degrees(open_recording(path, **options).samples.gyro)


@given(st.lists(st.tuples(st.sampled_from(["#", "%", "//", "# "]), REMARK), max_size=5))
def test_remarks_before_the_header_are_passed_over(tmp_path_factory, remarks):
    path = tmp_path_factory.mktemp("a") / "log.csv"
    written(path, *(mark + text for mark, text in remarks), HEADER, *ROWS)
    table = open_table(path)
    assert table.names == HEADER.split(",")
    assert len(gyro(path)) == len(ROWS)


@given(st.lists(st.tuples(st.from_regex(r"[a-zA-Z_]{1,9}", fullmatch=True), st.integers())))
def test_keys_and_values_before_the_header_are_kept(tmp_path_factory, pairs):
    path = tmp_path_factory.mktemp("a") / "log.csv"
    written(path, *(f'"{key}","{value}"' for key, value in pairs), HEADER, *ROWS)
    table = open_table(path)
    assert table.names == HEADER.split(",")
    assert table.said == {key: str(value) for key, value in pairs}


@pytest.mark.parametrize(
    "lines",
    [
        ["# " + HEADER],
        ["# flight 3", "#" + HEADER],
        ["%" + HEADER],
        [HEADER, "ms,deg/s,deg/s,deg/s,g"],
        [HEADER, "(ms),(deg/s),(deg/s),(deg/s),(g)"],
        [HEADER, "int,float,float,float,float", "ms,deg/s,deg/s,deg/s,g"],
        ["flight 3 of craft 2, props new", "", HEADER],
    ],
)
def test_headers_as_loggers_write_them(lines, tmp_path):
    plain = gyro(written(tmp_path / "plain.csv", HEADER, *ROWS))
    assert np.array_equal(gyro(written(tmp_path / "log.csv", *lines, *ROWS)), plain)


@pytest.mark.parametrize("unit", ["rad/s", "[rad/s]", "rad/sec"])
def test_a_unit_that_the_file_says_holds_for_a_map_that_ships(unit, tmp_path):
    plain = gyro(written(tmp_path / "plain.csv", HEADER, *ROWS))
    said = f"ms,{unit},{unit},{unit},g"
    found = gyro(written(tmp_path / "log.csv", HEADER, said, *ROWS))
    assert found == pytest.approx(np.degrees(plain), rel=1e-5)


@pytest.mark.parametrize(
    ("header", "factor"),
    [("w (deg/s)", 1.0), ("w [rad/s]", 180 / np.pi), ("w", 1.0), ("w (dps)", 1.0)],
)
def test_a_name_without_its_unit_is_found_and_the_header_says_the_unit(header, factor, tmp_path):
    path = written(tmp_path / "log.csv", f"t (ms),{header},a,b,c", *ROWS)
    (tmp_path / "map.toml").write_text(
        'time = { column = "t", unit = "s" }\ngyro.x = { column = "w", unit = "deg/s" }\n'
    )
    samples = read_mapped_csv(path, tmp_path / "map.toml").samples
    assert np.degrees(samples.gyro[:7, 0]) == pytest.approx(factor * np.arange(7), rel=1e-5)
    assert samples.time_s[-1] == pytest.approx(0.078)


def test_a_map_skips_lines_and_scales(tmp_path):
    lines = ["1,2,3,4,5", "Timestamp,2,3,4,5", HEADER, *ROWS]
    path = written(tmp_path / "log.csv", *lines)
    (tmp_path / "map.toml").write_text(
        'skip = 2\ntime = { column = "Timestamp", unit = "ms" }\n'
        'gyro.x = { column = "gyro.x", unit = "deg/s", scale = 0.1, sign = -1 }\n'
    )
    samples = read_mapped_csv(path, tmp_path / "map.toml").samples
    assert np.degrees(samples.gyro[:7, 0]) == pytest.approx(-0.1 * np.arange(7), rel=1e-5)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("gyroADC[0] (deg/s)", ("gyroADC[0]", "deg/s")),
        ("gyroADC[0]", ("gyroADC[0]", "")),
        ("pwm front (raw)", ("pwm front (raw)", "")),
        ("time (µs)", ("time", "us")),
        ("acc [m/s²]", ("acc", "m/s^2")),
    ],
)
def test_a_unit_is_told_from_a_part_of_the_name(name, expected):
    assert base_name(name) == expected
