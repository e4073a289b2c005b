"""Work on many recordings whose rows are kept as they arrive."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from groundstation.fleet.engine import carried_out
from groundstation.fleet.parts import Parts, Row
from groundstation.identification.fit_record import Progress


def gathered(
    table: Parts,
    work: Callable[[str], Row],
    addresses: Sequence[str],
    dead: Callable[[str], Row],
    *,
    at_once: int,
    doing: str,
    workers: int,
    scheduler: str | None,
    progress: Progress,
) -> Iterator[Row]:
    """Each address's row, all of them in the table when the last was taken.

    dead: the row of a recording that processes die of. at_once: rows that make a file of their own,
    what a run that is killed loses at most. doing: what is shown of it.
    """
    fresh: list[Row] = []
    arriving = carried_out(work, addresses, workers=workers, scheduler=scheduler)
    for count, (address, row) in enumerate(arriving, 1):
        fresh.append(dead(address) if row is None else row)
        yield fresh[-1]
        if len(fresh) >= at_once:
            table.append(fresh)
            fresh = []
        progress(count / len(addresses), f"{doing} {count} of {len(addresses)}")
    table.append(fresh)
