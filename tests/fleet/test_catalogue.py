"""The catalogue follows its files, through whatever interrupts it."""

import os
import random
import shutil
import sys
from pathlib import Path

import pytest

from groundstation.errors import BadInputError, RecordingError, TakenError
from groundstation.fleet.engine import PART_ROWS, Parts, gathered, held
from groundstation.fleet.fit import fit_flight
from groundstation.fleet.index import COLUMNS as FACTS
from groundstation.fleet.index import (
    KEY,
    _craft,
    _deadly,
    addresses_of,
    facts_of,
    index,
    recordings_of,
    usable,
)
from groundstation.identification.estimate import silent
from support.daemons import in_process, require_failure
from support.programs import run_program

RECORDINGS = Path(__file__).parents[2] / "recordings"
COLUMNS = {"name": "text", "value": "number", "words": "texts"}


@pytest.fixture
def table(tmp_path):
    return Parts(tmp_path / "table", COLUMNS, "name")


def row(name, value=1.0):
    return {"name": name, "value": value, "words": [name, name]}


def files(tmp_path):
    return sorted((tmp_path / "table").iterdir())


def test_the_newest_row_of_a_key_counts_also_when_rows_are_put_together(table, tmp_path):
    table.append([row("b"), row("a")])
    table.append([row("a", None), row("c")])
    expected = {"a": row("a", None), "b": row("b"), "c": row("c")}
    assert table.rows() == expected
    table.compact()
    assert table.rows() == expected
    assert len(files(tmp_path)) == 1
    table.compact(["c", "a", "not there"])
    assert list(table.rows()) == ["a", "c"]


def test_a_table_of_many_rows_is_several_files(table, tmp_path):
    table.append([row(f"{i:06d}") for i in range(PART_ROWS)])
    table.append([row(f"{i:06d}") for i in range(PART_ROWS, PART_ROWS + 5)])
    table.compact()
    assert len(files(tmp_path)) == 2
    assert len(table.rows()) == PART_ROWS + 5


def test_what_was_begun_and_not_finished_does_not_count(table, tmp_path):
    table.append([row("a")])
    (tmp_path / "table" / "00000001.new").write_bytes(b"half")
    assert list(table.rows()) == ["a"]
    table.append([row("b")])
    assert list(table.rows()) == ["a", "b"]


def test_a_table_that_is_as_it_should_be_is_not_written_again(table, tmp_path):
    for first in range(0, 3 * PART_ROWS, PART_ROWS):
        table.append([row(f"{i:06d}") for i in range(first, first + PART_ROWS)])
    before = {path: path.stat().st_mtime_ns for path in files(tmp_path)}
    table.compact(list(table.rows(())))
    assert {path: path.stat().st_mtime_ns for path in files(tmp_path)} == before


def test_columns_that_are_not_asked_for_are_not_read(table):
    table.append([row("a"), row("b", 2.0)])
    assert table.rows(["value"]) == {
        "a": {"name": "a", "value": 1.0},
        "b": {"name": "b", "value": 2.0},
    }


def test_a_table_of_an_older_version_has_the_new_columns_empty(table, tmp_path):
    Parts(tmp_path / "table", {"name": "text", "value": "number"}, "name").append(
        [{"name": "a", "value": 1.0}]
    )
    table.append([row("b")])
    table.compact(["a", "b"])
    assert table.rows() == {"a": row("a") | {"words": None}, "b": row("b")}


def test_two_runs_do_not_change_one_catalogue(tmp_path):
    with (
        held(tmp_path / "fleet"),
        pytest.raises(TakenError, match="another run is working"),
        held(tmp_path / "fleet"),
    ):
        pass
    with held(tmp_path / "fleet"):
        pass


def test_a_full_disk_keeps_what_had_arrived_and_the_next_run_does_the_rest(small_disk):
    disk = small_disk("2m")
    (disk / "something_else").write_bytes(bytes(1_700_000))
    table = Parts(disk / "table", COLUMNS, "name")
    done = []

    def work(name):
        done.append(name)
        return {**row(name), "words": [random.Random(name).randbytes(16_000).hex()]}

    def run():
        tasks = [f"{k}" for k in range(10, 50) if f"{k}" not in table.rows()]
        how = {"at_once": 5, "doing": "", "workers": 1, "scheduler": None, "progress": silent}
        return list(gathered(table, work, tasks, row, **how))

    with pytest.raises(RecordingError, match="written: No space left on device; what came befor"):
        run()
    kept = list(table.rows())
    assert kept == done[: len(kept)]
    assert 0 < len(done) - len(kept) <= 5
    assert all(path.suffix == ".parquet" for path in (disk / "table").iterdir())
    with pytest.raises(RecordingError, match="No space left"):
        table.compact()
    assert list(table.rows()) == kept
    (disk / "something_else").unlink()
    assert len(run()) == 40 - len(kept)
    table.compact()
    assert table.rows() == {name: work(name) for name in map(str, range(10, 50))}


