"""The twin in the daemon: what goes wrong in it costs the twin, never the telemetry."""

import asyncio

import pytest

from groundstation.dynamics.model import save_model, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.service.twin import FAULTS_MOST, TwinService
from groundstation.twin import twin as twin_module
from support.packets import flight


@pytest.fixture
def service(tmp_path, monkeypatch):
    """A twin service, and what it notes."""
    monkeypatch.setattr(twin_module, "warm_up", lambda model: None)
    path = tmp_path / "model.json"
    save_model(vehicle_model(BUILT_IN["crazyflie1"]), path)
    notes = []
    made = TwinService(
        str(path),
        tell=lambda event: notes.append((event.kind, event.text)),
        note=lambda kind, text: notes.append((kind, text)),
        show=lambda shown: None,
    )
    return made, notes


def drained(service, batches):
    async def session():
        for batch in batches:
            service.samples(batch)
            await service.drain()
        await service.close()

    asyncio.run(session())


def test_a_fault_in_it_is_told_and_begun_anew_until_it_is_given_up(service, monkeypatch):
    twin, notes = service

    def broken(self, samples):
        raise RuntimeError("a wheel came off")
        yield

    monkeypatch.setattr(twin_module.Twin, "feed", broken)
    drained(twin, [flight(100 * k, 100)[1] for k in range(6)])
    assert [kind for kind, _ in notes] == ["fault"] * FAULTS_MOST
    assert "begins anew" in notes[0][1]
    assert "given up" in notes[-1][1]
    assert twin.fullness == 0.0, "nothing waits for what is given up"


def test_a_twin_that_cannot_be_prepared_holds_up_nobody(service, monkeypatch):
    twin, notes = service

    def broken(model):
        raise RuntimeError("no compiler")

    monkeypatch.setattr(twin_module, "warm_up", broken)
    drained(twin, [flight(0, 100)[1], flight(100, 100)[1]])
    assert [kind for kind, _ in notes] == ["fault"]
    assert twin.fullness == 0.0


def test_what_it_is_too_slow_for_is_dropped_and_counted(service):
    twin, _ = service
    for k in range(70):
        twin.samples(flight(500 * k, 500)[1])
    assert twin.fullness <= 1.0
    assert twin.status()["dropped"] == 70 * 500 - twin.status()["waiting"]
