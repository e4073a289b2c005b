"""Files of every format cut, repeated, shuffled and with columns dropped: an answer or a line in
the program's own words, never those of Python or of a library.

``FUZZ_FILES`` says how many variants (a thousand); each is made anew from the name of its file and
its number, which a failure names.
"""

import contextlib
import io
import os
import re
import shutil
import sqlite3
import struct
import sys
import warnings
from collections import Counter
from pathlib import Path
from random import Random

import numpy as np
import pyarrow as pa
import pytest
import typer
from pyarrow import parquet

from groundstation.cli.app import app
from groundstation.errors import GroundStationError
from groundstation.page.reading import form_of, write
from groundstation.recording import csv_file
from groundstation.recording.csv_file import write_csv, write_table_csv
from groundstation.recording.formats import open_recording
from groundstation.recording.map_guess import columns_of
from groundstation.recording.mcap_file import write_mcap
from groundstation.recording.parquet_file import write_parquet
from groundstation.recording.session import Recording
from groundstation.recording.ulog_file import MAGIC
from support import RECORDINGS, ROOT
from support.foreign_logs import (
    FIXED,
    log_bytes,
    write_betaflight,
    write_cfclient,
    write_crazyswarm2,
    write_ros1,
    write_ros2,
    write_service_events,
    write_ulog,
)

COUNT = int(os.environ.get("FUZZ_FILES", "1000"))
FIRST = int(os.environ.get("FUZZ_FIRST", "0"))
"""Number of the first variant: where a longer run goes on."""
TOLD = 12
CONVERTED, FITTED, MAPPED, RECOVERED, ASKED, PLOTTED = 11, 97, 13, 17, 19, 7
"""One in so many variants is converted as well, fitted, read by a map, recovered, asked for its
columns, opened on the page."""


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    return small_files(tmp_path_factory.mktemp("sources")) | field_files()


