"""The software craft as a link: its time against the host's."""

import asyncio
import time

import numpy as np
import pytest

from groundstation import compiling
from groundstation.links import stand_in
from groundstation.links.stand_in import StandInLink
from groundstation.telemetry.decoder import Decoder, decode_all
from support.links import joined, read_span

SOUND_RADIO = {"loss": {"good_loss": 0.0}}
FAST = float("inf")


def flown(speed, span_ns, **options):
    link = StandInLink(SOUND_RADIO | options, speed=speed)

    async def session():
        async with link:
            return joined(await read_span(link, span_ns))

    return asyncio.run(session())


@pytest.mark.parametrize("speed", [3.0, FAST])
def test_a_seed_gives_the_same_packets_with_the_same_spacing_at_any_speed(speed):
    slow, fast = flown(1.0, 200_000_000, seed=5), flown(speed, 200_000_000, seed=5)
    rows = min(len(slow), len(fast))
    assert rows >= 400
    np.testing.assert_array_equal(slow.packets[:rows], fast.packets[:rows])
    spacing = [np.diff(batch.host_time_ns[:rows]) for batch in (slow, fast)]
    np.testing.assert_array_equal(*spacing)
    other = flown(FAST, 200_000_000, seed=6)
    assert (other.packets[:rows] != fast.packets[:rows]).any()


def opened_beside(compiles, monkeypatch):
    """(what the link says while its craft is made, its events); compiles: as the machine does."""
    link, events, said = StandInLink(SOUND_RADIO), [], []
    link.on_event = events.append
    power_on = link._power_on

    def held():
        if compiles:
            compiling.begin("a kernel")
        eventually_said = time.monotonic() + 60
        while compiles and not any(e.kind == "preparing" for e in events):
            assert time.monotonic() < eventually_said
            time.sleep(0.01)
        said.append((link.state.value, link.pauses, link.doing))
        if compiles:
            compiling.end("a kernel")
        return power_on()

    monkeypatch.setattr(link, "_power_on", held)

    async def session():
        async with link:
            return link.doing, link.pauses

    assert asyncio.run(session()) == ("", False)
    (once,) = said
    return once, [event.text for event in events if event.kind == "preparing"]


def test_a_craft_that_is_being_prepared_is_no_fault_and_says_first_start_only_where_it_is(
    monkeypatch,
):
    state, told = opened_beside(False, monkeypatch)
    assert state == ("opening", True, "preparing the simulator")
    state, told = opened_beside(True, monkeypatch)
    assert state == ("opening", True, "preparing the simulator, first start only")
    assert told == [f"{state[2]}: its flight model is compiled once per machine"]


def stalled(speed, stall_s, tell=lambda event: None):
    """Packets of a flight during which the whole process stood still."""
    link = StandInLink(SOUND_RADIO, speed=speed)
    link.on_event = tell

    async def session():
        async with link:
            before = await read_span(link, 200_000_000)
            time.sleep(stall_s)  # blocks the loop on purpose
            return joined([*before, *(await read_span(link, 200_000_000))])

    return asyncio.run(session())


def test_a_short_stall_is_caught_up_without_loss():
    decoder = Decoder()
    decoder.decode(stalled(1.0, 0.4))
    decoder.finish()
    assert decoder.counts().lost == 0


def test_after_a_long_stall_device_and_host_agree_on_what_was_missed(monkeypatch):
    """Or the silence would look like a restart of the device."""
    monkeypatch.setattr(stand_in, "CATCH_UP_S", 0.2)
    events = []
    batch = stalled(1.0, 1.3, events.append)
    samples, counts = decode_all(batch)
    assert counts.restarts == 0
    assert set(samples.segment) == {0}
    gap = int(np.argmax(np.diff(samples.ticks)))
    device_s = (samples.ticks[gap + 1] - samples.ticks[gap]) * samples.tick_s
    host_s = (samples.host_time_ns[gap + 1] - samples.host_time_ns[gap]) * 1e-9
    assert device_s > 1.2
    assert host_s == pytest.approx(device_s, abs=0.003)
    told = [event.text for event in events if event.kind == "loss"]  # a busy machine adds some
    stood_s = [
        float(text.removeprefix("this program stood still for ").split(" s")[0]) for text in told
    ]
    assert max(stood_s) > 1.2


def test_faster_than_real_time_the_craft_waits_for_a_stalled_process(monkeypatch):
    monkeypatch.setattr(stand_in, "CATCH_UP_S", 0.1)
    samples, counts = decode_all(stalled(4.0, 0.3))
    assert counts.lost == 0
    assert set(samples.segment) == {0}


def test_an_empty_cell_and_its_successor_are_told_as_what_they_are():
    events = []
    link = StandInLink(SOUND_RADIO | {"charge": 0.0, "recharge_s": 1.0}, speed=FAST)
    link.on_event = events.append

    async def session():
        async with link:
            while sum(event.kind == "battery" for event in events) < 2:
                await link.read()

    asyncio.run(asyncio.wait_for(session(), 60))
    empty, fresh = (event.text for event in events if event.kind == "battery")
    assert "cell is empty" in empty
    assert "charged cell was plugged in" in fresh
