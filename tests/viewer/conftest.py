from __future__ import annotations

from collections.abc import Callable

import pytest

from support import programs
from support.coroutines import pytest_pyfunc_call as pytest_pyfunc_call
from support.packets import wobble, wobbling_flight

__all__ = ["wobble", "wobbling_flight"]


@pytest.fixture
def free_port() -> Callable[[], int]:
    return programs.free_port
