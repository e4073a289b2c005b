"""Work on this process, on this machine's cores and on a scheduler of its own; workers that die."""

import os
import signal
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from groundstation.errors import BadInputError, GroundStationError
from groundstation.fleet import engine
from groundstation.fleet.engine import carried_out
from support.daemons import scheduler, worker
from support.programs import free_port

dask = pytest.importorskip("dask", reason="Dask is not installed")
distributed = pytest.importorskip("distributed", reason="Dask is not installed")
pytestmark = pytest.mark.timeout(600)


def doubled(address):
    return address + address


def deadly(address):
    if address == "bad":
        os.kill(os.getpid(), signal.SIGKILL)
    return address


def killed_once(address):
    """Dies the first time that it is asked for the address that is a file's name."""
    try:
        Path(address).unlink()
    except FileNotFoundError:
        return os.path.basename(address)
    time.sleep(0.2)
    os.kill(os.getpid(), signal.SIGKILL)
    return None


def names(count):
    return [f"r{number}" for number in range(count)]


def test_one_process_and_two_workers_do_the_same_work_once_each():
    alone = dict(carried_out(doubled, names(200), workers=1))
    assert alone == {one: one + one for one in names(200)}
    both = list(carried_out(doubled, names(200), workers=2))
    assert len(both) == 200
    assert dict(both) == alone


def test_a_recording_that_workers_die_of_is_set_aside_and_all_others_are_done():
    addresses = [*names(30), "bad", *(f"s{number}" for number in range(30))]
    done = list(carried_out(deadly, addresses, workers=2))
    assert sorted(address for address, _ in done) == sorted(addresses)
    assert [address for address, result in done if result is None] == ["bad"]


def test_a_run_whose_workers_do_not_come_back_ends_with_one_line(monkeypatch):
    class Deserted(distributed.LocalCluster):
        def __init__(self, **options):
            super().__init__(**{**options, "n_workers": 0})

    monkeypatch.setattr(distributed, "LocalCluster", Deserted)
    monkeypatch.setattr(engine, "GONE_S", 0.5)
    monkeypatch.setattr(engine, "LOOK_S", 0.1)
    with pytest.raises(GroundStationError, match="none began anew; what has arrived is kept"):
        list(carried_out(doubled, names(4), workers=2))


def test_a_worker_that_is_killed_costs_only_time(tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "GONE_S", 20.0)
    addresses = []
    for number in range(20):
        path = tmp_path / f"r{number}"
        addresses.append(str(path))
        if number in (3, 11):
            path.touch()
    # Dask's own limit gives a worker up that is not back by then
    with dask.config.set({"distributed.deploy.lost-worker-timeout": 0.05}):
        done = dict(carried_out(killed_once, addresses, workers=2))
    assert done == {one: os.path.basename(one) for one in addresses}


def test_a_scheduler_that_runs_already_is_used_and_left_running():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0"
    ) as cluster:
        for _ in range(2):
            done = carried_out(doubled, names(40), workers=1, scheduler=cluster.scheduler_address)
            assert dict(done) == {one: one + one for one in names(40)}


def test_a_scheduler_that_does_not_answer_is_one_line(monkeypatch):
    monkeypatch.setattr(engine, "CONNECT_S", 1)
    with pytest.raises(BadInputError, match=r"--scheduler tcp://127.0.0.1:9: does not answer"):
        list(carried_out(doubled, names(4), workers=1, scheduler="tcp://127.0.0.1:9"))


def patient(address):
    time.sleep(0.02)
    return address + address


def test_a_scheduler_that_is_killed_is_one_line_and_what_arrived_is_kept(tmp_path):
    port, log = free_port(), tmp_path / "dask.log"
    arriving = carried_out(patient, names(400), workers=1, scheduler=f"tcp://127.0.0.1:{port}")
    with scheduler(log, port), worker(log, port, tmp_path / "first"):
        done = [next(arriving) for _ in range(30)]
    assert all(result == one + one for one, result in done)
    with pytest.raises(GroundStationError, match=r"what has arrived is kept, run it again"):
        list(arriving)


def timed(address):
    begun = time.monotonic()
    time.sleep(0.05)
    return os.getpid(), begun, time.monotonic()


def test_a_scheduler_without_workers_is_told_and_one_that_joins_later_is_given_work(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(engine, "CONNECT_S", 5)
    monkeypatch.setattr(engine, "LOOK_S", 0.0)
    monkeypatch.setattr(engine, "MOST_AT_ONCE", 1)
    port, log = free_port(), tmp_path / "dask.log"
    how = {"workers": 1, "scheduler": f"tcp://127.0.0.1:{port}", "largest": 5}
    arriving = carried_out(timed, names(400), **how)
    with (
        scheduler(log, port),
        warnings.catch_warnings(record=True) as said,
        ThreadPoolExecutor(1) as thread,
    ):
        warnings.simplefilter("always")
        first = thread.submit(next, arriving)
        while not said:
            assert not first.done()
            time.sleep(0.05)
        assert "has no worker; waiting for one" in str(said[0].message)
        with worker(log, port, tmp_path / "first"):
            first.result()
            with worker(log, port, tmp_path / "second"):
                done = [result for _, result in arriving]
    pids = {pid for pid, _, _ in done}
    assert len(pids) == 2
    spans = [[(a, b) for pid, a, b in done if pid == one] for one in pids]
    assert any(a < d and c < b for a, b in spans[0] for c, d in spans[1])


def test_workers_that_do_not_know_the_work_are_one_line(tmp_path, monkeypatch):
    port, log = free_port(), tmp_path / "dask.log"
    with scheduler(log, port), worker(log, port, tmp_path / "first"):
        (tmp_path / "known_here_alone.py").write_text("def work(task):\n    return task\n")
        monkeypatch.syspath_prepend(tmp_path)
        from known_here_alone import work

        arriving = carried_out(work, names(4), workers=1, scheduler=f"tcp://127.0.0.1:{port}")
        with pytest.raises(GroundStationError, match=r"cannot take the work up: .*known_here_alon"):
            next(arriving)
