"""A radio that does not bear the rate that was asked for: fewer rows, and all of them."""

from __future__ import annotations

import asyncio

import numpy as np

from groundstation.links.crazyflie import CrazyflieTelemetry
from groundstation.telemetry.samples import SampleBatch
from support.crafts import narrow, served
from support.waiting import in_real_time


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
    return SampleBatch.concatenate(batches), told


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
