"""Our own commands, run by the daemon in processes of their own, and waited for."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys

from groundstation.errors import GroundStationError

PATIENCE_S = 60.0


async def run_command(*arguments: str, patience_s: float = PATIENCE_S) -> tuple[int, bytes, str]:
    """Exit status, standard output, and what was said on standard error. At a low priority.

    Raises GroundStationError where it does not end in time.
    """
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "groundstation.viewer.leash", str(os.getpid())),
        *(sys.executable, "-c", "from groundstation.cli.main import main; main()"),
        *arguments,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={**os.environ, "NO_COLOR": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )
    try:
        async with asyncio.timeout(patience_s):
            out, err = await process.communicate()
    except TimeoutError as error:
        raise GroundStationError(f"{arguments[0]}: no answer within {patience_s:g} s") from error
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
    return process.returncode or 0, out, err.decode(errors="replace").strip()