def test_a_catalogue_on_a_full_disk_is_one_line(small_disk, flights):
    disk = small_disk("64k")
    (disk / "something_else").write_bytes(bytes(60 * 1024))
    words = ("fleet", "index", flights, "-o", disk / "fleet", "--workers", "1")
    assert "No space left" in require_failure(in_process(*words))
    (disk / "something_else").unlink()
    assert "2 read, 0 unchanged" in in_process(*words).stdout


@pytest.fixture
def flights(tmp_path):
    folder = tmp_path / "flights" / "cf07"
    folder.mkdir(parents=True)
    shutil.copy(RECORDINGS / "stand_in_flight.mcap", folder / "2026-02-01T10-00-00Z_one.mcap")
    (folder / "torn.mcap").write_bytes(b"\x89MCAP0\r\n and nothing else")
    return folder


def test_every_recording_is_read_once_and_again_when_it_changed(flights, tmp_path):
    catalogue = tmp_path / "fleet"
    first = index(catalogue, [str(flights.parent)], workers=1)
    assert (first.read, first.unchanged, first.damaged, first.gone) == (2, 0, 1, 0)
    good, torn = recordings_of(catalogue)
    assert (good["craft"], good["state"], good["begun"][:10]) == ("cf07", "good", "2026-02-01")
    assert good["airborne_s"] > 4.0
    assert good["battery_first_v"] > good["battery_last_v"] > 3.0
    assert "gyro_x" in good["channels"]
    assert torn["state"] == "damaged"
    assert torn["reason"]
    assert index(catalogue, [str(flights)], workers=1).read == 0
    os.utime(flights / "torn.mcap", ns=(1, 1))
    assert index(catalogue, [str(flights)], workers=1).read == 1
    (flights / "torn.mcap").unlink()
    last = index(catalogue, [str(flights / "*.mcap")], workers=1)
    assert (last.read, last.unchanged, last.gone) == (0, 1, 1)
    assert recordings_of(catalogue) == [good]


def test_an_address_of_another_file_system_is_read_as_well(flights, tmp_path):
    pytest.importorskip("fsspec", reason="Dask, which brings fsspec, is not installed")
    index(tmp_path / "here", [str(flights)], workers=1)
    index(tmp_path / "there", [f"file://{flights}"], workers=1)
    here, there = recordings_of(tmp_path / "here"), recordings_of(tmp_path / "there")
    assert [one["address"] for one in there] == [f"file://{one['address']}" for one in here]
    for name in ("sha256", "craft", "begun", "airborne_s", "state"):
        assert [one[name] for one in there] == [one[name] for one in here]


def test_a_recording_that_is_gone_from_a_remote_folder_loses_its_row(flights, tmp_path):
    pytest.importorskip("fsspec", reason="Dask, which brings fsspec, is not installed")
    other = flights.parent / "cf08"
    shutil.copytree(flights, other)
    for folder in (flights, other):
        index(tmp_path / "fleet", [f"file://{folder}"], workers=1)
        (folder / "torn.mcap").unlink()
    told = index(tmp_path / "fleet", [f"file://{flights}"], workers=1)
    assert (told.read, told.unchanged, told.gone) == (0, 1, 1)
    left = [
        one["address"].removeprefix(f"file://{flights.parent}/")
        for one in recordings_of(tmp_path / "fleet")
    ]
    assert left == [
        "cf07/2026-02-01T10-00-00Z_one.mcap",
        "cf08/2026-02-01T10-00-00Z_one.mcap",
        "cf08/torn.mcap",
    ]


def test_a_recording_that_processes_die_of_is_not_read_again_until_it_changes(flights, tmp_path):
    index(tmp_path / "fleet", [str(flights)], workers=1)
    Parts(tmp_path / "fleet" / "recordings", FACTS, KEY).append(
        [_deadly(str(flights / "torn.mcap"), None)]
    )
    assert index(tmp_path / "fleet", [str(flights)], workers=1).read == 0
    os.utime(flights / "torn.mcap", ns=(1, 1))
    assert index(tmp_path / "fleet", [str(flights)], workers=1).read == 1


