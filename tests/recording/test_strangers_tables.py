"""Tables as people have them: read as what they are, or refused with what is missing."""

import numpy as np
import pandas
import pytest
from typer.testing import CliRunner

from groundstation.cli.app import app
from groundstation.errors import BadInputError
from groundstation.paths import digest
from groundstation.recording.formats import open_for_analysis, open_recording
from groundstation.recording.map_guess import columns_of, guess_map
from groundstation.recording.quality import inspect_recording, rejected
from groundstation.recording.session import Rows

ROWS, HZ = 400, 100.0


def flight(seed=1, rows=ROWS):
    """What cfclient logs of a craft that sways: names and units of the firmware."""
    random = np.random.default_rng(seed)
    t = np.arange(rows) / HZ
    table = {"Timestamp": np.rint(t * 1000).astype(int)}
    for k, axis in enumerate("xyz"):
        table[f"gyro.{axis}"] = 30 * np.sin(3 * t + k + seed) + random.normal(0, 0.3, rows)
    for axis in "xyz":
        table[f"acc.{axis}"] = (axis == "z") + random.normal(0, 0.01, rows)
    for m in range(1, 5):
        table[f"pwm.m{m}_pwm"] = np.rint(37000 + 3000 * random.normal(0, 1, rows)).astype(int)
    table["pm.vbat"] = 3.9 - 0.001 * t + random.normal(0, 0.002, rows)
    for k, name in enumerate(("roll", "pitch", "yaw")):
        table[f"stateEstimate.{name}"] = 10 * seed + 5 * np.sin(3 * t + k)
    return pandas.DataFrame(table)


def saved(folder, table, name="flight.csv", **options):
    path = folder / name
    path.write_text(table.to_csv(index=options.pop("index", False), **options))
    return path


def verdict(path, **options):
    return inspect_recording(open_recording(path, **options))["verdict"]


def require_the_flight(path, rows=ROWS, hz=HZ, **options):
    recording = open_recording(path, **options)
    report = inspect_recording(recording)
    assert (report["samples"], report["period_s"]) == (rows, pytest.approx(1 / hz, rel=1e-4))
    assert report["ranges"]["gyro_x"]["max"] == pytest.approx(30, abs=1.5)
    return recording


# -- layouts ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("label", [None, "n"])
def test_the_index_that_pandas_writes_is_no_column(tmp_path, label):
    require_the_flight(saved(tmp_path, flight(), index=True, index_label=label))


def test_rows_that_end_in_a_comma_have_no_further_column(tmp_path):
    text = flight().to_csv(index=False)
    head, _, body = text.partition("\n")
    path = tmp_path / "flight.csv"
    path.write_text(head + "\n" + body.replace("\n", ",\n"))
    require_the_flight(path)
    path.write_text(text.replace("\n", ",\n"))
    require_the_flight(path)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_as_excel_writes_it_is_read(tmp_path, encoding):
    text = flight().to_csv(index=False, sep="\t", decimal=",")
    mark = "" if encoding == "utf-16" else "\ufeff"
    path = tmp_path / "flight.txt"
    path.write_bytes((mark + text).encode(encoding))
    require_the_flight(path)


def test_a_parquet_table_with_a_range_index_or_a_time_index_is_read(tmp_path):
    table = flight()
    table.index = pandas.RangeIndex(5, 5 + ROWS)
    table.to_parquet(tmp_path / "range.parquet", index=True)
    require_the_flight(tmp_path / "range.parquet")
    table.set_index("Timestamp").to_parquet(tmp_path / "time.parquet")
    require_the_flight(tmp_path / "time.parquet")


@pytest.mark.parametrize("shown", ["pipes", "spaces", "decimal commas", "aligned"])
def test_pipes_and_spaces_separate_columns(tmp_path, shown):
    text = flight().to_string(index=False)
    if shown != "aligned":
        decimal = "," if shown == "decimal commas" else "."
        text = flight().to_csv(index=False, sep="|" if shown == "pipes" else " ", decimal=decimal)
    path = tmp_path / "flight.txt"
    path.write_text(text)
    require_the_flight(path)


