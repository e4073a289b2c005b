"""Parameters of the craft that is commanded: noted, written, written back, stored."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import math
import os
import struct
import threading
import time
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import msgspec

from groundstation.background import in_background
from groundstation.documents import decode_json, read_document
from groundstation.errors import (
    BadInputError,
    GroundStationError,
    LinkError,
    NotAuthorisedError,
    TakenError,
)
from groundstation.links.command import (
    RESETS_ESTIMATOR,
    CommandLink,
    CommandState,
    ParameterStorage,
)
from groundstation.paths import write_whole
from groundstation.service.lease import FlightEnd, Lease, Note
from groundstation.service.requests import StoredParameter

# The connection to the craft that is commanded: which it is, and that there is one.


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
            away = CommandState.CLOSED, CommandState.LOST
            if link is not None and wanted() and link.state in away:
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


# What clients wrote to crafts and nobody has settled yet, on disk before it is sent: neither a
# killed client nor a killed daemon leaves unproven gains on a craft without a word.


def changes_path() -> Path:
    """The daemon's file, one for each user that runs one."""
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(base) / "groundstation" / "changed.json"


class Change(msgspec.Struct, frozen=True, kw_only=True):
    """One parameter. former: its value before. written: every value that replaced it since.
    client: who wrote it last, time_s: and when, Unix s. uri: of the craft then."""

    former: float
    written: tuple[float, ...]
    client: str
    time_s: float
    uri: str = ""

    def is_on(self, now: float | None) -> bool:
        """Whether the craft, which has ``now``, still holds what was written. Where it does not,
        it was restarted or set anew, and the former value has no business on it any more."""
        if now is None or _single(now) == _single(self.former):
            return False
        return any(_single(now) == _single(one) for one in self.written)


Crafts = dict[str, dict[str, Change]]


class Changes:
    """The changes of all crafts, by the craft's number or else its address; safe to use from any
    thread, and by several daemons of one user.

    trouble: why the file cannot be read, or empty. Nothing is flown then, for nobody knows what a
    craft holds.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._crafts: Crafts = {}
        self._trouble = ""
        self._seen: tuple[int, ...] | None = None  # which content of the file that is

    @property
    def trouble(self) -> str:
        with self._lock:
            self._read()
            return self._trouble

    def of(self, craft: str) -> dict[str, Change]:
        """What was changed on a craft."""
        with self._lock:
            self._read()
            return dict(self._crafts.get(craft, {}))

    def at(self, uri: str) -> dict[str, Change]:
        """What was changed on whichever crafts were at this address."""
        with self._lock:
            self._read()
            found = list(self._crafts.values())
        return {name: one for each in found for name, one in each.items() if one.uri == uri}

    def note(
        self,
        craft: str,
        values: Mapping[str, float],
        present: Mapping[str, float],
        *,
        client: str,
        uri: str,
        unsure: Container[str] = (),
    ) -> None:
        """Say what is about to be written to a craft that has ``present``, of which those may have
        arrived that are ``unsure``. Raises BadInputError where the disk does not keep it."""

        def noted(kept: dict[str, Change]) -> dict[str, Change]:
            new = dict(kept)
            for name, value in values.items():
                if name == RESETS_ESTIMATOR:
                    continue
                before = kept.get(name)
                if before and not before.is_on(present.get(name)) and name not in unsure:
                    before = None  # it was switched off since then, and has its own values again
                former = present[name] if before is None else before.former
                written = () if before is None else before.written
                if _single(value) != _single(former) and value not in written:
                    new[name] = Change(
                        former=former,
                        written=(*written, value),
                        client=client,
                        time_s=time.time(),
                        uri=uri,
                    )
            return new

        self._change(craft, noted)

    def settle(self, craft: str, names: Iterable[str] | None = None) -> None:
        """These changes of a craft, or all of them, are as they are meant to be. Raises
        BadInputError where the disk does not keep that."""
        gone = None if names is None else set(names)

        def settled(kept: dict[str, Change]) -> dict[str, Change]:
            return {} if gone is None else {k: one for k, one in kept.items() if k not in gone}

        self._change(craft, settled)

    def _change(self, craft: str, change: Callable[[dict[str, Change]], dict[str, Change]]) -> None:
        """Replace what is kept of one craft; what other daemons keep of others stays."""
        with self._lock:
            self._read()
            kept = self._crafts.get(craft, {})
            if change(dict(kept)) == kept:
                return
            try:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                with _alone(self.path.with_suffix(".lock")):
                    self._read()
                    if self._trouble:
                        raise BadInputError(self._trouble)
                    crafts = self._crafts | {craft: change(dict(self._crafts.get(craft, {})))}
                    crafts = {name: changes for name, changes in crafts.items() if changes}
                    if crafts:
                        write_whole(self.path, msgspec.json.encode(crafts), durable=True)
                    else:
                        self.path.unlink(missing_ok=True)
                    self._read()
            except OSError as error:
                raise BadInputError(
                    f"{self.path}: cannot be written ({error.strerror}): nobody would know what was"
                    " changed on the craft"
                ) from error

    def _read(self) -> None:
        """Where it is another content than before."""
        try:
            found = self.path.stat()
            seen = (found.st_ino, found.st_mtime_ns, found.st_size)
            if seen == self._seen:
                return
            self._crafts = decode_json(read_document(self.path), Crafts)
            self._seen, self._trouble = seen, ""
        except (FileNotFoundError, NotADirectoryError):
            self._crafts, self._seen, self._trouble = {}, None, ""
        except (OSError, ValueError) as error:
            self._seen = None
            self._trouble = (
                f"{self.path}: cannot be read ({error}), so nobody knows which parameters an"
                " interrupted flight left changed; look at the craft's gains, then remove the file"
            )


@contextlib.contextmanager
def _alone(path: Path) -> Iterator[None]:
    """While no other daemon writes. Raises OSError."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _single(value: float) -> bytes:
    """As a craft holds it, in 32 bits."""
    with contextlib.suppress(OverflowError):
        return struct.pack("<f", value + 0.0)
    return b""


