"""Ports for programs that tests start."""

import contextlib
import itertools
import os
import socket

PORTS = range(20_000, 32_000)
_PORTS = itertools.islice(itertools.cycle(PORTS), 131 * os.getpid() % len(PORTS), None)


def free_port() -> int:
    """One that nobody has, for TCP or UDP: another one each time, and below those that the system
    gives to whoever asks for any, for it would give this one away before it is used."""
    for _ in PORTS:
        port = next(_PORTS)
        with contextlib.suppress(OSError), contextlib.ExitStack() as probes:
            for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
                probe = probes.enter_context(socket.socket(socket.AF_INET, kind))
                probe.bind(("127.0.0.1", port))
            return port
    raise RuntimeError(f"no port from {PORTS.start} to {PORTS.stop - 1} is free")
