import resource
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.errors import BadInputError, RecordingError
from groundstation.recording import delimited
from groundstation.recording.csv_file import (
    THESIS_COLUMNS,
    read_csv,
    write_csv,
    write_table_csv,
)
from groundstation.recording.microsd import read_microsd
from groundstation.recording.session import Recording
from groundstation.telemetry.packet import TICK_S, decode
from groundstation.telemetry.samples import COLUMNS, RawBatch, empty_samples, packet_counts
from support import RECORDINGS
from support.fingerprints import mean_timestamp_step
from support.packets import packet_recording, packet_recordings

EXCERPT = RECORDINGS / "thesis_excerpt.csv"
HEADER = ",".join(THESIS_COLUMNS)
ROW = "17114118,3242,3376,3128,2968,3192,-445,693,-75,-329,3146,7707,-269,-559,-3136,1230000000"
NEXT = "17116093,3242,3400,3032,2896,3328,-156,332,-39,389,-2255,1421,-269,-559,-3136,1230000000"
GOLDEN = "0624aa0c308dc3988bc743feb502b5ffb7fe4a0c1b1ef3fed1fdc0f3804f5049"


def written(tmp_path, text, name="log.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def assert_same_counts(left, right):
    left, right = packet_counts(left), packet_counts(right)
    for name, values in left.items():
        assert np.array_equal(values, right[name]), name


def test_the_excerpt_survives_reading_and_writing_byte_for_byte(tmp_path):
    write_csv(read_csv(EXCERPT), tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == EXCERPT.read_bytes()


def test_a_row_becomes_its_packet():
    recording = read_csv(EXCERPT)
    assert recording.kind == recording.link == "csv"
    assert recording.raw is not None
    assert recording.raw.packets[0].tobytes().hex() == GOLDEN
    assert decode(recording.raw.packets)["timestamp"][-1] == 17161461 % 65536
    assert np.degrees(recording.samples.attitude[0]) == pytest.approx([-2.69, 5.59, -31.36])


@given(packet_recordings())
def test_any_packets_survive_the_thesis_s_layout(tmp_path_factory, recording):
    rows = np.unique(recording.samples.ticks, return_index=True)[1]
    recording.samples, recording.raw = (
        recording.samples[rows],
        RawBatch(recording.raw.packets[rows], recording.raw.host_time_ns[rows]),
    )
    path = tmp_path_factory.mktemp("any") / "any.csv"
    write_csv(recording, path)
    again = read_csv(path)
    assert_same_counts(recording.samples, again.samples)
    assert np.array_equal(again.raw.packets, recording.raw.packets)


@given(packet_recordings())
def test_any_packets_survive_physical_units(tmp_path_factory, recording):
    folder = tmp_path_factory.mktemp("any")
    recording.samples.ticks[:] %= 2**40  # 12 days: beyond, float seconds miss the nanosecond
    write_table_csv(recording, folder / "table.csv")
    table = read_csv(folder / "table.csv")
    write_csv(recording, folder / "direct.csv")
    write_csv(table, folder / "through.csv")
    assert (folder / "through.csv").read_text() == (folder / "direct.csv").read_text()


DRESSES = {
    "semicolons": lambda text: text.replace(",", ";"),
    "tabs": lambda text: text.replace(",", "\t"),
    "carriage returns": lambda text: text.replace("\n", "\r\n"),
    "byte-order mark": lambda text: "\ufeff" + text,
    "quotes": lambda text: '"' + text.strip().replace(",", '","').replace("\n", '"\n"') + '"\n',
    "Excel's sep line": lambda text: "sep=;\n" + text.replace(",", ";"),
    "blank lines": lambda text: "\n" + text.replace("\n", "\n\n"),
    "spaces": lambda text: text.replace(",", " , "),
    "no last line end": lambda text: text.rstrip("\n"),
    "lower case header": lambda text: text.replace(HEADER, HEADER.lower()),
    "separator at each end": lambda text: text.replace("\n", ",\n"),
    "separator at the rows' ends": lambda text: text.replace("\n", ",\n").replace("g,\n", "g\n"),
    "index column": lambda text: text.replace("\n17", "\n8517,17").replace("Time", "#,Time"),
    "index column without a name": lambda text: text.replace("\n17", "\n8517,17"),
    "index column with an empty name": lambda text: "," + text.replace("\n17", "\n0,17"),
    "figures with a point": lambda text: text.replace(",3242,", ",3242.0,"),
    "exponents": lambda text: text.replace("1230000000", "1.23E+09"),
    "unquoted decimal comma": lambda text: text.replace("1230000000", "1,23E+09"),
    "quoted decimal comma": lambda text: text.replace("1230000000", '"1,23E+09"'),
    "index and decimal comma": lambda text: text.replace("\n17", "\n8517,17").replace(
        "1230000000", "1,23E+09"
    ),
    "semicolons and decimal comma": lambda text: text.replace(",", ";").replace(
        "1230000000", "1,23E+09"
    ),
    "the thesis's own spreadsheet": lambda text: (
        "1\t"
        + text.replace(",", "\t").replace("\n17", "\n8517\t17").replace("230000000", ",23E+09")
    ),
}


@pytest.mark.parametrize("dress", DRESSES)
def test_the_same_integers_in_every_dress_a_spreadsheet_gives_them(tmp_path, dress):
    path = written(tmp_path, DRESSES[dress](EXCERPT.read_text()))
    assert_same_counts(read_csv(path).samples, read_csv(EXCERPT).samples)


def test_columns_are_found_by_name_in_any_order(tmp_path):
    rows = [line.split(",") for line in EXCERPT.read_text().splitlines()]
    turned = "\n".join(
        ",".join(["extra" if n == 0 else "x", *reversed(row)]) for n, row in enumerate(rows)
    )
    assert_same_counts(read_csv(written(tmp_path, turned)).samples, read_csv(EXCERPT).samples)


def test_one_row_with_an_exponent_among_plain_ones(tmp_path):
    text = f"{HEADER}\n{ROW}\n{NEXT[:-10]}1,23E+09\n"
    assert read_csv(written(tmp_path, text)).samples.debug.tolist() == [1230000000] * 2


def test_a_timestamp_that_runs_backwards_starts_a_segment_and_host_time_goes_on(tmp_path):
    early = ROW.replace("17114118", "500")
    recording = read_csv(written(tmp_path, f"{HEADER}\n{ROW}\n{NEXT}\n{early}\n{NEXT}\n"))
    samples = recording.samples
    assert samples.segment.tolist() == [0, 0, 1, 1]
    steps_s = np.diff(samples.host_time_ns) * 1e-9
    assert steps_s == pytest.approx([1975 * TICK_S, 2.0, (17116093 - 500) * TICK_S])
    assert np.array_equal(recording.raw.host_time_ns, samples.host_time_ns)
    assert recording.metadata["host_time"] == {"source": "made from device time"}


def test_values_beyond_the_packet_are_samples_without_packets(tmp_path):
    recording = read_csv(written(tmp_path, f"{HEADER}\n{ROW.replace('-445', '-40000')}\n"))
    assert recording.raw is None
    assert np.degrees(recording.samples.gyro[0, 0]) == pytest.approx(-40000 / 16.384)
    write_csv(recording, tmp_path / "again.csv")
    assert ",-40000," in (tmp_path / "again.csv").read_text()


FAULTS = {
    "a word": (ROW.replace("693", "abc"), r"line 3, column GyroY: 'abc' is not a number"),
    "an empty cell": (ROW.replace("693", ""), r"line 3, column GyroY: the cell is empty"),
    "a fraction": (ROW.replace("693", "69.3"), r"line 3, column GyroY: 69.3 is not a whole number"),
    "not a number": (ROW.replace("693", "nan"), r"line 3, column GyroY: nan is not a whole number"),
    "infinity": (ROW.replace("693", "inf"), r"line 3, column GyroY: inf is not a whole number"),
    "a debug below zero": (
        ROW[:-10] + "-1",
        r"line 3, column Debug: -1 is outside 0\.\.4294967295",
    ),
    "a huge gyro": (ROW.replace("693", "9" * 15), r"line 3, column GyroY: 9+ is outside"),
    "a huger gyro": (ROW.replace("693", "9" * 30), r"line 3, column GyroY: 1e\+30 is not a whole"),
    "a field too few": (ROW.replace("693,", ""), r"line 3: 15 fields, .* have 16"),
    "a field too many": (ROW.replace("693", "6,93"), r"line 3: 17 fields, .* have 16"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_bad_cell_is_named_with_line_and_column(tmp_path, fault):
    row, message = FAULTS[fault]
    path = written(tmp_path, f"{HEADER}\n{NEXT}\n{row}\n{NEXT}\n")
    with pytest.raises(BadInputError, match=message) as caught:
        read_csv(path)
    assert str(caught.value).startswith(f"{path}, line 3")
    assert "\n" not in str(caught.value)


def test_the_line_number_counts_blank_lines_and_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr(delimited, "BLOCK_BYTES", 500)
    rows = [NEXT] * 40
    rows[29] = NEXT.replace("3242", "3242x")
    path = written(tmp_path, "\n" + HEADER + "\n\n" + "\n".join(rows) + "\n")
    with pytest.raises(BadInputError, match="line 33, column Battery: '3242x'"):
        read_csv(path)


def test_rows_split_over_blocks_are_whole(tmp_path, monkeypatch):
    whole = read_csv(EXCERPT).samples
    for size in (1, 7, 90, 1000):
        monkeypatch.setattr(delimited, "BLOCK_BYTES", size)
        assert_same_counts(read_csv(EXCERPT).samples, whole)


@given(st.data())
def test_a_torn_file_keeps_every_whole_row(tmp_path_factory, data):
    text = EXCERPT.read_bytes()
    first = text.index(b"\n") + 1
    cut = data.draw(st.integers(first, len(text)))
    path = tmp_path_factory.mktemp("torn") / "torn.csv"
    path.write_bytes(text[:cut])
    recording = read_csv(path)
    whole = text[:cut].count(b"\n") - 1
    # A line that lost only figures of its last number cannot be told from a whole one.
    assert len(recording.samples) in (whole, whole + 1)
    assert np.array_equal(recording.samples.ticks[:whole], read_csv(EXCERPT).samples.ticks[:whole])
    if len(recording.samples) == whole and text[cut - 1 : cut] != b"\n":
        assert "torn" in recording.damage[0]


def test_a_tail_of_zero_bytes_is_damage_not_data(tmp_path):
    recording = read_csv(written(tmp_path, f"{HEADER}\n{ROW}\n".encode() + bytes(4096)))
    assert len(recording.samples) == 1
    assert "torn" in recording.damage[0]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (b"\n \r\n", "the file is empty"),
        ((HEADER + "\n").encode("utf-16")[:-1], "UTF-16"),
        (bytes(range(256)) * 4, "not a text file"),
        (b"wx,wy,wz\n1,2,3\n", "no column is a time .*--rate HZ.*--map"),
        (f"{HEADER.replace('GyroY,', '')}\n".encode(), "no column GyroY"),
    ],
)
def test_a_file_that_is_no_such_table_is_refused_in_one_line(tmp_path, content, message):
    with pytest.raises(BadInputError, match=message) as caught:
        read_csv(written(tmp_path, content))
    assert "\n" not in str(caught.value)


def test_a_header_alone_is_an_empty_recording(tmp_path):
    recording = read_csv(written(tmp_path, HEADER + "\n"))
    assert len(recording.samples) == 0
    write_csv(recording, tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_text() == HEADER + "\n"


@pytest.mark.parametrize("write", [write_csv, write_table_csv])
def test_an_existing_file_is_never_overwritten(tmp_path, write):
    path = written(tmp_path, "precious")
    with pytest.raises(BadInputError, match="exists already"):
        write(read_csv(EXCERPT), path)
    assert path.read_text() == "precious"


@pytest.mark.parametrize("write", [write_csv, write_table_csv])
def test_a_folder_that_is_not_there_is_one_line(tmp_path, write):
    with pytest.raises(RecordingError, match="cannot be written: No such file"):
        write(read_csv(EXCERPT), tmp_path / "nowhere" / "log.csv")


@pytest.mark.parametrize("write", [write_csv, write_table_csv])
def test_a_disk_that_takes_no_more_is_one_line_and_leaves_no_half_file(tmp_path, write):
    recording = packet_recording(np.arange(3000) * 1973)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
    try:
        with pytest.raises(RecordingError, match=r"log\.csv: cannot be written: File too large"):
            write(recording, tmp_path / "log.csv")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []


def test_the_table_says_its_units_and_leaves_out_what_is_not_there(tmp_path):
    write_table_csv(read_csv(EXCERPT), tmp_path / "table.csv")
    header, first = (tmp_path / "table.csv").read_text().splitlines()[:2]
    row = dict(zip(header.split(","), map(float, first.split(",")), strict=True))
    assert list(row) == [
        *("time_s", "segment", "host_time_s", "battery_v", "duty_1", "duty_2", "duty_3", "duty_4"),
        *("gyro_x_deg_s", "gyro_y_deg_s", "gyro_z_deg_s"),
        *("accelerometer_x_g", "accelerometer_y_g", "accelerometer_z_g"),
        *("roll_deg", "pitch_deg", "yaw_deg", "debug"),
    ]
    assert row["time_s"] == pytest.approx(17.351814083)
    assert row["gyro_y_deg_s"] == pytest.approx(42.297363)
    assert row["accelerometer_z_g"] == pytest.approx(7707 / 4096)
    assert row["pitch_deg"] == pytest.approx(5.59)


def test_a_microsd_log_survives_the_table_sample_by_sample(tmp_path):
    samples = read_microsd(RECORDINGS / "microsd_log16").samples[:3000]
    samples.gyro[5, 1] = np.nan
    samples.host_time_ns[:] += 1_700_000_000_000_000_000
    samples.segment[2000:] = 1
    samples.rotor_rev_s[:] = np.linspace(0, 300, 12000, dtype=np.float32).reshape(3000, 4)
    write_table_csv(Recording(Path("x"), "microsd", samples), tmp_path / "table.csv")
    again = read_csv(tmp_path / "table.csv").samples
    assert np.array_equal(np.rint(again.time_s * 1e6), samples.ticks)
    assert np.abs(again.host_time_ns - samples.host_time_ns).max() < 1000
    for name in set(COLUMNS) - {"ticks", "host_time_ns"}:
        assert np.array_equal(
            getattr(again, name), getattr(samples, name), equal_nan=name != "segment"
        ), name


def test_a_table_needs_only_its_time(tmp_path):
    recording = read_csv(written(tmp_path, "time_s;gyro_z_deg_s\n0,5;90\n0,502;\n0,1;-90\n"))
    samples = recording.samples
    assert samples.time_s == pytest.approx([0.5, 0.502, 0.1])
    assert samples.segment.tolist() == [0, 0, 1]
    assert np.degrees(samples.gyro[:, 2]) == pytest.approx([90, np.nan, -90], nan_ok=True)
    assert np.isnan(samples.gyro[:, 0]).all()
    assert recording.raw is None


def test_a_table_without_a_time_in_a_row_names_the_cell(tmp_path):
    with pytest.raises(BadInputError, match="line 3, column time_s: nan is outside"):
        read_csv(written(tmp_path, "time_s,gyro_z_deg_s\n1,2\n,3\n4,5\n"))


def test_another_clock_is_written_in_packet_ticks(tmp_path):
    samples = empty_samples(200, tick_s=1e-6)
    samples.ticks[:] = 5_000_000 + np.arange(200) * 2000
    write_csv(Recording(Path("x"), "microsd", samples), tmp_path / "log.csv")
    again = read_csv(tmp_path / "log.csv").samples
    assert again.time_s == pytest.approx(samples.time_s, abs=TICK_S / 2)
    assert mean_timestamp_step(packet_counts(again)) == pytest.approx(1972.6, abs=0.01)


@pytest.mark.parametrize("value", [1e30, -1e30, np.inf])
def test_a_value_beyond_all_counts_is_written_as_their_limit(value, tmp_path):
    recording = packet_recording(np.arange(20) * 1973)
    recording.samples.gyro[3, 0] = value
    write_csv(recording, tmp_path / "log.csv")
    written = read_csv(tmp_path / "log.csv").samples.gyro[3, 0]
    assert np.sign(written) == np.sign(value)
    assert abs(written) > 1e6


def test_reading_holds_little_more_than_the_recording(tmp_path, monkeypatch):
    """The text is taken in blocks: memory follows the samples, not the file."""
    monkeypatch.setattr(delimited, "BLOCK_BYTES", 1 << 16)
    recording = packet_recording(np.arange(40_000) * 1973)
    write_csv(recording, tmp_path / "log.csv")
    kept = sum(getattr(recording.samples, name).nbytes for name in COLUMNS)
    kept += recording.raw.packets.nbytes + recording.raw.host_time_ns.nbytes
    tracemalloc.start()
    try:
        read_csv(tmp_path / "log.csv")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 3.5 * kept


def test_a_table_with_both_settings_of_each_row_keeps_its_motors(tmp_path):
    samples = read_csv(EXCERPT).samples
    random = np.random.default_rng(2)
    samples.duty[:] = random.uniform(0.3, 0.6, samples.duty.shape)
    samples.duty_step[:] = random.uniform(-0.1, 0.1, samples.duty.shape)
    write_table_csv(Recording(EXCERPT, "csv", samples), tmp_path / "table.csv")
    again = read_csv(tmp_path / "table.csv")
    np.testing.assert_allclose(again.samples.duty, samples.duty, rtol=1e-6)
    np.testing.assert_allclose(again.samples.duty_step, samples.duty_step, rtol=1e-6)