def test_rows_of_an_older_reader_are_read_again(flights, tmp_path):
    index(tmp_path / "fleet", [str(flights)], workers=1)
    read = recordings_of(tmp_path / "fleet")
    older = {name: kind for name, kind in FACTS.items() if name != "reader"}
    shutil.rmtree(tmp_path / "fleet" / "recordings")
    Parts(tmp_path / "fleet" / "recordings", older, KEY).append(read)
    assert index(tmp_path / "fleet", [str(flights)], workers=1).read == 2
    assert recordings_of(tmp_path / "fleet") == read


def test_a_file_that_others_put_into_a_table_is_no_part_of_it_and_stays(flights, tmp_path):
    index(tmp_path / "fleet", [str(flights)], workers=1)
    read, foreign = recordings_of(tmp_path / "fleet"), tmp_path / "fleet/recordings/mine.parquet"
    shutil.copy(next(foreign.parent.iterdir()), foreign)
    os.utime(flights / "torn.mcap", ns=(1, 1))
    assert index(tmp_path / "fleet", [str(flights)], workers=1).read == 1
    assert len(recordings_of(tmp_path / "fleet")) == len(read)
    assert foreign.exists()


def test_a_recording_that_is_there_twice_counts_once_and_is_told(flights, tmp_path):
    shutil.copytree(flights, flights.parent / "backup")
    told = in_process("fleet", "index", flights.parent, "-o", tmp_path / "fleet").stdout
    assert "1 are copies of others by their content, and count once" in told
    (counted,) = usable(recordings_of(tmp_path / "fleet"))
    assert counted["address"].endswith("backup/2026-02-01T10-00-00Z_one.mcap")


@pytest.mark.parametrize(
    ("link", "craft"),
    [
        ("radio://0/80/2M/E7E7E7E707", "E7E7E7E707"),
        ("radio://0/80/2M/e7e7e7e707?safelink=0", "E7E7E7E707"),
        ("radio://0/80/2M/E7E7E7E7E7", "cf07"),
        ("radio://0/80/2M", "cf07"),
        ("usb://0", "cf07"),
    ],
)
def test_a_craft_is_its_radio_s_own_address_or_else_the_folder(link, craft):
    assert _craft({"session": {"link": link}}, "/flights/cf07/one.mcap") == craft


def test_rows_that_another_run_is_putting_together_are_read_where_they_are_then(
    table, tmp_path, monkeypatch
):
    table.append([row("a")])
    table.append([row("b")])
    old = table._files()
    table.compact()
    listed = iter([old])
    now = table._files
    monkeypatch.setattr(table, "_files", lambda: next(listed, None) or now())
    assert list(table.rows()) == ["a", "b"]


def test_a_folder_without_recordings_and_a_catalogue_that_is_none_are_one_line(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadInputError, match="empty: no recordings here"):
        index(tmp_path / "fleet", [str(tmp_path / "empty")], workers=1)
    with pytest.raises(BadInputError, match="make one with: groundstation fleet index"):
        recordings_of(tmp_path / "nothing")


def test_a_log_that_does_not_name_its_craft_is_not_fitted_as_the_thesis_s():
    row = fit_flight(str(RECORDINGS / "microsd_log16"), None, ())
    assert "say which with --vehicle crazyflie21," in row["reason"]
    assert row["c0"] is None


def test_nothing_else_loads_dask():
    modules = "groundstation.cli.app, groundstation.fleet.index, groundstation.fleet.fit"
    code = f"import sys, {modules}; print('dask' in sys.modules, 'distributed' in sys.modules)"
    assert run_program([sys.executable, "-c", code], check=True).stdout.split() == ["False"] * 2


def test_a_part_that_is_damaged_or_of_another_program_is_one_clear_error(table, tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    table.append([row("a")])
    part = tmp_path / "table" / "00000007.parquet"
    part.write_bytes(b"PAR1 but not really")
    for foreign in (
        None,
        {"other": [1, 2]},
        {"name": [1.5, None]},
        {"name": [[1]], "value": ["x"]},
    ):
        if foreign:
            pq.write_table(pa.table(foreign), part)
        for use in (table.rows, table.compact):
            with pytest.raises(RecordingError, match=r"7.parquet: cannot be read .* remove it"):
                use()


def test_pipes_and_holes_among_recordings_are_set_aside_at_once(tmp_path):
    """One never ends, the other after a terabyte of zeros."""
    folder = tmp_path / "flights"
    folder.mkdir()
    os.mkfifo(folder / "pipe.csv")
    with (folder / "hole.mcap").open("wb") as file:
        file.truncate(1 << 40)
    rows = {Path(address).name: facts_of(address) for address in addresses_of([str(folder)])}
    assert {one["state"] for one in rows.values()} == {"damaged"}
    assert "not a file" in rows["pipe.csv"]["reason"]
    assert "1099511627776 bytes, of which the disk has" in rows["hole.mcap"]["reason"]