# -- time ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "scale"),
    [
        *(("t", 1e-3), ("time", 1e-3), ("Time (s)", 1e-3), ("TIME", 1.0), ("time_ms", 1.0)),
        *(("timestamp", 1e3), ("Timestamp_us", 1e3), ("timestamp", 1e6), ("elapsed", 1e-3)),
    ],
)
def test_a_time_column_goes_by_any_usual_name_and_its_numbers_tell_the_unit(tmp_path, name, scale):
    table = flight()
    table.insert(0, name, table.pop("Timestamp") * scale, allow_duplicates=False)
    require_the_flight(saved(tmp_path, table))


@pytest.mark.parametrize("hz", [5.0, 10.0, 50.0, 1000.0, 2000.0])
@pytest.mark.parametrize(
    ("name", "size"),
    [
        *(("Timestamp", 1e-3), ("time", 1.0), ("time_ms", 1e-3), ("Time (s)", 1.0)),
        *(("timestamp_us", 1e-6), ("timestamp", 1e-9), ("elapsed", 1e-6)),
    ],
)
def test_a_slow_or_fast_log_is_as_slow_or_fast_as_it_was(tmp_path, name, size, hz):
    """cfclient logs ten rows a second unless it is told otherwise."""
    table = timed(**{name: np.arange(ROWS) / (hz * size)})
    report = inspect_recording(open_recording(saved(tmp_path, table)))
    assert 1.0 / report["period_s"] == pytest.approx(hz, rel=1e-3)


@pytest.mark.parametrize(("name", "size"), [("Timestamp", 1e-3), ("time_ms", 1e-3), ("t_s", 1.0)])
def test_a_row_a_second_is_doubted_aloud(tmp_path, name, size):
    said = verdict(saved(tmp_path, timed(**{name: np.arange(ROWS) / size})))
    assert "1 samples a second, where telemetry of a flight has 20 to 10000" in said


def test_a_table_without_a_time_is_read_at_the_rate_that_is_said(tmp_path):
    table = flight().drop(columns="Timestamp")
    path = saved(tmp_path, table)
    with pytest.raises(BadInputError, match=r"no column is a time .*--rate HZ"):
        open_recording(path)
    recording = open_recording(path, rows=Rows(rate_hz=HZ))
    assert len(recording.samples) == ROWS
    assert np.diff(recording.samples.time_s) == pytest.approx(1 / HZ)
    (tmp_path / "map.toml").write_text(
        '[time]\nstep = 0.01\n[gyro.x]\ncolumn = "gyro.x"\nunit = "deg/s"\n'
    )
    mapped = open_recording(path, column_map=tmp_path / "map.toml")
    assert np.diff(mapped.samples.time_s) == pytest.approx(0.01)


def test_time_that_lost_its_digits_does_not_advance_and_is_bad(tmp_path):
    table = flight()
    table["Timestamp"] = 1_700_000_000_000.0
    said = verdict(saved(tmp_path, table, float_format="%.6g"))
    assert said.startswith("bad: time does not advance")
    found = CliRunner().invoke(app, ["inspect", str(tmp_path / "flight.csv")])
    assert found.exit_code != 0


def test_any_table_with_a_time_can_be_plotted_and_says_which_columns_it_has(tmp_path):
    t = np.arange(ROWS) / HZ
    table = pandas.DataFrame({"t": t, "alpha": np.sin(t), "label": "x", "beta": np.cos(t)})
    recording = open_recording(saved(tmp_path, table))
    assert list(recording.tables["columns"].columns) == ["alpha", "beta"]
    assert inspect_recording(recording)["verdict"].startswith(
        "bad: no channel has data: there are alpha, beta"
    )


STAMPS = pandas.Timestamp("2026-03-29 23:59:58.25") + pandas.to_timedelta(
    np.arange(ROWS) / HZ, unit="s"
)
"""Times of a flight over midnight."""


def timed(**columns):
    """The flight with other columns in its time's place."""
    table = flight().drop(columns="Timestamp")
    for name, values in reversed(columns.items()):
        table.insert(0, name, values)
    return table


