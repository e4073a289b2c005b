"""What a craft keeps of its parameters while it is switched off: stored and cleared under a lease,
while its motors stand, and read."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from functools import partial

from groundstation.background import in_background
from groundstation.errors import BadInputError, GroundStationError, TakenError
from groundstation.links.command import CommandLink, ParameterStorage
from groundstation.service.command_connection import CommandConnection
from groundstation.service.flight_end import FlightEnd
from groundstation.service.lease import Lease
from groundstation.service.motor_stop import Note
from groundstation.service.parameters import Parameters, craft_of, listed
from groundstation.service.requests import StoredParameter

GAINS = "pid_"
"""How the names of a controller's gains begin."""
STANDS_S, LOOK_S = 12.0, 0.1
"""How long a craft is waited for whose motors may stand soon: one that was just switched on tests
them, and the firmware calls a craft flying for 2 s after it has landed. How often it is looked
at."""
STORES = "stored"
"""The kind of the events about it."""
KEEPS_NOTHING = (
    "this craft's firmware stores no parameters: what is written to it is lost when it is switched"
    " off. A Crazyflie 2.x needs firmware of 2022 or later"
)


class StoredParameters:
    """written: what was written to crafts. end: what goes on in flight. leased: the lease of a
    token, which is heard by that, and the craft that it is for; raises where it is over. note: told
    (kind, text)."""

    def __init__(
        self,
        written: Parameters,
        end: FlightEnd,
        connection: CommandConnection,
        leased: Callable[[str], tuple[Lease, CommandLink]],
        note: Note,
    ) -> None:
        self._written, self._end, self._connection = written, end, connection
        self._leased, self._note = leased, note

    async def store(self, token: str, names: Sequence[str]) -> dict[str, StoredParameter]:
        """Have the craft keep the present values of parameters; what it then has of all of them.

        names: none for every gain that a power cycle would change. What is kept is no longer to be
        put back. Raises BadInputError for a craft or a parameter that cannot, TakenError while
        motors turn, LinkError where the craft does not confirm one."""
        async with self._storing(token, names) as (lease, link, storage):
            present, done = link.parameters(), list[str]()
            meant = names or [name for name in storage.numbers if name.startswith(GAINS)]
            try:
                for name in meant:
                    self._require(token)
                    state = await storage.read(name)
                    kept = state.loaded if not names else state.stored
                    if kept is None or not math.isclose(kept, present[name], rel_tol=1e-6):
                        self._require(token)
                        await storage.store(name, present[name])
                        done.append(name)
            except GroundStationError as error:
                raise self._half("stored", done, error) from error
            settle = partial(self._written.changes.settle, craft_of(link), meant)
            await in_background(settle)
        said = [f"{name} {present[name]:g}" for name in done]
        self._tell(lease, "has stored", said)
        return self._states(link, storage)

    async def clear(self, token: str, names: Sequence[str]) -> dict[str, StoredParameter]:
        """Have the craft forget what it has stored of parameters, none: of all gains. Their values
        stay until it is switched off. Raises as ``store``."""
        async with self._storing(token, names) as (lease, link, storage):
            done = list[str]()
            try:
                for name in names or [one for one in storage.numbers if one.startswith(GAINS)]:
                    self._require(token)
                    if (await storage.read(name)).stored is not None:
                        self._require(token)
                        await storage.clear(name)
                        done.append(name)
            except GroundStationError as error:
                raise self._half("cleared", done, error) from error
        self._tell(lease, "has cleared the stored", done)
        return self._states(link, storage)

    async def states(self) -> dict[str, StoredParameter]:
        """Every parameter that the craft can keep. Raises BadInputError for a craft that keeps
        none, TakenError where it flies and was not asked before."""
        link = self._connection.require_connected()
        storage = _storage_of(link)
        for _ in range(round(STANDS_S / LOOK_S)):
            await self._read(link, lambda: self._end.is_still(link))
            if storage.numbers.keys() <= storage.states.keys():
                return self._states(link, storage)
            if self._drives(link):
                break
            await asyncio.sleep(LOOK_S)
        raise TakenError(
            "the craft does not stand: what it has stored is read when its motors stand; land first"
        )

    async def look(self, link: CommandLink, stands: Callable[[CommandLink], bool]) -> None:
        """Read what was not read yet, as long as the craft stands; what it does not say is told
        once."""
        storage = link.storage
        if storage is None or storage.trouble:
            return
        try:
            await self._read(link, lambda: stands(link))
        except GroundStationError as error:
            storage.trouble = str(error)
            self._note("fault", f"what the craft has stored was not read: {error}")

    @staticmethod
    def told(link: CommandLink) -> dict[str, float]:
        """What is stored, as far as it was read, by full name."""
        states = {} if link.storage is None else link.storage.states
        return {name: one.stored for name, one in states.items() if one.stored is not None}

    @asynccontextmanager
    async def _storing(
        self, token: str, names: Sequence[str]
    ) -> AsyncIterator[tuple[Lease, CommandLink, ParameterStorage]]:
        """While nothing else is written, and no motor may begin."""
        lease, link = self._leased(token)
        storage = _storage_of(link)
        for name in names:
            storage.require(name)
        async with self._written.turn:
            await self._landed(token)
            self._end.held = "parameters are being stored"
            try:
                yield lease, link, storage
            finally:
                self._end.held = ""

    async def _landed(self, token: str) -> None:
        """Wait for a craft whose motors do not turn to say so, and to call itself landed. Raises as
        ``_require``."""
        for _ in range(round(STANDS_S / LOOK_S)):
            lease, link = self._leased(token)
            if lease.flies or self._end.is_still(link) or self._drives(link):
                break
            await asyncio.sleep(LOOK_S)
        self._require(token)

    def _drives(self, link: CommandLink) -> bool:
        """Whether its motors turn because it flies: one that was just switched on tests them."""
        return self._end.drives(link) and link.supervisor.flies

    def _require(self, token: str) -> None:
        """Raises where the lease is over or a motor may turn."""
        lease, link = self._leased(token)
        if lease.flies or not self._end.is_still(link):
            raise TakenError(
                "the motors turn, or nothing says that they stand: parameters are stored and"
                " cleared on the ground only; land first"
            )

    async def _read(self, link: CommandLink, may: Callable[[], bool]) -> None:
        storage = _storage_of(link)
        for name in storage.numbers:
            if name not in storage.states:
                if not may():
                    return
                await storage.read(name)

    def _states(self, link: CommandLink, storage: ParameterStorage) -> dict[str, StoredParameter]:
        present = link.parameters()
        return {
            name: StoredParameter(now=present[name], default=one.default, stored=one.stored)
            for name, one in storage.states.items()
            if name in present
        }

    def _half(self, what: str, done: list[str], error: GroundStationError) -> GroundStationError:
        """The error of what ended in the middle, with what was done before."""
        if not done:
            return error
        text = f"{error}. Already {what}: {listed(done)}. Do it again before it is switched off"
        self._note("fault", text)
        return type(error)(text)

    def _tell(self, lease: Lease, does: str, what: list[str]) -> None:
        if what:
            self._note(STORES, f"{lease.client} {does} {listed(what)} on the craft")


def _storage_of(link: CommandLink) -> ParameterStorage:
    if link.storage is None:
        raise BadInputError(f"{link.uri}: {KEEPS_NOTHING}")
    return link.storage
