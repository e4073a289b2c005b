"""Child processes of the live view: their mode, their ports, their end."""

from __future__ import annotations

import contextlib
import enum
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence

from groundstation.errors import TakenError

# How the live view is shown.


class ViewerMode(enum.StrEnum):
    OFF = "off"
    """No viewer."""
    SERVE = "serve"
    """Serve the live view on this machine, for a browser or a rerun viewer."""
    SPAWN = "spawn"
    """Serve, and open a rerun window."""


# Ports of the loopback interface.


def listen_on(port: int, name: str) -> socket.socket:
    """A port of 127.0.0.1. Raises TakenError where another program holds it."""
    listening = socket.socket()
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(("127.0.0.1", port))
        listening.listen(64)
    except OSError as error:
        listening.close()
        raise TakenError(
            f"{name} port {port} is taken ({error.strerror}): end the program that holds it "
            "or choose another port"
        ) from error
    return listening


def free_port(address: str) -> int:
    """A port of ``address`` that nobody has at the moment."""
    with socket.socket() as probe:
        probe.bind((address, 0))
        return int(probe.getsockname()[1])


# A supervised child process that cannot outlive this one, and whose last words are kept.


_COLOR = re.compile(r"\x1b\[[0-9;]*m")
_TAIL_BYTES = 4096


class Child:
    """Runs ``command``; nothing here blocks.

    Start it from a thread that lives as long as the program: the parent-death signal is bound
    to the thread.
    """

    def __init__(
        self,
        command: Sequence[str],
        *,
        pass_fds: Sequence[int] = (),
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._tail = b""
        self._unsaid = b""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "groundstation.viewer.leash", str(os.getpid()), "5", *command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            pass_fds=pass_fds,
            start_new_session=True,  # Ctrl-C in the terminal is the daemon's to handle
            # rerun: errors only, and no usage statistics (it sends none where CI is set)
            env={
                **os.environ,
                "RUST_LOG": "error",
                "CI": "1",
                "NO_COLOR": "1",
                **(environment or {}),
            },
        )
        assert self._process.stderr is not None
        self._errors = self._process.stderr
        os.set_blocking(self._errors.fileno(), False)

    @property
    def pid(self) -> int:
        return self._process.pid

    def poll(self) -> int | None:
        """The exit status, or None while it runs. Also drains what it says."""
        if self._errors.closed:
            return self._process.returncode
        with contextlib.suppress(BlockingIOError):
            while piece := os.read(self._errors.fileno(), 65536):
                self._tail = (self._tail + piece)[-_TAIL_BYTES:]
                self._unsaid = (self._unsaid + piece)[-_TAIL_BYTES:]
        status = self._process.poll()
        if status is not None:
            self._errors.close()
        return status

    def new_lines(self) -> list[str]:
        """The lines that it wrote to stderr since the last call, as far as ``poll`` has them."""
        *lines, self._unsaid = self._unsaid.split(b"\n")
        return [line.decode(errors="replace") for line in lines]

    @property
    def last_words(self) -> str:
        """The last line that it wrote to stderr, or its exit status."""
        lines = _COLOR.sub("", self._tail.decode(errors="replace")).split("\n")
        spoken = [line.strip() for line in lines if line.strip()]
        if spoken:
            return spoken[-1]
        status = self._process.returncode
        if status is not None and status < 0:
            return f"killed by {signal.Signals(-status).name}"
        return f"exit status {status}"

    def kill(self) -> None:
        """Send SIGKILL, which a stopped process cannot refuse either; ``poll`` until it is gone."""
        if self._process.returncode is None:
            self._process.kill()
