"""What is kept of what happened."""

from __future__ import annotations

import pytest

from groundstation.links.command import LinkEvent
from groundstation.service.craft_links import EVENTS_KEPT, Journal


@pytest.fixture
def journal() -> Journal:
    return Journal(lambda: 0, lambda source, kind: False)


def test_a_flood_of_one_kind_pushes_out_its_own_and_nothing_else(journal: Journal) -> None:
    for number in range(3 * EVENTS_KEPT):
        if number % 300 == 0:
            journal.note("fault", f"fault {number}", source="daemon")
        journal.take(LinkEvent(0, "radio", "console", f"line {number}"))
    kept = [event.text for event in journal.events]
    assert len(kept) == EVENTS_KEPT
    assert [text for text in kept if text.startswith("fault")] == [
        f"fault {number}" for number in range(0, 3 * EVENTS_KEPT, 300)
    ]
    assert kept[-1] == f"line {3 * EVENTS_KEPT - 1}"


def test_events_are_told_in_the_order_in_which_they_came(journal: Journal) -> None:
    for number in range(EVENTS_KEPT):
        journal.note(("console", "link", "job")[number % 3], str(number), source="daemon")
    assert [event.text for event in journal.events] == [str(n) for n in range(EVENTS_KEPT)]