def commands(number, file, folder):
    """What is done with a variant: looked at, and in turn the rest."""
    yield "inspect", file
    if number % ASKED == 0:
        yield "convert", file, "--map"
    if number % PLOTTED == 0:
        yield ("page",)
    if number % CONVERTED == 0:
        end = ("mcap", "csv", "parquet", "csv --physical")[number // CONVERTED % 4]
        name, *more = end.split()
        yield "convert", file, folder / f"made.{name}", *more
    if number % MAPPED == 0:
        columns = ("cfclient", "betaflight", "nanodrone", "px4", "ros2")[number // MAPPED % 5]
        yield "inspect", file, "--columns", columns, "--json"
    if number % RECOVERED == 0:
        yield "recover", file, "-o", folder / "recovered.mcap"
    if number % FITTED == 0:
        yield "fit", "body", file, "--vehicle", "crazyflie21", "-o", folder / "model.json"


def test_every_small_file_is_read_before_it_is_damaged(tmp_path):
    for name, path in small_files(tmp_path).items():
        said, wrong = answer("inspect", path)
        assert not wrong, name
        assert "verdict" in said or name in ("ours.parquet", "unknown.parquet"), (name, said)


def test_what_no_reader_expected_is_found_here_and_told_to_no_user(tmp_path, monkeypatch):
    def fail(path, **_):
        raise ValueError("zip() argument 2 is longer than argument 1")

    monkeypatch.setattr(csv_file, "read_csv", fail)
    (tmp_path / "log.csv").write_text("t,x\n1,2\n")
    said, wrong = answer("inspect", tmp_path / "log.csv")
    assert "a reader met what it did not expect: ValueError: zip()" in wrong
    assert "log.csv: no table that this program can read" in said
    assert "zip" not in said


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", [b"x", b"A"])
def test_a_ulog_that_ends_within_a_message_comes_to_an_end(kind, tmp_path):
    """pyulog 1.3 steps back to before such a message, for ever."""
    file = tmp_path / "log.ulg"
    file.write_bytes(MAGIC + b"\1" + bytes(8) + struct.pack("<H", 20000) + kind + b"abc")
    said, wrong = answer("inspect", file)
    assert not wrong
    assert "no known map fits its series" in said


@pytest.mark.timeout(300 + COUNT // 4)
@pytest.mark.filterwarnings("ignore::ResourceWarning")  # libraries leave files open
def test_no_damaged_file_is_answered_in_the_words_of_python(sources, tmp_path):
    names = sorted(sources)
    found, first = Counter(), {}
    for number in range(FIRST, FIRST + COUNT):
        name = names[number % len(names)]
        file = tmp_path / f"damaged{sources[name].suffix}"
        variant(sources[name], seeded(name, number), file)
        for words in commands(number, file, tmp_path):
            _, wrong = plotted(file) if words[0] == "page" else answer(*words)
            if wrong:
                kind = wrong.rpartition("(")[2] if "(" in wrong else wrong[:60]
                found[kind] += 1
                first.setdefault(kind, f"{name}, number {number}, {words[0]}: {wrong}")
        for made in tmp_path.iterdir():
            made.unlink()
    told = [f"{times} times, {first[kind]}" for kind, times in found.most_common(TOLD)]
    assert not told, "\n".join([f"{sum(found.values())} of {COUNT}", *told])


LARGEST = 200_000
"""Bytes of a field file that is taken whole; a longer one is cut at a line."""
_COMMAND = typer.main.get_command(app)
_PYTHON = re.compile(
    r"Traceback|(?-i:\b(?:Error|Warning): )|\b[A-Z]\w+(?:Error|Exception|Warning)\b"
    r"|NoneType|zip\(\)"
    r"|\boperands?\b|ndarray|dtype"
    r"|has no attribute|subscriptable|unhashable|invalid literal|could not convert|to unpack|codec"
    r"|out of bounds|index out of range|list index|broadcast|positional|<class|requires a buffer"
    r"|recursion|math domain|reshape|expected str|bytes-like|encountered in|Buffer>|\berrno\b"
    r"|thrift|\('[A-Za-z]",
    re.IGNORECASE,
)
"""What Python, numpy, struct and other libraries say of an error; ``warning:`` is ours."""


def variant(path, random, target):
    """Write to ``target`` what becomes of a file: one to three changes of it, by ``random``."""
    content = path.read_bytes()[:LARGEST]
    for _ in range(random.choice((1, 1, 2, 3))):
        content = _changed(content, random, target)
    target.write_bytes(content)


def _changed(content, random, scratch):
    structured = {
        b"PAR1": _change_parquet, b"SQLite f": _change_sqlite, b"PK\3\4": _change_npz,
    }  # fmt: skip
    if random.random() < 0.6:
        for magic, change in structured.items():
            if content.startswith(magic):
                with contextlib.suppress(Exception):  # damaged by the change before
                    return change(content, random, scratch)
        if content.startswith(b"ULog"):
            return _change_records(content, 16, struct.Struct("<HB"), random)
        if content.startswith(b"\x89MCAP"):
            return _change_records(content, 8, struct.Struct("<BQ"), random)
        if b"\0" not in content[:1000] and len(content) > 1:
            return _change_text(content, random)
    return _change_bytes(content, random)


def _range(size, random):
    """Some of ``size`` in a row: a few, or many."""
    first = random.randrange(size + 1)
    most = random.choice((1, 4, 1 + size // 50, 1 + size // 8, size))
    return first, min(size, first + random.randrange(most + 1))


def _change_bytes(content, random):
    size = len(content)
    first, last = _range(size, random)
    piece = content[first:last]
    kind = random.randrange(7)
    if kind == 0:
        return content[: max(last, random.choice((0, size - 9, size // 2)))]
    if kind == 1:
        return content[:first] + piece * 2 + content[last:]
    if kind == 2:
        return content[:first] + content[last:]
    if kind == 3:  # a block that moved
        at = random.randrange(size - len(piece) + 1)
        rest = content[:first] + content[last:]
        return rest[:at] + piece + rest[at:]
    if kind == 4:
        changed = bytearray(content)
        for _ in range(random.choice((1, 4, 50)) if size else 0):
            changed[random.randrange(size)] = random.choice((0, 255, 127, random.randrange(256)))
        return bytes(changed)
    if kind == 5:
        return content[:first] + bytes(min(len(piece), 64)) + content[first:]
    return content[:first] + random.randbytes(random.randrange(1, 40)) + content[last:]


_CELLS = (
    *("", "", "0", "-1", "1e5", "70000", "3.3", "nan", "nan", "inf", "-inf", "1e999", "-1e30"),
    *("abc", "1,5", '"', "0x1", " ", "99999999999", "1e-320", "2026-01-01 00:00:00", "true"),
    *("\x1b[2J", "µ"),
)


def _change_text(content, random):
    lines = content.decode("latin-1").split("\n")
    mark = max(",;\t", key=lines[len(lines) // 2].count)
    kind = random.randrange(14)
    first, last = _range(len(lines), random)
    if kind == 0:  # cut inside a line
        return content[: random.randrange(len(content) + 1)]
    if kind == 1:
        lines[last:last] = lines[first:last]
    elif kind == 2:
        del lines[first:last]
    elif kind == 3:
        middle = lines[first:last]
        random.shuffle(middle)
        lines[first:last] = middle
    elif kind == 4:
        lines[1:] = [one for one in lines[1:] if random.random() < 0.5]
    elif kind == 5:  # the header again, as where two logs were put together
        lines.insert(last, lines[0])
    elif kind == 6:
        del lines[0]
    elif kind == 7:
        return "\n".join(lines).encode(random.choice(("utf-16", "utf-8-sig", "utf-16-le")))
    elif kind == 8:
        return "\n".join(lines).replace(mark, random.choice(";\t, |")).encode("latin-1")
    elif kind == 9:
        for _ in range(random.choice((1, 5, 40))):
            at = random.randrange(len(lines))
            cells = lines[at].split(mark)
            cells[random.randrange(len(cells))] = random.choice(_CELLS)
            lines[at] = mark.join(cells)
    else:
        lines = _columns_changed([one.split(mark) for one in lines], mark, random)
    return "\n".join(lines).encode("utf-8")


def _columns_changed(cells, mark, random):
    """Columns dropped, doubled or exchanged, of all lines or of the header alone."""
    width = max(map(len, cells))
    kept = list(range(width))
    kind = random.randrange(5)
    if kind == 0:
        kept = [one for one in kept if random.random() < 0.7]
    elif kind == 1:
        random.shuffle(kept)
    elif kind == 2:
        kept.append(random.randrange(width))
    elif kind == 3:
        kept = kept[: random.randrange(width + 1)]
    else:
        kept.insert(0, width)  # a column without a name
    rows = [[row[one] if one < len(row) else "" for one in kept] for row in cells]
    header_alone = random.random() < 0.2
    return [mark.join(rows[0]), *(mark.join(row) for row in (cells if header_alone else rows)[1:])]


def _change_records(content, first, head, random):
    """Records of a log dropped, doubled or shuffled: each begins with its size and kind."""
    records, at = [], first
    while at + head.size <= len(content):
        values = head.unpack_from(content, at)
        size = head.size + (values[1] if head.size == 9 else values[0])
        records.append(content[at : at + size])
        at += size
    kind = random.randrange(5)
    if kind == 0:
        records = [one for one in records if random.random() < 0.9]
    elif kind == 1:
        random.shuffle(records)
    elif kind == 2 and records:
        start = random.randrange(len(records))
        records[start:start] = records[start : start + random.randrange(20)]
    elif kind == 3 and records:
        del records[random.randrange(len(records))]
    elif records:
        at = random.randrange(len(records))
        records[at] = _change_bytes(records[at], random)
    return content[:first] + b"".join(records)


def _change_parquet(content, random, scratch):
    table = parquet.read_table(io.BytesIO(content))
    kind = random.randrange(6)
    names = list(table.schema.names)
    if kind == 0:
        table = table.select([one for one in names if random.random() < 0.7])
    elif kind == 1:
        table = table.take(random.sample(range(len(table)), len(table)))
    elif kind == 2:
        table = pa.concat_tables([table, table.slice(0, random.randrange(len(table) + 1))])
    elif kind == 3:
        table = table.slice(0, random.choice((0, 1, 2, len(table) // 2)))
    elif kind == 4:
        random.shuffle(names)
        table = table.rename_columns(names)
    else:
        at, rows = random.randrange(len(names)), len(table)
        values = random.choice((
            pa.nulls(rows), pa.array(["x"] * rows), pa.array([True] * rows), pa.nulls(rows, "f8"),
            pa.array([[1.0]] * rows), pa.array([2**63] * rows, "u8"),
            pa.array([0] * rows, "date32"),
        ))  # fmt: skip
        table = table.set_column(at, names[at], values)
    out = io.BytesIO()
    parquet.write_table(table, out)
    return out.getvalue()


def _change_sqlite(content, random, scratch):
    scratch.write_bytes(content)
    statement = random.choice((
        "DELETE FROM messages WHERE id % 2", "DELETE FROM messages", "DELETE FROM topics",
        "DELETE FROM topics WHERE id = 1", "UPDATE messages SET timestamp = 0",
        "UPDATE messages SET timestamp = -timestamp", "UPDATE messages SET topic_id = 1",
        "UPDATE messages SET data = x'00010000'", "DROP TABLE messages", "DROP TABLE topics",
        "UPDATE topics SET type = 'std_msgs/msg/String'", "UPDATE topics SET name = 'x'",
        "UPDATE messages SET data = NULL", "UPDATE messages SET timestamp = 'x'",
    ))  # fmt: skip
    with contextlib.closing(sqlite3.connect(scratch)) as database:
        database.execute(statement)
        database.commit()
    return scratch.read_bytes()


def _change_npz(content, random, scratch):
    arrays = dict(np.load(io.BytesIO(content)))
    name = random.choice(sorted(arrays))
    kind = random.randrange(5)
    if kind == 0:
        del arrays[name]
    elif kind == 1:
        arrays[name] = arrays[name][..., : random.randrange(20)] if arrays[name].ndim else name
    elif kind == 2:
        arrays[name] = np.array(random.choice((np.nan, "x", 1e300)))
    elif kind == 3:
        order = random.sample(range(len(arrays["packets"])), len(arrays["packets"]))
        arrays["packets"] = arrays["packets"][order]
    else:
        return content + content
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def answer(*arguments):
    """What a user is shown of a command, and what went wrong with it: empty, or in words. Questions
    are answered by Enter."""
    words = [str(one) for one in arguments]
    return _judged(lambda: _COMMAND.main(words, "groundstation", standalone_mode=False))


def plotted(path):
    """The same of a file that is opened on the page: what it plots, and its form."""

    def open_on_page():
        write(open_recording(path), io.BytesIO())
        form_of(columns_of(path))

    return _judged(open_on_page)


def _judged(work):
    out = io.StringIO()
    stdin, sys.stdin = sys.stdin, io.StringIO("\n" * 60)
    try:
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(out),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("error")  # a warning is printed to the user as it is
            warnings.simplefilter("ignore", ResourceWarning)  # Python says nothing of it
            wrong = _run(work, out)
    finally:
        sys.stdin = stdin
    said = out.getvalue()
    python = "" if wrong else _PYTHON.search(said)
    return said, f"a library's words: {python[0]!r} in {said[-300:]!r}" if python else wrong


def _run(work, out):
    try:
        work()
    except GroundStationError as error:
        out.write(str(error))
        if _is_unexpected(error):
            return f"a reader met what it did not expect: {_cause(error.__cause__)}"
    except OSError as error:
        out.write(f"{error.filename}: {error.strerror}")
        if error.filename is None:
            return f"no file is named: {_cause(error)}"
    except Exception as error:
        return f"escaped: {_cause(error)}"
    return ""


def _is_unexpected(error):
    """Whether an error stands for one that no reader thought of (``formats._read``)."""
    last = error.__traceback__
    while last is not None and last.tb_next is not None:
        last = last.tb_next
    code = last.tb_frame.f_code
    return code.co_name == "_read" and code.co_filename.endswith("formats.py")


def _cause(error):
    """An error and where it was raised, the last place of ours first."""
    places, trace = [], error.__traceback__
    while trace is not None:
        code = trace.tb_frame.f_code
        places.append((Path(code.co_filename), code.co_name, trace.tb_lineno))
        trace = trace.tb_next
    ours = [one for one in places if "groundstation" in one[0].parts] or places
    where, name, line = ours[-1] if ours else (Path("nowhere"), "", 0)
    return f"{type(error).__name__}: {error} ({where.name}:{line} {name})"[:400]


def seeded(name, number):
    """The random numbers of one variant of a file."""
    return Random(f"{name} {number}")


FIELD = ROOT.parent / "shared" / "data" / "field"
"""Files as people have them, where this machine has them; a clone has none."""
ROWS = 120


def small_files(folder):
    """One small file of each format and each named map, by its name."""
    whole = open_recording(RECORDINGS / "stand_in_flight.mcap", raw=True)
    samples = whole.samples[4000 : 4000 + ROWS]
    flight = Recording(Path("flight"), "mcap", samples)
    write_csv(flight, folder / "thesis.csv")
    write_table_csv(flight, folder / "physical.csv")
    write_mcap(flight, folder / "ours.mcap")
    write_mcap(flight, folder / "ours_for_ros2.mcap", ros2_hz=100.0)
    write_parquet(flight, folder / "ours.parquet")
    write_cfclient(folder / "cfclient.csv", samples)
    write_betaflight(folder / "betaflight.csv", samples)
    write_betaflight(folder / "betaflight_pwm.csv", samples, pwm=True)
    write_ulog(folder / "px4.ulg", samples, parameters={"MAV_TYPE": 2, "CA_ROTOR_COUNT": 4})
    write_ulog(folder / "px4_old.ulg", samples, "actuator_outputs", dropouts_ms=(3, 9))
    write_ros1(folder / "ros1.bag", samples)
    write_service_events(folder / "service.mcap", samples)
    for name, write_bag in (
        ("ros2.mcap", lambda at: write_ros2(at, samples, "mcap")),
        ("ros2.db3", lambda at: write_ros2(at, samples, "sqlite3")),
        ("crazyswarm2.db3", lambda at: write_crazyswarm2(at, samples)),
    ):
        write_bag(folder / "bag")
        (file,) = (one for one in (folder / "bag").iterdir() if one.suffix != ".yaml")
        file.rename(folder / name)
        shutil.rmtree(folder / "bag")
    _write_tables(folder, samples)
    events = {FIXED: ("fixedFrequency", _microsd_variables())}
    rows = np.column_stack([np.degrees(samples.gyro), samples.accelerometer / 9.81, samples.duty])
    records = [
        (FIXED, 1000 * n, [*row[:6], *(int(65535 * one) for one in row[6:])])
        for n, row in enumerate(rows.tolist())
    ]
    for version in (1, 2):
        (folder / f"microsd_{version}").write_bytes(log_bytes(events, records, version))
    packets = whole.raw.packets[: 2 * ROWS]
    arrival_s = np.arange(len(packets)) * 0.002
    np.savez_compressed(folder / "stand_in.npz", packets=packets, arrival_s=arrival_s, vehicle="x")
    return {one.name: one for one in sorted(folder.iterdir())}


def field_files():
    """The field files of formats that are read, at most ``LARGEST`` bytes of each."""
    found = {}
    for path in sorted(FIELD.rglob("*")) if FIELD.is_dir() else ():
        names = (path.name.startswith("README"), path.suffix == ".py", "lfs" in path.parent.name)
        if path.is_file() and not any(names):
            found[str(path.relative_to(FIELD))] = path
    return found


def _microsd_variables():
    gyro, force = ({f"{name}.{axis}": "f" for axis in "xyz"} for name in ("gyro", "acc"))
    return gyro | force | {f"motor.m{n}": "H" for n in range(1, 5)}


def _write_tables(folder, samples):
    """CSV and Parquet of the maps that have no writer of their own."""
    columns = {
        **{f"w{axis}": samples.gyro[:, i] for i, axis in enumerate("xyz")},
        **{f"a{axis}_body": samples.accelerometer[:, i] for i, axis in enumerate("xyz")},
        **{f"m{m + 1}_rads": 1500.0 + 100.0 * samples.duty[:, m] for m in range(4)},
        **{"qw": np.ones(len(samples)), "qx": 0.01 * samples.gyro[:, 0]},
        **{"qy": 0.01 * samples.gyro[:, 1], "qz": np.zeros(len(samples))},
        **{
            "x": samples.time_s,
            "y": samples.time_s,
            "z": samples.time_s,
            "Vbat": samples.battery_v,
        },
    }
    timed = {"t": samples.time_s, **columns}
    stamped = {"timestamp": samples.time_s, **columns}
    unknown = {"Time (s)": samples.time_s, "rollspeed": samples.gyro[:, 0], "note": ["x"] * ROWS}
    for name, table in (("nanodrone", timed), ("crazyswarm2", stamped), ("unknown", unknown)):
        parquet.write_table(pa.table(table), folder / f"{name}.parquet")
        rows = zip(*(list(one) for one in table.values()), strict=True)
        lines = [",".join(table), *(",".join(map(str, row)) for row in rows)]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    _write_dates(folder, columns, samples.time_s)


def _write_dates(folder, columns, time_s):
    """Tables whose time is a date, a time of the day over midnight, or in two columns."""
    stamps = np.datetime64("2026-03-29T23:59:59.9", "ns") + (time_s * 1e9).astype("timedelta64[ns]")
    shown = np.datetime_as_string(stamps, unit="us")
    whole, rest = np.divmod(stamps.astype("int64"), 10**9)
    parquet.write_table(
        pa.table({**columns, "__index_level_0__": stamps}), folder / "dates.parquet"
    )
    for name, mark, times in (
        ("dates", "|", {"when": shown}),
        ("clock", ",", {"": [one[11:] for one in shown]}),
        ("stamps", " ", {"stamp.sec": whole, "stamp.nanosec": rest}),
    ):
        table = times | columns
        rows = zip(*(list(one) for one in table.values()), strict=True)
        lines = [mark.join(table), *(mark.join(map(str, row)) for row in rows)]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
