from __future__ import annotations

import socket
from collections.abc import Callable

import pytest
from wobbling_flights import flight, wobble

__all__ = ["flight", "wobble"]


@pytest.fixture
def free_port() -> Callable[[], int]:
    def find() -> int:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            return probe.getsockname()[1]

    return find
