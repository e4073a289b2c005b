"""The same work on many recordings: on this process, on this machine's cores, on a cluster.

Dask carries it (``dask.distributed``). A task is a batch of recordings, so that the scheduler's
cost stays small beside the work, and only so many are under way at once, so that neither the
scheduler's memory nor this process's grows with the number of recordings. A worker that dies costs
its batches, which are begun again; the recording that kills one again and again is set aside.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

from groundstation.errors import BadInputError

if TYPE_CHECKING:
    from distributed import Client, Future

Task = TypeVar("Task")
Result = TypeVar("Result")

MOST_AT_ONCE = 3
"""Batches under way for each worker: the next is there when one is done."""
LARGEST_BATCH = 50
DEATHS = 3
"""A batch whose workers died so often is taken apart; a recording alone is set aside."""
CONNECT_S = 10
HINT = "pip install -e '.[fleet]'"


def cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0))


def carried_out(
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    *,
    workers: int,
    scheduler: str | None = None,
) -> Iterator[tuple[Task, Result | None]]:
    """(task, result) as they arrive, in any order; None for one that workers die of.

    tasks: a recording's address, or whatever else is small and can be pickled. work: a function of
    a module, called once for each; it must not raise. workers: 1 is this process alone, without
    Dask. scheduler: ``tcp://HOST:PORT`` of a running one, whose workers must be able to read the
    recordings.

    Raises BadInputError where Dask is missing or the scheduler does not answer.
    """
    if scheduler is None and (workers == 1 or len(tasks) <= 1):
        for task in tasks:
            yield task, work(task)
        return
    with _client(workers, scheduler) as client:
        count = max(1, sum(client.nthreads().values()))
        size = min(LARGEST_BATCH, max(1, math.ceil(len(tasks) / (8 * count))))
        yield from _batched(client, work, _batches(tasks, size), MOST_AT_ONCE * count)


def _batches(tasks: Sequence[Task], size: int) -> Iterator[list[Task]]:
    rest = iter(tasks)
    while batch := list(islice(rest, size)):
        yield batch


def _batched(
    client: Client, work: Callable[[Task], Result], batches: Iterable[list[Task]], most: int
) -> Iterator[tuple[Task, Result | None]]:
    from distributed import KilledWorker, as_completed

    waiting = iter(batches)
    under_way: dict[Future, list[Task]] = {}

    def begin(batch: list[Task]) -> Future:
        future = client.submit(_each, work, batch, pure=False)
        under_way[future] = batch
        return future

    suspects: list[Task] = []
    first = [begin(batch) for batch in islice(waiting, most)]
    arriving = as_completed(first, loop=client.loop)
    for future in arriving:
        batch = under_way.pop(future)
        try:
            results = future.result()
        except KilledWorker:
            if len(batch) == 1:
                suspects += batch
            for task in batch if len(batch) > 1 else ():
                arriving.add(begin([task]))
        else:
            yield from zip(batch, results, strict=True)
        future.release()
        for batch in islice(waiting, max(0, most - len(under_way))):
            arriving.add(begin(batch))
    # The scheduler blames all that a dead worker had before it: who is alone is guilty.
    for task in suspects:
        try:
            yield task, begin([task]).result()[0]
        except KilledWorker:
            yield task, None


def _each(work: Callable[[Task], Result], batch: list[Task]) -> list[Result]:
    return [work(task) for task in batch]


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Client]:
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise BadInputError(
            f"Dask, which carries the work to more than one core, is not installed: {HINT}; or"
            " say --workers 1"
        ) from error
    settings: dict[str, Any] = {
        "distributed.scheduler.allowed-failures": DEATHS - 1,
        "distributed.admin.log-format": "%(message)s",
        "distributed.logging": {"distributed": "critical"},
    }
    with dask.config.set(settings):
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
            except (OSError, ValueError) as error:
                raise BadInputError(
                    f"--scheduler {scheduler}: does not answer within {CONNECT_S} s; begin one"
                    " with: dask scheduler"
                ) from error
            with client:
                yield client
            return
        with (
            LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
                silence_logs=50,
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):
            yield client
