"""What a craft says on its console, however much, and whatever it leaves out."""

from __future__ import annotations

import asyncio
import itertools

from groundstation.links.crazyflie import CrazyflieTelemetry
from groundstation.links.crazyflie_connection import (
    LINE_CHARACTERS,
    LINES_A_SECOND,
    LINES_AT_ONCE,
    Console,
    newest_only,
)
from support.crafts import narrow, served


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_lines_come_whole_however_they_were_cut_and_empty_ones_are_none() -> None:
    console = Console(Clock())
    for piece in ("SYS: up", " and running\n\n", "SYS: rea", "dy\r\nSYS: no end"):
        console.feed(piece)
    assert console.take() == ["SYS: up and running", "SYS: ready"]
    console.end()
    assert console.take() == ["SYS: no end"]


def test_text_without_a_line_end_is_told_in_parts_and_never_kept_whole() -> None:
    console = Console(Clock())
    for letter in itertools.islice(itertools.cycle("abcdefg"), 40):
        console.feed(letter * 30)
    assert [len(line) for line in console.take()] == [LINE_CHARACTERS] * 6


def test_of_a_flood_as_much_is_told_as_a_person_reads_and_the_rest_is_counted() -> None:
    clock = Clock()
    console = Console(clock)
    told: list[str] = []
    for _ in range(100):  # 10 s
        console.feed("E\n" * 1000)
        told += console.take()
        clock.now_s += 0.1
    clock.now_s += 5.0
    told += console.take()
    lines = [line for line in told if line == "E"]
    assert len(lines) <= LINES_AT_ONCE + 10 * LINES_A_SECOND
    assert len(lines) > LINES_AT_ONCE
    left_out = sum(int(line[1:].split()[0]) for line in told if line != "E")
    assert left_out + len(lines) == 100_000


def test_a_console_that_nobody_reads_does_not_grow() -> None:
    clock = Clock()
    console = Console(clock)
    for _ in range(1000):
        console.feed("ASSERT failed\n")
        clock.now_s += 1.0
    assert len(console.take()) <= LINES_AT_ONCE + 1


def test_a_craft_that_never_ends_a_line_is_heard_and_its_rows_come_on() -> None:
    """Over the official library: each piece was put together anew with all that came before."""

    async def session(uri: str, listened: list[str]) -> int:
        link = CrazyflieTelemetry(uri, rate_hz=100)
        link.on_event = lambda event: listened.append(event.text)
        async with link:
            for _ in range(30):
                await link.read()
        counts = link.sample_counts()
        assert counts is not None
        return counts.lost

    told: list[str] = []
    with served(craft="crazyflie21") as craft, narrow(craft.server.port) as radio:
        radio.adds = [b"\0" + b"x" * 30] * 10
        asyncio.run(session(radio.uri, told))
    said = [text for text in told if text.startswith("xx")]
    assert said
    assert max(map(len, said)) <= LINE_CHARACTERS


async def test_of_what_comes_faster_than_the_loop_takes_it_the_newest_is_taken() -> None:
    taken: list[int] = []
    tell = newest_only(asyncio.get_running_loop(), taken.append)
    for number in range(10_000):
        tell(number)
    await asyncio.sleep(0)
    tell(-1)
    await asyncio.sleep(0)
    assert taken == [9999, -1]
