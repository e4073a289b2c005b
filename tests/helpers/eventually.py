"""Waiting for what a program does in its own time."""

import asyncio

PATIENCE_S = 60.0
"""A machine that is busy with other tests holds programs up for many seconds."""


async def until(condition, what="what is waited for"):
    """Return once ``condition()`` holds; what: says what never happened where it does not."""
    try:
        async with asyncio.timeout(PATIENCE_S):
            while not condition():
                await asyncio.sleep(0.005)
    except TimeoutError:
        raise AssertionError(f"never happened in {PATIENCE_S:g} s: {what}") from None
