"""Ports of the loopback interface."""

from __future__ import annotations

import socket

from groundstation.errors import TakenError


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