# Parameters of the craft that is commanded: written under a lease, noted before, and the former
# values written back where the lease did not end with its client's consent.


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
        self.unsure: set[str] = set()
        """Names that the craft did not confirm, on this connection."""
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
            note = partial(self.changes.note, lease.craft, values, link.parameters())
            unsure = set(self.unsure)
            await in_background(partial(note, client=lease.client, uri=link.uri, unsure=unsure))
            confirmed, restored = {}, self._restored.get(lease.craft, {})
            for name, value in values.items():
                restored.pop(name, None)
                if not is_in_force():
                    raise NotAuthorisedError(
                        f"the lease is over; {name} and what comes after it was not written"
                    )
                self.unsure.add(name)
                confirmed[name] = await link.write_parameter(name, value, client=lease.client)
                self.unsure.discard(name)
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
            if one.is_on(present.get(name)) or (name in self.unsure and name in present)
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
                self.unsure.discard(name)
                self._restored.setdefault(craft, {})[name] = change.former
                await in_background(partial(self.changes.settle, craft, [name]))
            self._told = ""
            said = [f"{name} {change.former:g}" for name, (change, _) in left.items()]
            self._note(RESTORES, f"the former values are back: {listed(said)}")

    def restored(self, link: CommandLink) -> dict[str, float]:
        """What was written back to this craft since the daemon began, and that nobody has written
        again."""
        return dict(self._restored.get(craft_of(link), {}))


def craft_of(link: CommandLink) -> str:
    """By what the changes of a connected craft are kept."""
    return link.craft_id or link.uri


def listed(names: list[str]) -> str:
    """The first of them, and how many more there are."""
    more = len(names) - TOLD_MOST
    return ", ".join(names[:TOLD_MOST]) + (f" and {more} more" if more > 0 else "")


# What a craft keeps of its parameters while it is switched off: stored and cleared under a lease,
# while its motors stand, and read.


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
        return await self._change(token, names, clears=False)

    async def clear(self, token: str, names: Sequence[str]) -> dict[str, StoredParameter]:
        """Have the craft forget what it has stored of parameters, none: of all gains. Their values
        stay until it is switched off. Raises as ``store``."""
        return await self._change(token, names, clears=True)

    async def _change(
        self, token: str, names: Sequence[str], *, clears: bool
    ) -> dict[str, StoredParameter]:
        lease, link = self._leased(token)
        storage = _storage_of(link)
        for name in names:
            storage.require(name)
        done = list[str]()
        async with self._written.turn:
            await self._landed(token)
            self._end.held = "parameters are being stored"  # no motor may begin
            try:
                present = link.parameters()
                meant = names or [name for name in storage.numbers if name.startswith(GAINS)]
                for name in meant:
                    self._require(token)
                    state = await storage.read(name)
                    if clears and state.stored is not None:
                        self._require(token)
                        await storage.clear(name)
                        done.append(name)
                    kept = state.stored if names else state.loaded
                    if not (clears or _is_same(kept, present[name])):
                        self._require(token)
                        await storage.store(name, present[name])
                        done.append(name)
            except GroundStationError as error:
                raise self._half("cleared" if clears else "stored", done, error) from error
            else:
                if not clears:
                    settle = partial(self._written.changes.settle, craft_of(link), meant)
                    await in_background(settle)
            finally:
                self._end.held = ""
        if done:
            does = "has cleared the stored" if clears else "has stored"
            said = done if clears else [f"{name} {present[name]:g}" for name in done]
            self._note(STORES, f"{lease.client} {does} {listed(said)} on the craft")
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


def _is_same(kept: float | None, present: float) -> bool:
    return kept is not None and math.isclose(kept, present, rel_tol=1e-6)


def _storage_of(link: CommandLink) -> ParameterStorage:
    if link.storage is None:
        raise BadInputError(f"{link.uri}: {KEEPS_NOTHING}")
    return link.storage
