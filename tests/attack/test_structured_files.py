"""Files that are well formed and make no sense: an answer or one line, never a traceback."""

import math
import struct

import pyarrow
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyarrow.parquet import write_table

from groundstation.errors import GroundStationError
from groundstation.recording.csv_file import write_table_csv
from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_file import write_mcap
from groundstation.recording.quality import inspect_recording

TIMES = ["Timestamp", "time_s", "time (us)", "t", "timestamp", "# Timestamp", "Timestamp (s)"]
NAMES = [
    *("gyro.x", "gyro.y", "acc.z", "acc.z (g)", "motor.m1", "pm.vbat", "stateEstimate.qw", "note"),
    *("gyroADC[0] (deg/s)", "motor[3]", "loopIteration", "segment", "host_time_s", "debug", "qw"),
    *("duty_1", "gyro_x_deg_s", "battery_v", "stateEstimate.roll", "m1_rads", "m4_rads", "wx", ""),
]
CELLS = st.one_of(
    st.integers(-(2**70), 2**70).map(str),
    st.floats().map(repr),
    st.sampled_from(["", "nan", "inf", "-inf", "1,5", "1e400", "abc", '"a,b"', "deg/s", "0x1"]),
)
SMALL = st.integers(0, 40).map(str)
LINES = st.sampled_from(["# remark", '"key","value"', "ms,deg/s", "", ",,,", "sep=;", "a;b;c"])
QUICK = settings(max_examples=60, suppress_health_check=list(HealthCheck), deadline=None)


def answered(path, folder):
    """Read, judged and written again, or refused in one line that a reader of it thought of."""
    refusal = ""
    try:
        recording = open_recording(path, raw=True)
        report = inspect_recording(recording)
        if report["samples"]:
            for number, write in enumerate((write_mcap, write_table_csv)):
                write(recording, folder / f"made{number}")
    except GroundStationError as error:
        refusal = str(error)
    assert "\n" not in refusal
    assert "that this program can read" not in refusal, refusal


@QUICK
@given(st.data())
def test_any_table_of_text(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("csv")
    names = data.draw(st.lists(st.sampled_from(NAMES), min_size=1, max_size=8))
    names.insert(0, data.draw(st.sampled_from(TIMES)))
    cells = data.draw(st.sampled_from([CELLS, SMALL, st.one_of(SMALL, CELLS)]))
    mark = data.draw(st.sampled_from([",", ";", "\t"]))
    rows = data.draw(
        st.lists(st.lists(cells, min_size=len(names), max_size=len(names)), max_size=12)
    )
    before, below = (data.draw(st.lists(LINES, max_size=3)) for _ in range(2))
    text = [*before, mark.join(names), *below, *(mark.join(row) for row in rows)]
    path = folder / "log.csv"
    path.write_text("\n".join(text) + data.draw(st.sampled_from(["", "\n", "\n\n"])))
    answered(path, folder)


COLUMNS = st.one_of(
    st.lists(st.one_of(st.none(), st.floats()), min_size=5, max_size=5).map(pyarrow.array),
    st.lists(st.integers(-(2**63), 2**63 - 1), min_size=5, max_size=5).map(pyarrow.array),
    st.lists(st.text(max_size=3), min_size=5, max_size=5).map(pyarrow.array),
    st.lists(st.booleans(), min_size=5, max_size=5).map(pyarrow.array),
    st.lists(st.datetimes(), min_size=5, max_size=5).map(pyarrow.array),
    st.just(pyarrow.array([[1.0], [], [2.0], None, [3.0]])),
)


@QUICK
@given(st.data())
def test_any_table_of_parquet(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("parquet")
    names = ["t", "Timestamp", "wx", "qw", "qx", "m1_rads", "m4_rads", "gyro.x", "note"]
    chosen = data.draw(st.lists(st.sampled_from(names), min_size=1, unique=True))
    table = pyarrow.table({name: data.draw(COLUMNS) for name in chosen})
    write_table(table, folder / "log.parquet")
    answered(folder / "log.parquet", folder)


@QUICK
@given(st.data())
def test_any_log_of_px4(tmp_path_factory, data):
    """Topics of the right names with other fields, no rows, or none of the columns."""
    folder = tmp_path_factory.mktemp("ulog")

    def message(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), message("B", bytes(40))]
    topics = data.draw(
        st.lists(
            st.sampled_from(["sensor_combined", "vehicle_attitude", "battery_status", "other"]),
            unique=True,
        )
    )
    fields = data.draw(
        st.lists(
            st.sampled_from(["float[3] gyro_rad", "float x", "int32_t[4] q", "float[12] control"]),
            unique=True,
            max_size=3,
        )
    )
    width = {"float[3] gyro_rad": 12, "float x": 4, "int32_t[4] q": 16, "float[12] control": 48}
    text = ";".join(["uint64_t timestamp", *fields]) + ";"
    size = 8 + sum(width[one] for one in fields)
    out += [message("F", f"{name}:{text}".encode()) for name in topics]
    for number, name in enumerate(topics):
        out.append(message("A", struct.pack("<BH", 0, number) + name.encode()))
    for _ in range(data.draw(st.integers(0, 6)) if topics else 0):
        number = data.draw(st.integers(0, len(topics) - 1))
        body = data.draw(st.binary(min_size=size, max_size=size))
        out.append(message("D", struct.pack("<H", number) + body))
    value = data.draw(st.integers(-5, 30))
    key = b"int32_t MAV_TYPE"
    out.append(message("P", struct.pack("<B", len(key)) + key + struct.pack("<i", value)))
    path = folder / "log.ulg"
    path.write_bytes(b"".join(out))
    answered(path, folder)


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300, -1e30])
@pytest.mark.parametrize("name", ["gyro.x", "acc.z", "motor.m1", "pm.vbat", "stateEstimate.roll"])
def test_one_value_of_nonsense_in_a_channel(name, value, tmp_path):
    header = f"Timestamp,{name}"
    rows = [f"{2 * k},{value if k == 50 else 0.1 * (k % 7)}" for k in range(200)]
    (tmp_path / "log.csv").write_text("\n".join([header, *rows]) + "\n")
    answered(tmp_path / "log.csv", tmp_path)
