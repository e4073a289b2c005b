"""Work on many recordings whose rows are kept as they arrive."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from groundstation.fleet.engine import Task, carried_out
from groundstation.fleet.parts import Parts, Row
from groundstation.identification.fit_record import Progress


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
    arriving = carried_out(work, tasks, workers=workers, scheduler=scheduler)
    for count, (task, row) in enumerate(arriving, 1):
        fresh.append(dead(task) if row is None else row)
        yield fresh[-1]
        if len(fresh) >= at_once:
            table.append(fresh)
            fresh = []
        progress(count / len(tasks), f"{doing} {count} of {len(tasks)}")
    table.append(fresh)
