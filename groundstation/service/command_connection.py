"""The connection to the craft that is commanded: which it is, and that there is one."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from groundstation.errors import BadInputError, LinkError
from groundstation.links.command import CommandLink, CommandState
from groundstation.service.motor_stop import Note

RECONNECT_S, RECONNECT_FAILED_S = 0.5, 5.0


class CommandConnection:
    """link: None where the daemon was given none. note: told (kind, text)."""

    def __init__(self, link: CommandLink | None, note: Note) -> None:
        self.link = link
        self._note = note
        self._connecting = asyncio.Lock()

    def require(self) -> CommandLink:
        """Raises BadInputError where there is none."""
        if self.link is None:
            raise BadInputError(
                "the daemon has no command link; start it with --command udp://HOST:PORT or "
                "radio://..."
            )
        return self.link

    def require_connected(self, refused: str = "") -> CommandLink:
        """Raises LinkError too, where the craft does not answer. refused: what then was not
        done."""
        link = self.require()
        if link.state is not CommandState.CONNECTED:
            raise LinkError(
                f"{link.uri} is not connected ({link.state.value}){refused and ': '}{refused}"
            )
        return link

    async def keep(self, wanted: Callable[[], bool]) -> None:
        """Connect whenever ``wanted`` and there is no connection."""
        told = ""
        while True:
            link = self.link
            if link is not None and wanted() and _is_away(link):
                try:
                    async with self._connecting:
                        if link is self.link:
                            await link.close()
                            await link.open()
                    told = ""
                except LinkError as error:
                    if str(error) != told:
                        told = str(error)
                        self._note("waiting", told)
                    await asyncio.sleep(RECONNECT_FAILED_S)
            await asyncio.sleep(RECONNECT_S)

    async def close(self, link: CommandLink | None) -> None:
        """End one that is the present one no more, behind the attempt to connect it."""
        async with self._connecting:
            if link is not None:
                await link.close()


def _is_away(link: CommandLink) -> bool:
    return link.state in (CommandState.CLOSED, CommandState.LOST)
