"""Parameters of the craft that is commanded: written under a lease, noted before, and the former
values written back where the lease did not end with its client's consent."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from functools import partial

from groundstation.background import in_background
from groundstation.errors import BadInputError, GroundStationError, NotAuthorisedError, TakenError
from groundstation.links.command import CommandLink, CommandState
from groundstation.service.changes import Change, Changes
from groundstation.service.lease import Lease
from groundstation.service.motor_stop import Note

AGAIN_S, AGAIN_MOST_S = 1.0, 60.0
"""Until a value is written back once more where that failed; twice as long each time."""
LOOKS_S = 0.2
RESTORES = "restore"
"""The author of the daemon's own writes, and the kind of its events about them."""
TOLD_MOST = 3
"""Names that an event lists."""


class Parameters:
    """changes: what was written and is not settled. note: told (kind, text)."""

    def __init__(self, changes: Changes, note: Note) -> None:
        self.changes = changes
        self._note = note
        self.turn = asyncio.Lock()  # to write
        self._unsure: set[str] = set()  # names that the craft did not confirm, on this connection
        self._told = ""  # of which craft it was said that values are to be written back
        self._restored: dict[str, dict[str, float]] = {}

    async def write(
        self,
        link: CommandLink,
        lease: Lease,
        values: Mapping[str, float],
        is_in_force: Callable[[], bool],
        heard: Callable[[], None],
    ) -> dict[str, float]:
        """Write parameters for a client; what the craft says they are now. Raises as
        ``Commander.write_parameters``. heard: told after each that the client waits."""
        for name, value in values.items():
            link.require_parameter(name, value)
        async with self.turn:
            present, who = link.parameters(), {"client": lease.client, "uri": link.uri}
            await in_background(lambda: self.changes.note(lease.craft, values, present, **who))
            confirmed = {}
            for name, value in values.items():
                if not is_in_force():
                    raise NotAuthorisedError(
                        f"the lease is over; {name} and what comes after it was not written"
                    )
                self._unsure.add(name)
                confirmed[name] = await link.write_parameter(name, value, client=lease.client)
                self._unsure.discard(name)
                heard()
        return confirmed

    def settle(self, craft: str) -> None:
        """The client that wrote them is content."""
        try:
            self.changes.settle(craft)
        except BadInputError as error:
            self._note("fault", str(error))

    def left(self, link: CommandLink) -> dict[str, tuple[Change, float | None]]:
        """What the craft still holds as it was changed, and its value now, None where the craft is
        not connected."""
        if link.state is not CommandState.CONNECTED:
            return {name: (one, None) for name, one in self.changes.at(link.uri).items()}
        changes = self.changes.of(craft_of(link))
        if not changes:
            return {}
        present = link.parameters()
        return {
            name: (one, present[name])
            for name, one in changes.items()
            if one.is_on(present.get(name)) or (name in self._unsure and name in present)
        }

    def require_restored(self, link: CommandLink) -> None:
        """Raises BadInputError where nobody can tell, TakenError where the craft still holds what
        an earlier lease wrote and nobody settled."""
        if self.changes.trouble:
            raise BadInputError(self.changes.trouble)
        if self.turn.locked():
            raise TakenError("parameters are being written to the craft; try again")
        if left := self.left(link):
            raise TakenError(
                f"the craft still has parameters of a flight that was interrupted"
                f" ({listed(list(left))}): the former values are written back first; try again"
            )

    async def restore(self, link: CommandLink) -> None:
        """Write the former values back to a craft that stands and that nobody commands. Raises
        LinkError where it does not confirm one."""
        async with self.turn:
            craft = craft_of(link)
            left = self.left(link)
            gone = self.changes.of(craft).keys() - left.keys()
            if gone:
                await in_background(lambda: self.changes.settle(craft, gone))
            if not left:
                return
            if self._told != craft:
                self._told = craft
                who = next(iter(left.values()))[0].client
                self._note(RESTORES, f"{who} left {listed(list(left))} unproven on the craft")
            for name, (change, _) in left.items():
                await link.write_parameter(name, change.former, client=RESTORES)
                self._unsure.discard(name)
                self._restored.setdefault(craft, {})[name] = change.former
                await in_background(partial(self.changes.settle, craft, [name]))
            self._told = ""
            said = [f"{name} {change.former:g}" for name, (change, _) in left.items()]
            self._note(RESTORES, f"the former values are back: {listed(said)}")

    async def keep_restored(
        self,
        link: Callable[[], CommandLink | None],
        stands: Callable[[CommandLink], bool],
        look: Callable[[CommandLink, Callable[[CommandLink], bool]], Awaitable[None]],
    ) -> None:
        """Write back what has to be, as soon as there is a craft that stands and that nobody
        commands, and then have a ``look`` at it; for as long as the daemon runs."""
        wait_s, told = AGAIN_S, False
        while True:
            await asyncio.sleep(LOOKS_S)
            craft = link()
            if craft is None or craft.state is not CommandState.CONNECTED:
                self._unsure.clear()  # they are read anew
                wait_s, told = AGAIN_S, False
                continue
            if not stands(craft):
                continue
            try:
                await self.restore(craft)
                await look(craft, stands)
                wait_s, told = AGAIN_S, False
            except GroundStationError as error:
                if not told:
                    self._note("fault", f"former parameters could not be written back: {error}")
                told = True
                await asyncio.sleep(wait_s)
                wait_s = min(2.0 * wait_s, AGAIN_MOST_S)

    def restored(self, link: CommandLink) -> dict[str, float]:
        """What was written back to this craft since the daemon began."""
        return dict(self._restored.get(craft_of(link), {}))


def craft_of(link: CommandLink) -> str:
    """By what the changes of a connected craft are kept."""
    return link.craft_id or link.uri


def listed(names: list[str]) -> str:
    """The first of them, and how many more there are."""
    more = len(names) - TOLD_MOST
    return ", ".join(names[:TOLD_MOST]) + (f" and {more} more" if more > 0 else "")
