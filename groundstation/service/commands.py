"""Our own commands, run by the daemon in processes of their own, and waited for."""

from __future__ import annotations

import asyncio
import contextlib
import os
import resource
import sys
from collections.abc import Sequence

from groundstation.errors import GroundStationError

PATIENCE_S = 60.0
MEMORY_SHARE = 0.5
"""Of this machine's memory, for one process of ours beside the recorder."""


def own_program(*words: str, niceness: int = 5) -> tuple[str, ...]:
    """What starts Python with ``words`` so that it ends with this process. niceness: beyond
    ours."""
    return (
        sys.executable,
        "-m",
        "groundstation.viewer.leash",
        str(os.getpid()),
        str(niceness),
        sys.executable,
        *words,
    )


def own_command(*arguments: str, niceness: int = 5) -> tuple[str, ...]:
    """The same with one of our commands."""
    main = "from groundstation.cli.main import main; main()"
    return own_program("-c", main, *arguments, niceness=niceness)


def own_environment() -> dict[str, str]:
    """For such a process: more threads than one would take the cores from the recorder."""
    threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
    return {**os.environ, "NO_COLOR": "1", **dict.fromkeys(threads, "1")}


def limit_memory(pid: int) -> None:
    """Let a process that has just been started, and those it starts, have no more than its share
    of this machine's memory: it fails alone, and the recorder is not ended in its place."""
    most = round(MEMORY_SHARE * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with contextlib.suppress(ProcessLookupError):  # it has ended already
        resource.prlimit(pid, resource.RLIMIT_DATA, (most, most))


async def run_command(*arguments: str, patience_s: float = PATIENCE_S) -> tuple[int, bytes, str]:
    """Exit status, standard output, and what was said on standard error. At a low priority.

    Raises GroundStationError where it does not end in time.
    """
    return await run_program(own_command(*arguments), arguments[0], patience_s)


async def run_program(
    words: Sequence[str], name: str, patience_s: float, *, bounded: bool = False
) -> tuple[int, bytes, str]:
    """The same of any program of ours. name: what it is called where it is late. bounded: to its
    share of the memory (``limit_memory``)."""
    process = await asyncio.create_subprocess_exec(
        *words,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=own_environment(),
    )
    if bounded:
        limit_memory(process.pid)
    try:
        async with asyncio.timeout(patience_s):
            out, err = await process.communicate()
    except TimeoutError as error:
        raise GroundStationError(f"{name}: no answer within {patience_s:g} s") from error
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
    return process.returncode or 0, out, err.decode(errors="replace").strip()
