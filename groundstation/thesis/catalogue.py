"""All entries in printed order, and how they are made."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from groundstation.errors import BadInputError
from groundstation.thesis import arx, body, control, flight, fusion, motor, telemetry
from groundstation.thesis.entry import Done, Entry
from groundstation.thesis.workshop import Workshop

ENTRIES: tuple[Entry, ...] = (
    *telemetry.ENTRIES,
    *fusion.ENTRIES,
    *motor.ENTRIES,
    *flight.ENTRIES,
    *body.ENTRIES,
    *arx.ENTRIES,
    *control.ENTRIES,
)


def chosen(numbers: Sequence[str]) -> list[Entry]:
    """Entries by number ("7.1", "Table 7.1"); all where none is named.

    Raises BadInputError for a number that has no counterpart.
    """
    if not numbers:
        return list(ENTRIES)
    found = [
        one
        for one in ENTRIES
        if any(wanted in (one.number, one.number.split()[1]) for wanted in numbers)
    ]
    named = {one.number for one in found} | {one.number.split()[1] for one in found}
    missing = [wanted for wanted in numbers if wanted not in named]
    if missing:
        raise BadInputError(
            f"--only {missing[0]}: there are {', '.join(one.number for one in ENTRIES)}"
        )
    return found


def make(
    workshop: Workshop, entries: Sequence[Entry], begin: Callable[[int, Entry], None]
) -> list[Done]:
    """Each entry with the commands that made it. begin: told of each before it."""
    done = []
    for number, entry in enumerate(entries):
        begin(number, entry)
        workshop.begin()
        made = entry.make(workshop)
        done.append(Done(entry, made, *workshop.commands()))
    return done
