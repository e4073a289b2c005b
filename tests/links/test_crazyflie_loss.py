"""Requests that UDP loses: the library takes it to lose none, and waits for their answers."""

from __future__ import annotations

import asyncio
import random
import re
import time
from pathlib import Path

import pytest

from groundstation.errors import LinkLostError
from groundstation.links import crazyflie as crazyflie_log
from groundstation.links.crazyflie import CrazyflieTelemetry
from groundstation.links.crazyflie_connection import CREATE_V2, START_V2, Connection
from support.crafts import LOG_DATA, NarrowRadio, narrow, served

LOG_CONTROL, LINK_SOURCE = 0x51, 0xF1
"""Header bytes, the two link bits aside."""
LOST = 0.05
RESET = 5


def header(packet: bytes) -> int:
    return packet[0] & 0xF3


def test_a_craft_is_known_whole_although_one_request_in_twenty_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # tables of contents are read
    chance, lost = random.Random(3), []

    def loses(packet: bytes) -> bool:
        asked_once = header(packet) in (0xD1, LINK_SOURCE)  # what it speaks, before anything else
        if asked_once or chance.random() > LOST:
            return False
        lost.append(packet)
        return True

    async def session(uri: str) -> int:
        connection = Connection(uri)
        await connection.open()
        try:
            await connection.complete()
            return len(connection.variables())
        finally:
            await connection.close()

    with served(craft="crazyflie21") as craft, narrow(craft.server.port) as radio:
        radio.loses = loses
        assert asyncio.run(session(radio.uri)) > 30
    assert len(lost) > 3


async def test_a_first_question_that_is_lost_is_asked_again_within_the_patience_for_it() -> None:
    asked: list[bytes] = []

    def loses(packet: bytes) -> bool:
        if header(packet) == LINK_SOURCE:
            asked.append(packet)
        return header(packet) == LINK_SOURCE and len(asked) == 1

    with served(craft="crazyflie21") as craft, narrow(craft.server.port) as radio:
        radio.loses = loses
        connection = Connection(radio.uri)
        await connection.open()
        await connection.complete()
        await connection.close()
    assert len(asked) == 2


async def test_a_log_block_of_which_a_part_was_lost_is_made_anew_and_rows_are_whole() -> None:
    """What is added to a block that the craft does not know is refused; made afterwards, the block
    would lack it, and the library can read none of its packets."""
    lost: list[bytes] = []

    def loses(packet: bytes) -> bool:
        makes = header(packet) == LOG_CONTROL and packet[1] == CREATE_V2 and len(packet) == 31
        if makes and not lost:
            lost.append(packet)
            return True
        return False

    with served(craft="crazyflie21") as craft, narrow(craft.server.port) as radio:
        radio.loses = loses
        link = CrazyflieTelemetry(radio.uri, rate_hz=250)
        async with link:
            for _ in range(20):
                await link.read()
            assert not link._connection.blocks._craft().log.log_blocks[2:]
            counts = link.sample_counts()
            assert counts is not None
            found = counts.samples
        assert found > 20
    assert lost


def test_answers_that_come_twice_clear_the_log_no_second_time() -> None:
    """A craft that stood still answers all that it was asked meanwhile; the library began anew with
    each answer, and the rows ceased when it cleared the log for that."""
    cleared: list[float] = []

    def loses(packet: bytes) -> bool:
        if header(packet) == LOG_CONTROL and packet[1] == RESET:
            cleared.append(time.monotonic())
        return False

    async def session(uri: str) -> float:
        link = CrazyflieTelemetry(uri, rate_hz=250)
        async with link:
            begun_s = time.monotonic()
            while time.monotonic() < begun_s + 1.0:
                assert await link.read() is not None, "silent"
        return begun_s

    with served(craft="crazyflie21") as craft, narrow(craft.server.port) as radio:
        radio.loses, radio.doubles = loses, True
        begun_s = asyncio.run(session(radio.uri))
    assert cleared
    assert max(cleared) < begun_s


def block_of(packet: bytes) -> int | None:
    return packet[1] if header(packet) == LOG_DATA else None


def test_one_of_two_log_blocks_that_ceases_is_asked_for_again_on_the_same_connection() -> None:
    """Rows need both: none came, and packets of the other block kept the link from being lost."""
    asked: list[int] = []
    told: list[str] = []

    async def session(radio: NarrowRadio) -> int:
        link = CrazyflieTelemetry(radio.uri, rate_hz=100)
        link.on_event = lambda event: told.append(event.text)
        async with link:
            await link.read()
            craft = link._connection.craft
            radio.ceases = lambda packet: block_of(packet) == 2 and not asked

            def loses(packet: bytes) -> bool:
                if header(packet) == LOG_CONTROL and packet[1] == START_V2:
                    asked.append(packet[2])
                return False

            radio.loses = loses
            async with asyncio.timeout(20.0):
                while not asked:
                    await link.read()
                while await link.read() is None:
                    pass
            assert link._connection.craft is craft
            counts = link.sample_counts()
            assert counts is not None
            return counts.restarts

    with served(craft="crazyflie21") as craft, narrow(craft.server.port) as radio:
        assert asyncio.run(session(radio)) == 0
    assert set(asked) == {2}
    assert any(re.match(r"no acc, .* came for 0.8 s: asked for once more", text) for text in told)
    assert any(re.match(r"no acc, .* received for 0.5 s", text) for text in told)


async def test_a_log_block_that_stays_away_is_a_link_that_is_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(crazyflie_log, "SILENT_S", 0.6)
    monkeypatch.setattr(crazyflie_log, "CEASED_S", 0.2)

    async def read_on(link: CrazyflieTelemetry) -> None:
        while True:
            await link.read()

    with served(craft="crazyflie21") as craft, narrow(craft.server.port) as radio:
        link = CrazyflieTelemetry(radio.uri, rate_hz=100)
        async with link, asyncio.timeout(20.0):
            await link.read()
            radio.ceases = lambda packet: block_of(packet) == 1
            with pytest.raises(LinkLostError, match=r"no gyro, pm, pwm came for 0.6 s; connecting"):
                await read_on(link)
