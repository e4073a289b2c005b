"""How long a call takes, on a machine that others use too."""

from __future__ import annotations

import time
from collections.abc import Callable


def best(
    call: Callable[[], object],
    times: int,
    *,
    warm: bool = True,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """The shortest of several calls in seconds: what else the machine does only adds to it.

    warm: call once before, so that nothing is compiled or read for the first time. clock:
    ``time.process_time`` where others share the processor.
    """
    if warm:
        call()
    taken = []
    for _ in range(times):
        start = clock()
        call()
        taken.append(clock() - start)
    return min(taken)
