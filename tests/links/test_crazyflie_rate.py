"""A radio that does not bear the rate that was asked for: fewer rows, and all of them."""

from __future__ import annotations

import asyncio

import numpy as np

from groundstation.links.crazyflie_log import CrazyflieTelemetry
from groundstation.telemetry.samples import SampleBatch
from support.crafts import narrow, served
from support.waiting import in_real_time

FAST_HZ = 250


async def heard(link: CrazyflieTelemetry, seconds: float) -> tuple[SampleBatch, list[str]]:
    told: list[str] = []
    link.on_event = lambda event: told.append(f"{event.kind}: {event.text}")
    batches = []
    with in_real_time():
        async with link:
            end = asyncio.get_running_loop().time() + seconds
            while asyncio.get_running_loop().time() < end:
                batch = await link.read()
                assert batch is not None, told
                batches.append(batch)
                if any("from now on" in line for line in told) and seconds > 0:
                    end, seconds = asyncio.get_running_loop().time() + 2.0, 0.0
    return SampleBatch.concatenate(batches), told


def test_a_link_that_loses_a_third_is_asked_for_fewer_rows_in_a_segment_of_their_own() -> None:
    with (
        served(craft="crazyflie21") as craft,
        narrow(craft.server.port, most_hz=340.0) as radio,
    ):
        samples, told = asyncio.run(heard(CrazyflieTelemetry(radio.uri, rate_hz=FAST_HZ), 30.0))
    stepped = [line for line in told if line.startswith("loss: ")]
    assert len(stepped) == 1
    assert "% of 250 rows a second lost: 200 from now on" in stepped[0]
    before, after = (samples[samples.segment == number] for number in np.unique(samples.segment))
    for part, period in ((before, 0.004), (after, 0.005)):
        steps = np.diff(part.ticks) * part.tick_s
        assert np.median(steps) == period


def test_who_connects_again_is_asked_for_as_many_rows_as_at_first() -> None:
    async def session(uri: str) -> tuple[int, SampleBatch]:
        link = CrazyflieTelemetry(uri, rate_hz=FAST_HZ)
        async with link:
            await link.read()
            assert link._rows is not None
            await link._slow_down(100, "half of the rows lost", link._rows)
            slow_ms = link._period_ms
        return slow_ms, (await heard(link, 1.0))[0]

    with served(craft="crazyflie21") as craft:
        slow_ms, samples = asyncio.run(session(craft.uri))
    assert slow_ms == 10
    assert np.median(np.diff(samples.ticks)) * samples.tick_s == 1.0 / FAST_HZ


def test_without_a_rate_as_many_rows_are_asked_for_as_the_link_bears_and_none_is_lost() -> None:
    """340 packets a second are 170 rows; a tenth of it stays free."""
    with (
        served(craft="crazyflie21") as craft,
        narrow(craft.server.port, most_hz=340.0) as radio,
    ):
        samples, told = asyncio.run(heard(CrazyflieTelemetry(radio.uri), 6.0))
    (said,) = [line for line in told if line.startswith("loss: ")]
    assert "of 250 rows a second: 125 are asked for" in said
    assert len(np.unique(samples.segment)) == 1
    steps = np.diff(samples.ticks) * samples.tick_s
    assert np.median(steps) == 0.008


def test_without_a_rate_a_good_link_is_asked_for_250_rows_and_firmware_of_2014_for_100() -> None:
    for craft_name, rate_hz in (("crazyflie21", 250), ("crazyflie1", 100)):
        with served(craft=craft_name) as craft:
            samples, _ = asyncio.run(heard(CrazyflieTelemetry(craft.uri), 3.0))
        assert np.median(np.diff(samples.ticks)) * samples.tick_s == 1.0 / rate_hz


def test_a_link_that_bears_its_rate_keeps_it() -> None:
    with served(craft="crazyflie21") as craft:
        samples, told = asyncio.run(heard(CrazyflieTelemetry(craft.uri, rate_hz=FAST_HZ), 6.0))
    assert not [line for line in told if "from now on" in line]
    assert len(np.unique(samples.segment)) == 1


def test_a_library_that_fails_while_the_rate_is_lowered_is_told_and_the_rows_go_on() -> None:
    async def broken(period_ms: int) -> None:
        raise AttributeError("'NoneType' object has no attribute 'send_packet'")

    async def session(uri: str) -> list[str]:
        link = CrazyflieTelemetry(uri, rate_hz=FAST_HZ)
        told: list[str] = []
        link.on_event = lambda event: told.append(f"{event.kind}: {event.text}")
        async with link:
            await link.read()
            link._connection.blocks.pace = broken
            assert link._rows is not None
            await link._slow_down(100, "half of the rows lost", link._rows)
            assert len(await link.read())
        return told

    with served(craft="crazyflie21", plant="reduced") as craft:
        told = asyncio.run(session(craft.uri))
    (said,) = [line for line in told if line.startswith("loss: ")]
    assert said.startswith("loss: half of the rows lost, and they cannot be made fewer: ")
    assert "send_packet" in said