@pytest.mark.parametrize(
    "shown",
    [
        *("%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%fZ", "%Y-%m-%dT%H:%M:%S.%f+02:00"),
        *("%H:%M:%S.%f", "%M:%S.%f", "%I:%M:%S.%f %p", "%d.%m.%Y %H:%M:%S.%f"),
        *("%m/%d/%Y %I:%M:%S.%f %p", "%Y/%m/%d/%H:%M:%S.%f"),
    ],
)
@pytest.mark.parametrize("name", ["Timestamp", "Time (ms)", "local"])
def test_dates_and_times_of_the_day_are_a_time(tmp_path, shown, name):
    table = timed(**{name: STAMPS.strftime(shown)})
    require_the_flight(saved(tmp_path, table))
    table.to_parquet(tmp_path / "flight.parquet")
    require_the_flight(tmp_path / "flight.parquet")


def test_a_date_that_is_no_time_of_a_flight_is_left_alone(tmp_path):
    import pyarrow
    from pyarrow import parquet

    table = pyarrow.Table.from_pandas(timed(Timestamp=STAMPS))
    for name, days in (("valid_until", 2_932_896), ("built", 20_000)):
        table = table.append_column(name, pyarrow.array([days] * ROWS, "date32"))
    parquet.write_table(table, tmp_path / "flight.parquet")
    require_the_flight(tmp_path / "flight.parquet")


@pytest.mark.parametrize("first", ["whole", "rest"])
@pytest.mark.parametrize(
    ("whole", "rest", "count"),
    [
        *(("sec", "nanosec", 10**9), ("header.stamp.secs", "header.stamp.nsecs", 10**9)),
        *(("s", "us", 10**6), ("tv_sec", "tv_usec", 10**6)),
    ],
)
def test_seconds_and_their_fraction_in_two_columns_are_one_time(
    tmp_path, whole, rest, count, first
):
    stamps = STAMPS.as_unit("ns").asi8
    columns = {whole: stamps // 10**9, rest: stamps % 10**9 // (10**9 // count)}
    order = list(columns) if first == "whole" else [rest, whole]
    table = timed(**{name: columns[name] for name in order})
    path = saved(tmp_path, table)
    require_the_flight(path)
    assert guess_map(columns_of(path).columns).channels["time"].column.name == whole
    table.to_parquet(tmp_path / "flight.parquet")
    require_the_flight(tmp_path / "flight.parquet")


@pytest.mark.parametrize(
    ("table", "index"),
    [
        (timed(Timestamp=STAMPS - STAMPS[0]), False),
        (timed(Date=STAMPS.strftime("%Y-%m-%d"), Time=STAMPS.strftime("%H:%M:%S.%f")), False),
        (timed().set_index(STAMPS), True),
    ],
    ids=["a duration", "a date beside its time of the day", "an index without a name"],
)
def test_a_time_as_pandas_keeps_it_is_read(tmp_path, table, index):
    require_the_flight(saved(tmp_path, table, index=index))
    table.to_parquet(tmp_path / "flight.parquet")
    require_the_flight(tmp_path / "flight.parquet")


def test_rows_with_a_date_and_without_a_header_are_mapped_by_number(tmp_path):
    path = saved(tmp_path, timed(t=STAMPS.astype(str)), header=False)
    axes = "".join(
        f'[gyro.{axis}]\ncolumn = {n}\nunit = "deg/s"\n' for n, axis in enumerate("xyz", 2)
    )
    (tmp_path / "map.toml").write_text("[time]\ncolumn = 1\n" + axes)
    require_the_flight(path, column_map=tmp_path / "map.toml")


def test_a_slow_log_with_dates_is_as_slow_as_they_say(tmp_path):
    table = timed(Timestamp=pandas.date_range("2026-01-01", periods=ROWS, freq="200ms").astype(str))
    assert inspect_recording(open_recording(saved(tmp_path, table)))["period_s"] == 0.2


def test_a_cell_that_is_no_date_is_named(tmp_path):
    table = timed(Timestamp=STAMPS.astype(str))
    table.loc[200, "Timestamp"] = "soon"
    with pytest.raises(BadInputError, match="line 202, column Timestamp: 'soon' is not a date"):
        open_recording(saved(tmp_path, table))


def test_times_of_whole_seconds_do_not_tell_when_a_row_was_taken(tmp_path):
    said = verdict(saved(tmp_path, timed(Timestamp=STAMPS.strftime("%H:%M:%S"))))
    assert said.startswith("bad: time does not advance")


# -- attitude --------------------------------------------------------------------------------------


@pytest.mark.parametrize("rest", [(1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)])
def test_a_quaternion_that_rests_does_not_replace_angles_that_move(tmp_path, rest):
    table = flight()
    for part, value in zip("wxyz", rest, strict=True):
        table[f"stateEstimate.q{part}"] = value
    path = saved(tmp_path, table)
    found = open_for_analysis(path).samples.attitude
    assert np.degrees(found[:, 0]) == pytest.approx(table["stateEstimate.roll"], abs=1e-3)
    guesses = guess_map(columns_of(path).columns).channels
    assert guesses["attitude.roll"].column.name == "stateEstimate.roll"
    assert not any(key.startswith("quaternion") for key in guesses)


# -- several crafts --------------------------------------------------------------------------------


def swarm(name="uri", values=("radio://0/80/2M/E7E7E7E701", "radio://0/80/2M/E7E7E7E702")):
    tables = []
    for seed, value in enumerate(values, start=1):
        one = flight(seed)
        one["Timestamp"] += 4 * (seed - 1)
        one.insert(1, name, value)
        tables.append(one)
    return pandas.concat(tables).sort_values("Timestamp", kind="stable")


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("uri", ("radio://0/80/2M/E7E7E7E701", "radio://0/80/2M/E7E7E7E702")),
        ("id", (0, 1, 2)),
        ("I", (0, 1)),
        ("drone", ("cf1", "cf2")),
        ("who_flies", ("anna", "bert")),
    ],
)
def test_rows_of_several_crafts_are_never_one_flight(tmp_path, name, values):
    table = swarm(name, values)
    path = saved(tmp_path, table)
    with pytest.raises(
        BadInputError, match=rf"column '{name}' takes turns between .*--only {name}="
    ):
        open_recording(path)
    table.to_parquet(tmp_path / "swarm.parquet")
    with pytest.raises(BadInputError, match=rf"column '{name}' takes turns"):
        open_recording(tmp_path / "swarm.parquet")
    for file in (path, tmp_path / "swarm.parquet"):
        one = open_recording(file, rows=Rows((name, str(values[1]))))
        assert len(one.samples) == ROWS
        assert np.degrees(one.samples.attitude[:, 0]).mean() == pytest.approx(20, abs=2)


