"""Work on many recordings whose rows are kept as they arrive."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from groundstation import __version__
from groundstation.errors import GroundStationError
from groundstation.fleet.engine import LARGEST_BATCH, Task, carried_out
from groundstation.fleet.parts import Parts, Row
from groundstation.identification.fit_record import Progress

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
