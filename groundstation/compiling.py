"""What is being compiled at this moment, because this machine keeps no compiled code of it yet."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import AsyncIterator, Callable

LOOK_S = 0.25

_begun: Counter[str] = Counter()


def begin(name: str) -> None:
    """The kernel ``name`` was not kept: it is compiled now."""
    _begun[name] += 1


def end(name: str) -> None:
    """The kernel ``name`` is compiled, and kept."""
    _begun[name] -= 1


def compiles() -> bool:
    """Whether anything is being compiled."""
    return any(count > 0 for count in _begun.values())


@contextlib.asynccontextmanager
async def announced(tell: Callable[[], object]) -> AsyncIterator[None]:
    """Call ``tell`` once where something has to be compiled while the block runs."""

    async def look() -> None:
        while not compiles():
            await asyncio.sleep(LOOK_S)
        tell()

    looking = asyncio.create_task(look(), name="look for compiling")
    try:
        yield
    finally:
        looking.cancel()