def test_crafts_one_after_the_other_in_one_table_are_told_by_their_addresses(tmp_path):
    path = saved(tmp_path, swarm().sort_values(["uri", "Timestamp"]))
    with pytest.raises(BadInputError, match="column 'uri' takes turns"):
        open_recording(path)


def test_one_craft_of_a_table_becomes_a_file_by_the_command_that_the_refusal_names(tmp_path):
    path = saved(tmp_path, swarm("id", (0, 1)))
    new = tmp_path / "one.mcap"
    found = CliRunner().invoke(app, ["convert", str(path), str(new), "--only", "id=1"])
    assert found.exit_code == 0
    assert len(open_recording(new).samples) == ROWS
    with pytest.raises(BadInputError, match="the column has 0, 1"):
        open_recording(path, rows=Rows(("id", "7")))
    with pytest.raises(BadInputError, match="there is no column 'nobody'"):
        open_recording(path, rows=Rows(("nobody", "1")))


@pytest.mark.parametrize("crafts", [2, 3])
def test_a_state_that_jumps_from_row_to_row_is_a_fault(tmp_path, crafts):
    table = swarm("id", tuple(range(crafts))).drop(columns="id")
    assert "jumps back and forth from row to row" in verdict(saved(tmp_path, table))
    assert "jumps" not in verdict(saved(tmp_path, flight(), "one.csv"))


