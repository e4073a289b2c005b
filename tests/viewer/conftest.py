from __future__ import annotations

from collections.abc import Callable

import pytest

from support import programs as ports
from support.packets import wobble
from support.packets import wobbling_flight as flight

__all__ = ["flight", "wobble"]


@pytest.fixture
def free_port() -> Callable[[], int]:
    return ports.free_port
