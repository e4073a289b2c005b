"""Small files of every format that is read, and those of ``shared/data/field`` where they are."""

import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from groundstation.recording.csv_file import write_csv, write_table_csv
from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_file import write_mcap
from groundstation.recording.parquet_file import write_parquet
from groundstation.recording.session import Recording
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
