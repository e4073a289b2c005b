"""Workers as on other machines: folders of their own, nothing shared but addresses."""

from dataclasses import replace
from pathlib import Path

import pytest

from groundstation.fleet.fit import fit_all, fits_table
from groundstation.fleet.index import index, recordings_of
from groundstation.recording.csv_file import write_csv
from groundstation.recording.formats import open_recording
from support import RECORDINGS
from support.daemons import scheduler, worker
from support.programs import free_port

pytest.importorskip("distributed", reason="Dask is not installed")
pytestmark = pytest.mark.timeout(600)
PARTS = 6


def test_workers_that_share_addresses_alone_find_the_same_digits(tmp_path, monkeypatch):
    flights = tmp_path / "flights"
    flights.mkdir()
    flown = open_recording(RECORDINGS / "stand_in_flight.mcap")
    for number in range(PARTS):  # each begins at another row
        write_csv(replace(flown, samples=flown.samples[number:]), flights / f"r{number}.csv")
    (flights / "torn.mcap").write_bytes(b"\x89MCAP0\r\n and nothing else")
    (tmp_path / "desk").mkdir()
    monkeypatch.chdir(tmp_path / "desk")
    alone, apart = Path("alone"), Path("apart")
    index(alone, [f"file://{flights}"], workers=1)
    fit_all(alone, vehicle=None, effects=("dead_time",), workers=1)
    port, log = free_port(), tmp_path / "dask.log"
    homes = [tmp_path / "machine_1", tmp_path / "machine_2"]
    with scheduler(log, port), worker(log, port, homes[0]), worker(log, port, homes[1]):
        there = {"workers": 1, "scheduler": f"tcp://127.0.0.1:{port}"}
        assert index(apart, [f"file://{flights}"], **there).damaged == 1
        assert fit_all(apart, vehicle=None, effects=("dead_time",), **there).fitted == PARTS
    assert recordings_of(apart) == recordings_of(alone)
    assert fits_table(apart).rows() == fits_table(alone).rows()
    assert not [path for home in homes for path in home.rglob("*.parquet")]
