"""Tasks that fail are begun anew, counted and told; nothing dies silently."""

import asyncio

import pytest

from groundstation.service import station as supervisor_module
from groundstation.service.config import RateLimit
from groundstation.service.station import TaskSupervisor
from support.waiting import eventually
from support.worlds import running, station_on


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(supervisor_module, "BACK_OFF_S", (0.001, 0.002))


def run(conversation):
    told = []

    async def session():
        supervisor = TaskSupervisor(lambda text, name: told.append((name, text)))
        try:
            async with asyncio.timeout(20):
                await conversation(supervisor)
        finally:
            await supervisor.close()

    asyncio.run(session())
    return told


def test_a_task_that_fails_is_begun_anew_and_told_each_time():
    begun = []

    async def fragile():
        begun.append(None)
        if len(begun) < 4:
            raise ZeroDivisionError("again")
        await asyncio.sleep(60)

    async def conversation(supervisor):
        supervisor.start("fragile", fragile)
        while len(begun) < 4:
            await asyncio.sleep(0.001)
        assert supervisor.status()["fragile"] == {"state": "running", "restarts": 3}
        assert supervisor.dead() == []

    told = run(conversation)
    assert [name for name, _ in told] == ["fragile"] * 3
    assert "ZeroDivisionError('again')" in told[0][1]


def test_a_task_that_ends_by_itself_has_not_died():
    async def conversation(supervisor):
        async def short():
            pass

        supervisor.start("short", short)
        while supervisor.status()["short"]["state"] != "ended":
            await asyncio.sleep(0.001)
        assert supervisor.dead() == []

    assert run(conversation) == []


def test_an_adopted_task_that_fails_is_told_and_counts_as_dead():
    async def broken():
        raise OSError("no more sockets")

    async def conversation(supervisor):
        supervisor.adopt("control", asyncio.create_task(broken()))
        await eventually(supervisor.dead)
        assert supervisor.dead() == ["control"]

    ((name, text),) = run(conversation)
    assert name == "control"
    assert "no more sockets" in text


async def test_what_nobody_catches_is_a_fault_of_the_station(tmp_path):
    station = station_on("stand-in", tmp_path, enabled=False)
    async with running(station), asyncio.timeout(20):
        await station.receiver.tried.wait()
        asyncio.get_running_loop().call_soon(lambda: 1 // 0)
        while station.journal.faults == 0:
            await asyncio.sleep(0.01)
    (fault,) = [event.text for event in station.journal.events if event.kind == "fault"]
    assert "ZeroDivisionError" in fault


def test_a_rate_limit_gives_its_burst_and_then_its_rate():
    now_s = 0.0
    limit = RateLimit(10.0, 5.0, clock=lambda: now_s)
    assert [limit.allows() for _ in range(7)] == [True] * 5 + [False] * 2
    now_s = 0.25
    assert [limit.allows() for _ in range(4)] == [True, True, False, False]
    now_s = 100.0
    assert sum(limit.allows() for _ in range(50)) == 5
