"""What a craft is asked to log: blocks of variables, how often they come, and when.

cflib asks for them; periods under 10 ms and the moment within a period are asked for here.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import random
import threading
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from groundstation.errors import BadInputError, LinkError
from groundstation.links.cflib_calls import (
    APPEND_V2,
    LOG_CONTROL,
    START_V2,
    crtp_packet,
    protocol_of,
    resolve,
)
from groundstation.links.log_plan import Variable

BLOCK_S, BEGIN_TRIES = 5.0, 5
BLOCKS_MOST = "a craft logs 16 blocks and 128 variables"
"""The firmware's own limits, which cflib knows."""
MOST_AT_ONCE = 9
"""Variables of a block that one packet holds; of more, cflib adds the rest with another."""
STOP_S = 0.2
"""Between stopping and deleting a block: deleting one while it is read can crash the firmware."""
STAGGER_TRIES = 40
LEAST_CFLIB_MS = 10
"""cflib's own commands know no shorter period."""

OnValues = Callable[[int, int, tuple[float, ...]], None]
"""Number of the block, stamp (ms, 24 bits), values; from cflib's thread."""


class LogBlocks:
    """The log blocks of one craft.

    uri: named in errors. craft: cflib's object, raising LinkError where nothing is connected.
    """

    def __init__(self, uri: str, craft: Callable[[], Any]) -> None:
        self._uri, self._craft = uri, craft
        self._blocks: list[Any] = []
        self._watched: list[Any] = []
        self._half_made: list[Any] = []
        self._between = 0
        self._stamps: dict[int, int] = {}

    @property
    def _protocol(self) -> int:
        return protocol_of(self._craft())

    async def start(
        self,
        blocks: Sequence[Sequence[Variable]],
        period_ms: int,
        on_values: OnValues,
        between: int = 0,
    ) -> None:
        """Let the craft send blocks, each every ``period_ms``.

        between: number of the block that is to come half-way between those of the first; 0: none.

        Raises LinkError where it refuses one, or does not know so short a period.
        """
        stamps = self._stamps = {}
        self._between = between
        running = threading.Event()  # nothing is passed on before the last block has its period
        for number, variables in enumerate(blocks):

            def received(stamp: int, values: Any, block: Any, number: int = number) -> None:
                stamps[number] = stamp
                if running.is_set():
                    on_values(number, stamp, tuple(values.values()))

            name, slow_ms = f"block {number}", max(period_ms, LEAST_CFLIB_MS)
            self._blocks.append(await self._begin(name, variables, slow_ms, received))
        await self.pace(period_ms)
        running.set()

    async def watch(
        self,
        name: str,
        variables: Sequence[Variable],
        period_ms: int,
        on_values: Callable[[int, dict[str, float]], None],
    ) -> None:
        """Let the craft say these as well, every ``period_ms``, however fast its other blocks are;
        told from cflib's thread, with the stamp. Raises LinkError where it refuses."""
        self._watched.append(
            await self._begin(
                name,
                variables,
                period_ms,
                lambda stamp, values, block: on_values(stamp, dict(values)),
            )
        )

    async def _begin(
        self,
        name: str,
        variables: Sequence[Variable],
        period_ms: int,
        received: Callable[[int, Any, Any], None],
    ) -> Any:
        """A block that the craft has started, made anew where a request or an answer was lost.
        Raises LinkError where it refuses, BadInputError where there are too many."""
        for _ in range(BEGIN_TRIES):
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(BLOCK_S / BEGIN_TRIES):
                    return await self._make(name, variables, period_ms, received)
        raise self._did_not("did not start a log block")

    async def _make(
        self,
        name: str,
        variables: Sequence[Variable],
        period_ms: int,
        received: Callable[[int, Any, Any], None],
    ) -> Any:
        from cflib.crazyflie.log import LogConfig

        craft, loop = self._craft(), asyncio.get_running_loop()
        block = LogConfig(name, period_ms)
        for variable, kind in variables:
            block.add_variable(variable, kind)
        started: asyncio.Future[None] = loop.create_future()
        whole: asyncio.Future[None] = loop.create_future()
        missing = (len(variables) - 1) // MOST_AT_ONCE if self._protocol >= 0 else 0
        if not missing:
            whole.set_result(None)

        def begun(block: Any, is_started: bool) -> None:
            loop.call_soon_threadsafe(resolve, started, None)

        def refused(block: Any, reason: str) -> None:
            error = LinkError(f"{self._uri}: the craft refused a log block: {reason}")
            loop.call_soon_threadsafe(resolve, started, error)

        def heard(packet: Any) -> None:  # cflib does not look at what becomes of an addition
            nonlocal missing
            data = bytes(packet.data)
            if len(data) < 3 or data[:2] != bytes([APPEND_V2, block.id]):
                return
            missing -= data[2] == 0
            if not missing:
                loop.call_soon_threadsafe(resolve, whole, None)
            elif data[2] not in (0, errno.ENOENT):  # ENOENT: the block itself was lost
                refused(block, os.strerror(data[2]))

        block.started_cb.add_callback(begun)
        block.error_cb.add_callback(refused)
        block.data_received_cb.add_callback(received)
        craft.add_header_callback(heard, *LOG_CONTROL)
        try:
            craft.log.add_config(block)
            block.start()
            await started
            await whole
        except (AttributeError, KeyError) as error:  # cflib's own limits
            what = f"{self._uri}: {error.args[0] if error.args else error}"
            raise BadInputError(f"{what}: {BLOCKS_MOST}; ask for fewer with --log") from error
        except asyncio.CancelledError:
            block.stop()  # and deleted at the end: it may be read at this moment
            with contextlib.suppress(ValueError):  # cflib has begun anew
                craft.log.log_blocks.remove(block)
            self._half_made.append(block)
            raise
        finally:
            craft.remove_header_callback(heard, *LOG_CONTROL)
        return block

    async def pace(self, period_ms: int) -> None:
        """Let the blocks that run come every ``period_ms``; commands go on meanwhile.

        Raises LinkError where the craft does not confirm it.
        """
        await self._set_period(period_ms, self._blocks)
        if self._between and self._protocol >= 0:
            await self._stagger(self._blocks[self._between], period_ms, self._between)

    async def again(self, numbers: Sequence[int], period_ms: int) -> None:
        """Ask once more for blocks that have ceased. Raises LinkError where the craft does not
        confirm it, or knows them no more."""
        await self._set_period(period_ms, [self._blocks[number] for number in numbers])

    async def _stagger(self, block: Any, period_ms: int, number: int) -> None:
        """Start a block again until it comes half a period after the first one.

        When a packet arrives in the craft is chance, by some ms. Where it does not succeed, the
        block is merely of another moment.
        """
        near_ms, stamps = (period_ms - 1) // 4, self._stamps

        async def both() -> None:
            while not {0, number} <= stamps.keys():
                await asyncio.sleep(1e-3 * period_ms)

        for _ in range(STAGGER_TRIES):
            stamps.clear()
            await self._within(both(), "did not send what it was asked to log")
            off_ms = (stamps[number] - stamps[0]) % period_ms - period_ms // 2
            if abs(off_ms) <= near_ms:
                return
            await asyncio.sleep(1e-3 * random.uniform(0.0, 2.0 * period_ms))
            await self._set_period(period_ms, [block])

    async def _set_period(self, period_ms: int, blocks: Sequence[Any]) -> None:
        """Start blocks again, as close to each other as packets go, in ms: cflib itself
        starts one when the craft has confirmed it, and knows tens of ms only."""
        if self._protocol < 0:
            if period_ms % LEAST_CFLIB_MS:
                raise LinkError(
                    f"{self._uri}: this firmware logs every 10, 20, 30 ... ms only, not every"
                    f" {period_ms}; say --rate 100"
                )
            return
        craft, loop = self._craft(), asyncio.get_running_loop()
        answers: dict[int, asyncio.Future[int]] = {
            block.id: loop.create_future() for block in blocks
        }

        def heard(packet: Any) -> None:
            data = bytes(packet.data)
            if len(data) > 2 and data[0] == START_V2 and data[1] in answers:
                loop.call_soon_threadsafe(resolve, answers[data[1]], data[2])

        craft.add_header_callback(heard, *LOG_CONTROL)
        try:
            for _ in range(BEGIN_TRIES if answers else 0):
                for number in [each for each, answer in answers.items() if not answer.done()]:
                    data = bytes([START_V2, number]) + period_ms.to_bytes(2, "little")
                    craft.send_packet(crtp_packet(*LOG_CONTROL, data))
                await asyncio.wait(answers.values(), timeout=BLOCK_S / BEGIN_TRIES)
            for answer in answers.values():
                if not answer.done():
                    raise self._did_not("did not confirm the period of its log")
                error = answer.result()
                if error and period_ms % LEAST_CFLIB_MS:
                    raise LinkError(
                        f"{self._uri}: this firmware does not log every {period_ms} ms"
                        f" ({errno.errorcode.get(error, error)}); say --rate 100"
                    )
        finally:
            craft.remove_header_callback(heard, *LOG_CONTROL)

    def stop(self, craft: Any) -> None:
        """End all blocks of a craft that is about to be left; waits, so not on the event loop."""
        blocks = [*self._blocks, *self._watched, *self._half_made]
        self._blocks, self._watched, self._half_made = [], [], []
        if craft.link is None:
            return
        for block in blocks:
            block.stop()
        if blocks:
            threading.Event().wait(STOP_S)
        for block in blocks:
            block.delete()

    async def _within(self, answer: Awaitable[Any], what: str) -> Any:
        try:
            async with asyncio.timeout(BLOCK_S):
                return await answer
        except TimeoutError as error:
            raise self._did_not(what) from error

    def _did_not(self, what: str) -> LinkError:
        return LinkError(f"{self._uri}: the craft {what} within {BLOCK_S:g} s")