def test_modes_flags_and_counters_are_no_crafts(tmp_path):
    table = flight()
    rows = np.arange(ROWS)
    table["mode"] = np.where(rows < 200, "ANGLE", "ACRO")
    table["armed"] = (rows > 50).astype(int)
    table["id"] = rows
    table["state"] = np.where(rows // 60 % 2, "up", "down")
    require_the_flight(saved(tmp_path, table))


# -- motors ----------------------------------------------------------------------------------------


def test_the_duty_is_the_pwm_where_both_are_logged(tmp_path):
    table = flight()
    for m in range(1, 5):
        table[f"motor.m{m}"] = np.rint(0.9 * table[f"pwm.m{m}_pwm"]).astype(int)
    recording = open_recording(saved(tmp_path, table))
    assert recording.samples.duty[:, 0] * 65535 == pytest.approx(table["pwm.m1_pwm"], abs=0.01)
    (note,) = inspect_recording(recording)["notes"]
    assert "differ from pwm.m1_pwm" in note
    for m in range(1, 5):
        table[f"motor.m{m}"] = table[f"pwm.m{m}_pwm"]
    assert inspect_recording(open_recording(saved(tmp_path, table)))["notes"] == []


def test_of_motor_m1_alone_it_is_said_that_the_duty_is_not_known(tmp_path):
    table = flight().rename(columns={f"pwm.m{m}_pwm": f"motor.m{m}" for m in range(1, 5)})
    assert "the motors' duty is not known" in verdict(saved(tmp_path, table))


@pytest.mark.parametrize("end", ["physical.csv", "table.mcap", "packets.csv"])
def test_a_converted_file_still_says_that_the_duty_is_not_known(tmp_path, end):
    """In the file, or, where that cannot, at its writing."""
    table = flight()
    table.columns = [one.replace("pwm.m", "motor.m").replace("_pwm", "") for one in table.columns]
    made = tmp_path / end
    physical = ["--physical"] if end.startswith("physical") else []
    done = CliRunner().invoke(app, ["convert", str(saved(tmp_path, table)), str(made), *physical])
    assert done.exit_code == 0
    if end == "packets.csv":
        assert "the motors' duty is not known" in done.stderr
        return
    assert "the motors' duty is not known" in verdict(made)
    given = open_recording(tmp_path / "flight.csv").samples.duty
    assert open_recording(made).samples.duty == pytest.approx(given)
    (told,) = rejected(open_for_analysis(made))
    assert "constants may be 25 % off" in told


def long_flight(made):
    """Ten minutes in which the battery sags; made: motors' column of duty and volts."""
    random = np.random.default_rng(4)
    rows = 30_000
    t = np.arange(rows) / 50.0
    volts = 4.1 - 0.9 * t / t[-1] + 0.05 * np.sin(t / 7)
    smooth = np.convolve(random.normal(0, 1, rows + 200), np.ones(100) / 10, "same")[:rows]
    thrust_g = 9.0 + 0.5 * smooth
    duty = (thrust_g / 60) ** 0.6 * 5.2 / volts
    table = {"Timestamp": np.rint(t * 1000).astype(int), "pm.vbat": volts}
    for m in range(1, 5):
        table[f"motor.m{m}"] = np.rint(65535 * made(duty, volts)).astype(int)
    for k, axis in enumerate("xyz"):
        force = thrust_g / 9.0 if axis == "z" else 0.0
        table[f"acc.{axis}"] = force + random.normal(0, 0.02, rows)
        table[f"gyro.{axis}"] = 10 * np.sin(t + k)
    return pandas.DataFrame(table), duty


def test_a_long_flight_tells_duty_from_thrust_command_and_the_duty_is_computed(tmp_path):
    table, duty = long_flight(lambda duty, volts: duty)
    assert verdict(saved(tmp_path, table)).startswith("good")

    def command(duty, volts):
        return (0.088 - np.sqrt(0.088**2 - 4 * 0.0006239 * duty * volts)) / (2 * 0.0006239) / 60

    table, duty = long_flight(command)
    recording = open_recording(saved(tmp_path, table))
    report = inspect_recording(recording)
    assert report["verdict"].startswith("good")
    assert "are the thrust that was asked for" in report["notes"][0]
    assert recording.samples.duty[:, 0] == pytest.approx(duty, abs=2e-4)


@pytest.mark.parametrize("more", [2, 4])
def test_more_than_four_motors_that_move_are_no_quadrotors(tmp_path, more):
    table = flight()
    for m in range(5, 5 + more):
        table[f"pwm.m{m}_pwm"] = table["pwm.m1_pwm"].to_numpy()[::-1]
    recording = open_recording(saved(tmp_path, table))
    assert np.isnan(recording.samples.duty).all()
    assert f"not of a quadrotor ({4 + more} motors move" in inspect_recording(recording)["verdict"]
    table.to_parquet(tmp_path / "hexa.parquet")
    assert "not of a quadrotor" in verdict(tmp_path / "hexa.parquet")
    (tmp_path / "map.toml").write_text(
        'time = { column = "Timestamp", unit = "ms" }\n[tables]\nmore = ["acc.x"]\n'
        '[duty]\nm1 = { column = "pwm.m1_pwm", unit = "16-bit" }\n'
    )
    mapped = open_recording(tmp_path / "hexa.parquet", column_map=tmp_path / "map.toml")
    assert mapped.tables["more"].columns["acc.x"] == pytest.approx(table["acc.x"])


def test_outputs_that_idle_beside_four_motors_do_not_make_another_craft(tmp_path):
    table = flight()
    table["pwm.m5_pwm"] = 0
    table["pwm.m6_pwm"] = np.where(np.arange(ROWS) < 20, 0, 900)
    assert np.isfinite(open_recording(saved(tmp_path, table)).samples.duty).all()


def test_a_folder_has_a_fingerprint_that_changes_with_its_files(tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "a").write_text("1")
    first = digest(tmp_path / "bag")
    (tmp_path / "bag" / "b").write_text("2")
    second = digest(tmp_path / "bag")
    (tmp_path / "bag" / "b").rename(tmp_path / "bag" / "c")
    assert len({first, second, digest(tmp_path / "bag")}) == 3


def test_crafts_at_rates_of_their_own_are_a_fault_too(tmp_path):
    slow = flight(2).iloc[::2]
    slow["Timestamp"] += 3
    table = pandas.concat([flight(1), slow]).sort_values("Timestamp", kind="stable")
    assert "jumps back and forth" in verdict(saved(tmp_path, table))


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("mode", ("HOLD", "POS")),
        ("gyro_fresh", ("Y", "N")),
        ("I", (3, 4)),
        ("seq_id", tuple(range(50))),
        ("anchor_id", (0, 1, 2, 3)),
        ("flightModeFlags (flags)", ("ANGLE_MODE", "0")),
    ],
)
def test_what_takes_turns_while_one_craft_moves_smoothly_is_no_craft(tmp_path, name, values):
    table = flight()
    table[name] = [values[row % len(values)] for row in range(ROWS)]
    require_the_flight(saved(tmp_path, table))


