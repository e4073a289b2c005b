from __future__ import annotations

from collections.abc import Callable

import ports
import pytest
from wobbling_flights import flight, wobble

__all__ = ["flight", "wobble"]


@pytest.fixture
def free_port() -> Callable[[], int]:
    return ports.free_port
