"""What clients wrote to crafts and nobody has settled yet, on disk before it is sent: neither a
killed client nor a killed daemon leaves unproven gains on a craft without a word."""

from __future__ import annotations

import contextlib
import fcntl
import os
import struct
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import msgspec

from groundstation.documents import decode_json, read_document
from groundstation.errors import BadInputError
from groundstation.links.command import RESETS_ESTIMATOR
from groundstation.paths import write_whole


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
    ) -> None:
        """Say what is about to be written to a craft that has ``present``. Raises BadInputError
        where the disk does not keep it."""

        def noted(kept: dict[str, Change]) -> dict[str, Change]:
            new = dict(kept)
            for name, value in values.items():
                if name == RESETS_ESTIMATOR:
                    continue
                before = kept.get(name)
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
                    self._write({name: changes for name, changes in crafts.items() if changes})
            except OSError as error:
                raise BadInputError(
                    f"{self.path}: cannot be written ({error.strerror}): nobody would know what was"
                    " changed on the craft"
                ) from error

    def _write(self, crafts: Crafts) -> None:
        if crafts:
            write_whole(self.path, msgspec.json.encode(crafts), durable=True)
        else:
            self.path.unlink(missing_ok=True)
        self._read()

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