@pytest.mark.parametrize("name", ["id", "name", "agent"])
def test_crafts_in_blocks_are_told_by_the_clock_that_begins_anew(tmp_path, name):
    table = pandas.concat([flight(1), flight(2)])
    table[name] = ["cf1"] * ROWS + ["cf2"] * ROWS
    with pytest.raises(BadInputError, match=f"column '{name}' takes turns between cf1, cf2"):
        open_recording(saved(tmp_path, table))


def test_a_fast_oscillation_that_the_gyro_shows_too_is_one_crafts(tmp_path):
    t = np.arange(1200) / 50.0
    table = flight(rows=1200)
    table["Timestamp"] = np.rint(t * 1000).astype(int)
    turn = 2 * np.pi * 16.7
    table["stateEstimate.roll"] = 3 * np.sin(turn * t)
    table["gyro.x"] = 3 * turn * np.cos(turn * t)
    assert "jumps" not in verdict(saved(tmp_path, table))


@pytest.mark.parametrize("word", ["NA", "N/A", "null", "None", "<NA>", "-", "1.#QNAN"])
def test_words_for_a_missing_value_are_missing_values(tmp_path, word):
    table = flight().astype(object)
    table.loc[3:5, "gyro.x"] = word
    recording = open_recording(saved(tmp_path, table))
    assert np.flatnonzero(np.isnan(recording.samples.gyro[:, 0])).tolist() == [3, 4, 5]


def test_a_row_without_a_time_is_left_out_and_counted(tmp_path):
    table = flight().astype(object)
    table.loc[[7, 90], "Timestamp"] = None
    recording = open_recording(saved(tmp_path, table))
    assert len(recording.samples) == ROWS - 2
    assert "2 rows without a time were left out" in inspect_recording(recording)["verdict"]


@pytest.mark.parametrize("per_ms", [1e-3, 1e3, 1e6])
def test_a_known_clock_in_another_unit_is_told_by_its_numbers(tmp_path, per_ms):
    table = flight()
    table["Timestamp"] = table["Timestamp"] * per_ms
    require_the_flight(saved(tmp_path, table))
