"""Work on many recordings, on this machine or a cluster, and the tables that it fills."""

from __future__ import annotations

import fcntl
import math
import os
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from groundstation import __version__
from groundstation.allocator import KEPT_BYTES
from groundstation.errors import (
    BadInputError,
    GroundStationError,
    RecordingError,
    TakenError,
    install,
)
from groundstation.identification.estimate import Progress
from groundstation.paths import written_whole

if TYPE_CHECKING:
    from distributed import Client, Future, as_completed

# A table that grows while results arrive: a folder of Parquet files, each whole or not there.
#
# A run that is killed leaves what it had finished; the next run goes on. For a key that stands in
# several files the newest counts, and ``compact`` writes it once.


Row = dict[str, Any]
PART_ROWS = 10_000
"""A file of a compacted table: some MB, read in some hundredths of a second."""
_SUFFIX = ".parquet"


class Parts:
    """Rows by key in a folder.

    columns: name -> kind (text, number, count, texts, numbers); any value may be None. key: the
    column that tells rows apart.
    """

    def __init__(self, folder: Path, columns: Mapping[str, str], key: str) -> None:
        self._folder = folder
        self._columns = columns
        self._key = key

    def rows(self, columns: Sequence[str] | None = None) -> dict[str, Row]:
        """The newest row of each key, by key in alphabetical order.

        columns: only these and the key, for a table may have more rows than memory.

        Raises RecordingError where a file cannot be read.
        """
        while True:
            found: dict[str, Row] = {}
            try:
                for path in self._files():
                    for row in self._read(path, columns).to_pylist():
                        found[row[self._key]] = row
            except FileNotFoundError:  # another run has just put it together with others
                continue
            return dict(sorted(found.items()))

    def append(self, rows: Sequence[Row]) -> None:
        """Adds a file with these rows, or nothing.

        Raises RecordingError where it cannot be written.
        """
        import pyarrow as pa

        if rows:
            table = pa.Table.from_pylist(list(rows), schema=self._schema())
            self._write(self._next(), table)

    def compact(self, keys: Sequence[str] | None = None) -> None:
        """Each row once, in few files; of ``keys`` alone where given. Nothing is written where it
        is so already."""
        import pyarrow as pa

        old = self._files()
        if not old:
            return
        table = pa.concat_tables(self._read(path) for path in old)
        newest = {key: row for row, key in enumerate(table.column(self._key).to_pylist())}
        wanted = newest.keys() if keys is None else newest.keys() & set(keys)
        if len(table) == len(wanted) and len(old) <= 2 + 2 * (len(table) // PART_ROWS):
            return
        table = table.take(pa.array(sorted(newest[key] for key in wanted), pa.int64()))
        first = self._next()
        numbers = range(first, first - (-len(table) // PART_ROWS))
        try:
            for number, row in zip(numbers, range(0, len(table), PART_ROWS), strict=True):
                self._write(number, table.slice(row, PART_ROWS))
        except RecordingError:
            for number in numbers:  # the old ones are whole: leave the disk as it was
                self._path(number).unlink(missing_ok=True)
            raise
        for path in old:  # the new ones are newer, so that a crash in between changes nothing
            path.unlink()

    def _files(self) -> list[Path]:
        if not self._folder.is_dir():
            return []
        named = (one for one in self._folder.iterdir() if one.suffix == _SUFFIX)
        return sorted(one for one in named if one.stem.isdecimal())  # what others put there stays

    def _next(self) -> int:
        files = self._files()
        return int(files[-1].stem) + 1 if files else 0

    def _schema(self) -> Any:
        import pyarrow as pa

        kinds = {
            "text": pa.string(),
            "number": pa.float64(),
            "count": pa.int64(),
            "texts": pa.list_(pa.string()),
            "numbers": pa.list_(pa.float64()),
        }
        return pa.schema([(name, kinds[kind]) for name, kind in self._columns.items()])

    def _path(self, number: int) -> Path:
        return self._folder / f"{number:08d}{_SUFFIX}"

    def _read(self, path: Path, columns: Sequence[str] | None = None) -> Any:
        """An Arrow table of all our columns, or of these and the key."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        schema = self._schema()
        wanted = [name for name in schema.names if columns is None or name in (*columns, self._key)]
        try:
            # a table of an older version has fewer columns: those are null
            table = pq.read_table(path, columns=wanted, schema=schema, partitioning=None)
            if table.column(self._key).null_count:
                raise pa.ArrowInvalid(f"rows without {self._key!r}: not a part of this")
        except FileNotFoundError:
            raise
        except (OSError, pa.ArrowException) as error:
            raise RecordingError(
                f"{path}: cannot be read ({error}); remove it, what it held is computed again"
            ) from error
        return table

    def _write(self, number: int, table: Any) -> None:
        import pyarrow.parquet as pq

        path = self._path(number)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with written_whole(path) as file:
                pq.write_table(table, file, compression="zstd")
        except OSError as error:
            why = os.strerror(error.errno) if error.errno else str(error)
            raise RecordingError(
                f"{path}: cannot be written: {why}; what came before is kept, run it again when"
                " there is space"
            ) from error


@contextmanager
def held(catalogue: Path) -> Iterator[None]:
    """Only one run at a time changes a catalogue.

    Raises TakenError where another does, BadInputError where the folder cannot be used.
    """
    try:
        catalogue.mkdir(exist_ok=True)
        lock = os.open(catalogue / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        raise BadInputError(f"{catalogue}: cannot be used: {error.strerror}") from error
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise TakenError(
                f"{catalogue}: another run is working on this catalogue; wait for it to end"
            ) from error
        yield
    finally:
        os.close(lock)


# The same work on many recordings: on this process, on this machine's cores, on a cluster.
#
# Dask carries it (``dask.distributed``). A task is a batch of recordings, so that the scheduler's
# cost stays small beside the work, and only so many are under way at once, so that neither the
# scheduler's memory nor this process's grows with the number of recordings. A worker that dies
# costs its batches, which are begun again; the recording that kills one again and again is set
# aside.


Task = TypeVar("Task")
Result = TypeVar("Result")

MOST_AT_ONCE = 3
"""Batches under way for each worker: the next is there when one is done."""
LARGEST_BATCH = 50
DEATHS = 3
"""A batch whose workers died so often is taken apart; a recording alone is set aside."""
CONNECT_S = 10
LOOK_S = 5.0
"""So often is asked how many workers there are: some join or leave on the way."""
LOST_S = 1e6
"""No run is so long."""
GONE_S, POLL_S = 60.0, 0.01
"""Without any worker of its own for so long a run ends: one begins within some seconds. So often is
looked whether something has arrived; batches take longer."""


def cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0))


def carried_out(
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    *,
    workers: int,
    scheduler: str | None = None,
    largest: int = LARGEST_BATCH,
) -> Iterator[tuple[Task, Result | None]]:
    """(task, result) as they arrive, in any order; None for one that workers die of.

    tasks: a recording's address, or whatever else is small and can be pickled. work: a function of
    a module, called once for each; it must not raise. workers: 1 is this process alone, without
    Dask. scheduler: ``tcp://HOST:PORT`` of a running one, whose workers must be able to read the
    recordings. largest: so many tasks are one of the scheduler's at most, what a worker that dies
    costs.

    Raises BadInputError where Dask is missing or the scheduler does not answer, GroundStationError
    where it goes away, or where this machine's workers ended and none began anew.
    """
    workers = min(workers, len(tasks))
    if scheduler is None and workers <= 1:
        for task in tasks:
            yield task, work(task)
        return
    with _client(workers, scheduler) as client:
        threads = _Threads(client, scheduler is None)
        if scheduler is not None and not threads.count:
            try:
                client.wait_for_workers(1, timeout=CONNECT_S)
            except TimeoutError:
                warnings.warn(
                    f"--scheduler {scheduler}: has no worker; waiting for one, begun with: dask"
                    f" worker {scheduler}",
                    stacklevel=2,
                )
            threads.look()
        yield from _through(client, work, _batched(tasks, max(1, threads.count), largest), threads)


def _batched(tasks: Sequence[Task], threads: int, largest: int) -> deque[list[Task]]:
    """Ever smaller ones, so that all workers are done at about the same time."""
    batches: deque[list[Task]] = deque()
    begun = 0
    while begun < len(tasks):
        size = min(largest, math.ceil((len(tasks) - begun) / (8 * threads)))
        batches.append(list(tasks[begun : begun + size]))
        begun += size
    return batches


class _Threads:
    """How many threads the workers of a scheduler have, asked now and then. own: whether this
    program began them."""

    def __init__(self, client: Client, own: bool) -> None:
        self._client, self._own = client, own
        self._seen_s = time.monotonic()
        self.count = 0
        self.look()

    def look(self) -> None:
        self.count, self._looked = sum(self._client.nthreads().values()), time.monotonic()
        if self.count:
            self._seen_s = self._looked

    def require(self) -> None:
        """Raises GroundStationError where own workers have ended and none was begun anew. Others'
        may still join."""
        if self._own and not self.now() and time.monotonic() - self._seen_s > GONE_S:
            raise GroundStationError(
                "the worker processes ended and none began anew; what has arrived is kept, run it"
                " again to go on"
            )

    def now(self) -> int:
        if time.monotonic() - self._looked >= LOOK_S:
            with suppress(OSError):  # a scheduler that went away shows in what is under way
                self.look()
        return self.count


def _through(
    client: Client, work: Callable[[Task], Result], batches: deque[list[Task]], threads: _Threads
) -> Iterator[tuple[Task, Result | None]]:
    """All batches through one client. Raises GroundStationError where its scheduler goes away."""
    from distributed import KilledWorker, as_completed
    from distributed.client import ClosedClientError
    from distributed.comm import CommClosedError

    under_way: dict[Future, list[Task]] = {}
    suspects: list[Task] = []  # workers died of them while nothing but they was in the batch

    def begin() -> list[Future]:
        begun: list[Future] = []
        most = MOST_AT_ONCE * max(1, threads.now())
        while batches and len(under_way) < most:
            begun.append(client.submit(_each, work, batches[0], pure=False))
            under_way[begun[-1]] = batches.popleft()
        return begun

    try:
        arriving = as_completed(begin(), loop=client.loop)
        for future in _bounded(arriving, threads):
            try:
                results = future.result()
            except (ImportError, AttributeError, RuntimeError) as error:
                cause = error.__cause__ or error  # of what Dask says of a task that it cannot read
                said = f"{type(cause).__name__}: {str(cause).splitlines()[0]}"
                raise GroundStationError(
                    f"the scheduler or its workers cannot take the work up: {said}; they"
                    " need this version of groundstation installed, and for a bench to be begun in"
                    " a checkout by: python -m dask worker (or scheduler)"
                ) from error
            except KilledWorker:
                batch = under_way.pop(future)
                if len(batch) == 1:
                    suspects += batch
                else:
                    batches.extend([task] for task in batch)
            else:
                yield from zip(under_way.pop(future), results, strict=True)
            future.release()
            arriving.update(begin())
        # The scheduler blames all that a dead worker had before it: who is alone is guilty.
        for task in suspects:
            alone = as_completed([client.submit(_each, work, [task], pure=False)], loop=client.loop)
            try:
                result = next(_bounded(alone, threads)).result()[0]
            except KilledWorker:
                result = None
            yield task, result
    except (CancelledError, ClosedClientError, CommClosedError) as error:
        raise GroundStationError(
            "the scheduler went away; what has arrived is kept, run it again to go on"
        ) from error


def _bounded(arriving: as_completed, threads: _Threads) -> Iterator[Future]:
    """What arrives, as it does. Raises GroundStationError where nobody is left to do the rest."""
    while not arriving.is_empty():
        if arriving.has_ready():
            yield next(arriving)
        else:
            threads.require()
            time.sleep(POLL_S)


def _each(work: Callable[[Task], Result], batch: list[Task]) -> list[Result]:
    return [work(task) for task in batch]


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Client]:
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise BadInputError(
            f"Dask, which carries the work to more than one core, is not installed:"
            f" {install('fleet')}; or say --workers 1"
        ) from error
    settings: dict[str, Any] = {
        "distributed.scheduler.allowed-failures": DEATHS - 1,
        "distributed.admin.log-format": "%(message)s",
        "distributed.logging": {"distributed": "critical"},
        # Nobody looks at the samples of the workers' stacks: 4 % of their time.
        "distributed.worker.profile.enabled": False,
        # Dask gives up a worker that is not there 15 s after it died, it may have died again, and
        # begins no other. Nobody would do the rest.
        "distributed.deploy.lost-worker-timeout": LOST_S,
        # Dask has a worker give memory back at once; as much time again as the work.
        "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": KEPT_BYTES,
        "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": KEPT_BYTES,
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
                dashboard_address="127.0.0.1:0",  # None is port 8787 of every interface
                scheduler_kwargs={"dashboard": False},
                silence_logs=50,
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):
            yield client


# Work on many recordings whose rows are kept as they arrive.


MADE_BY = f"groundstation {__version__}"
"""Of a row's settings: flights that two versions worked on may differ where the craft did not."""


def with_reason(row: Row, work: Callable[[], Row]) -> Row:
    """``row`` with what the work tells, or else the ``reason`` why it tells nothing."""
    try:
        return row | work()
    except GroundStationError as error:
        return row | {"reason": str(error)}
    except Exception as error:  # a fault of ours with one file must not end a thousand others
        return row | {"reason": f"{type(error).__name__}: {error}"}


def set_aside(row: Row, does: str) -> Row:
    """The row of a task that every process dies of. does: what it does, in the third person."""
    return row | {"reason": f"the process that {does} it dies, again and again; it is set aside"}


def gathered(
    table: Parts,
    work: Callable[[Task], Row],
    tasks: Sequence[Task],
    dead: Callable[[Task], Row],
    *,
    at_once: int,
    doing: str,
    workers: int,
    scheduler: str | None,
    progress: Progress,
) -> Iterator[Row]:
    """Each task's row, all of them in the table when the last was taken.

    dead: the row of a task that processes die of. at_once: rows that make a file of their own,
    what a run that is killed loses at most. doing: what is shown of it.
    """
    fresh: list[Row] = []
    largest = min(at_once, LARGEST_BATCH)
    arriving = carried_out(work, tasks, workers=workers, scheduler=scheduler, largest=largest)
    try:
        for count, (task, row) in enumerate(arriving, 1):
            fresh.append(dead(task) if row is None else row)
            yield fresh[-1]
            if len(fresh) >= at_once:
                full, fresh = fresh, []
                table.append(full)
            progress(count / len(tasks), f"{doing} {count} of {len(tasks)}")
    finally:  # also of what ends here: interrupted, or by a scheduler that does not come back
        table.append(fresh)
