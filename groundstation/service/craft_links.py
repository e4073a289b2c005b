"""Which craft is heard and which is commanded: the telemetry link, the command link, and whether
both lead to the same one."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable
from functools import cache
from typing import Any

import msgspec

from groundstation.background import in_background
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError, TakenError
from groundstation.links.base import Link
from groundstation.links.command import CommandLink, HostClock, ways_of
from groundstation.links.factory import (
    CRAFT,
    is_stand_in,
    make_command_link,
    make_link,
    serve_commands,
)
from groundstation.service.commander import Commander
from groundstation.service.config import DEFAULT_VEHICLE, Config, link_speed
from groundstation.service.dongles import Dongles
from groundstation.service.journal import Journal
from groundstation.service.receiver import Receiver
from groundstation.telemetry.samples import LogTable


def telemetry_link(
    config: Config,
    name: str,
    journal: Journal,
    clock: HostClock,
    *,
    on_table: Callable[[LogTable], None],
    port: str,
    model: str = "",
) -> Link:
    """A link as configured, that tells the journal. on_table: given what a craft logs besides.
    port: where a stand-in takes commands. model: file of the model that ``stand-in:MODEL`` names.
    Raises BadInputError."""
    link = make_link(
        name,
        speed=link_speed(config.link.speed),
        stand_in=config.stand_in,
        model=model,
        command=port,
        usb=msgspec.to_builtins(config.usb),
        rate_hz=config.radio.rate_hz,
        wanted=[name.strip() for name in config.radio.log.split(",") if name.strip()],
        clock=clock,
    )
    link.on_event, link.on_table = journal.take, on_table
    return link


def command_link(config: Config, telemetry: Link, clock: HostClock) -> CommandLink | None:
    """The configured one, or that of a craft that is commanded where its telemetry comes from."""
    own = telemetry.commands
    if config.command and (own is None or config.command != own.uri):
        return make_command_link(config.command, clock=clock)
    return own


class CraftLinks:
    """The links of the moment, and what an operator can choose instead.

    on_entry: given what is sent to the craft, for the recording.
    """

    def __init__(
        self,
        config: Config,
        journal: Journal,
        clock: HostClock,
        receiver: Receiver,
        commander: Commander,
        *,
        on_entry: Callable[[dict[str, Any]], None],
    ) -> None:
        self.metadata = {"profile": config.vehicle or DEFAULT_VEHICLE}
        """What recordings say of the vehicle, kept true."""
        self._config, self._journal, self._clock = config, journal, clock
        self._receiver, self._commander = receiver, commander
        self._on_entry = on_entry
        self._port = config.command  # at which a stand-in takes commands
        self._switching = False
        self._dongles = Dongles()
        self.command_uri = ""
        if commander.link is not None:
            self._listen(commander.link)

    @property
    def vehicle(self) -> str:
        """The profile that recordings name."""
        return self.metadata["profile"]

    async def switch(self, name: str, model: str = "") -> None:
        """Receive from another link, the recording going on. Where it cannot be opened the
        present one stays: LinkError or BadInputError; TakenError while a client commands.

        model: file of the model that ``stand-in:MODEL`` names."""
        await self._commander.leave()
        async with self._another(name):
            link = telemetry_link(
                self._config,
                name,
                self._journal,
                self._clock,
                on_table=self._receiver.link.on_table,
                port=self._port,
                model=model,
            )
            self._receiver.require_other(link)  # before anybody's port is given back
            before = self._receiver.link
            async with _port_of(before, link):
                await self._receiver.switch(link, self._commander.leave)
            if link.commands is not None:  # one connection carries both: commands follow
                await self._command_by(link.commands)
            elif is_stand_in(before.name):  # the craft that took commands is gone
                await self._commander.disconnect()
        self.tell()

    async def connect_command(self, uri: str) -> None:
        """Command the craft at ``uri`` from now on; it is connected as soon as it answers. A
        stand-in that is flown answers there. Raises BadInputError, TakenError."""
        if not uri.startswith(CRAFT):
            raise BadInputError(f"command link {uri!r}: give {' or '.join(CRAFT)}...")
        await self._commander.leave()
        telemetry = self._receiver.link
        own = telemetry.commands
        if own is None or own.uri != uri:
            own = make_command_link(uri, clock=self._clock)
        async with self._another(uri):
            await serve_commands(telemetry, uri)
            await self._command_by(own)
        self._port = uri
        self.tell_no_craft()

    def tell(self) -> None:
        """Of a link that was just opened."""
        self.tell_no_craft()
        self._tell_vehicle()

    def tell_no_craft(self) -> None:
        """Of a command link that is not used with this telemetry, before somebody wonders."""
        if self.command_uri and (reason := self.no_craft()):
            self._journal.note("waiting", f"not connected: {reason}", source=self.command_uri)

    def no_craft(self) -> str:
        """Why nothing that could be commanded is behind the telemetry, or empty."""
        return "the link is being switched" if self._switching else self._mismatch()

    def _mismatch(self) -> str:
        link = self._receiver.link
        if link.finite:
            return f"{link.name} is a recording"
        if is_stand_in(link.name) and not self.command_uri.startswith("udp://"):
            # who watches a simulated flight must not fly a real craft
            return f"the telemetry is the stand-in's, and {self.command_uri} is another craft"
        return ""

    def is_heard(self, command: CommandLink) -> bool:
        """Whether the telemetry is that of the craft that ``command`` leads to."""
        own = self._receiver.link.commands
        return not self._mismatch() and (own is None or own.uri == command.uri)

    def out_of_reach(self) -> str:
        """Why the craft that is heard cannot be stopped from here, or empty: where there is none,
        or where commands go to it as far as anybody knows."""
        telemetry, command = self._receiver.link, self._commander.link
        if telemetry.finite or command is None or self._switching:
            return ""
        if telemetry.commands is not None and telemetry.commands.uri != command.uri:
            return (
                f"the craft that is heard ({telemetry.name}) cannot be stopped from here: commands"
                f" go to {command.uri}"
            )
        return ""

    def flies_by_dongle(self) -> bool:
        """Whether a dongle or cable is in use, so that nobody else may look for craft with it."""
        return any(uri.startswith(("radio://", "usb://")) for uri in self._uris())

    async def hold_dongles(self) -> None:
        """What the links of the moment use is ours alone. Raises TakenError where another program
        has one."""
        await self._hold(*self._uris())

    def close(self) -> None:
        """Leave the dongles to others, when the links are closed. Safe to call twice."""
        self._dongles.close()

    async def _hold(self, *uris: str) -> None:
        self._dongles.take(await in_background(lambda: ways_of(uris)))

    @contextlib.asynccontextmanager
    async def _another(self, uri: str) -> AsyncIterator[None]:
        """While a link is exchanged: the dongle of the next one is ours before, and that of the
        one that was left is free behind. Raises TakenError where another program has it."""
        if self._switching:
            raise TakenError("the link is being switched already")
        self._switching = True
        try:
            await self._hold(uri)
            yield
        finally:
            self._switching = False
            self._dongles.keep(self._uris())

    def _uris(self) -> tuple[str, str]:
        command = self._commander.link
        return self._receiver.link.name, "" if command is None else command.uri

    def _tell_vehicle(self) -> None:
        """What the craft says it is goes into the recordings, unless the configuration says."""
        link = self._receiver.link
        said, configured = link.vehicle, self._config.vehicle
        self.metadata["profile"] = configured or said or DEFAULT_VEHICLE
        if said and configured and said != configured:
            self._journal.note(
                "vehicle",
                f"the craft says it is a {said}; recordings say {configured}, as configured",
                source=link.name,
            )

    async def _command_by(self, link: CommandLink) -> None:
        """From now on. Raises TakenError while motors are not known to have stopped."""
        if link is not self._commander.link:
            await self._commander.replace(link)
            self._listen(link)

    def _listen(self, command: CommandLink) -> None:
        command.on_event = self._journal.take
        command.on_entry = self._on_entry
        command.on_table = self._receiver.link.on_table
        self.command_uri = command.uri


def contradiction(configured: str, said: str) -> str:
    """Why a craft that says it is a ``said`` is not the configured one, or empty. A 2.1, a 2.1+ and
    a profile of one's own are called alike by the firmware."""
    if not said or not configured or _kind(said) == _kind(configured):
        return ""
    return (
        f"the craft says it is a {said}, and the daemon was told that it is a {configured}: begin"
        " it without --set vehicle, or with the right one"
    )


@cache
def _kind(vehicle: str) -> tuple[str, bool]:
    """What the firmware tells apart: whose loops fly it, and whether its motors are brushless."""
    profile = load_vehicle(vehicle)
    return profile.firmware, profile.is_brushless


@contextlib.asynccontextmanager
async def _port_of(before: Link, link: Link) -> AsyncIterator[None]:
    """One stand-in after the other answers commands at the same port."""
    from groundstation.links.stand_in import StandInLink

    if not (isinstance(before, StandInLink) and isinstance(link, StandInLink)):
        yield
        return
    await before.serve_no_more()
    try:
        yield
    except BaseException:
        await before.serve()
        raise
