"""Who takes what a station receives: a list of consumers, each with the same three methods."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from groundstation.links.command import LinkEvent
from groundstation.telemetry.decoder import LinkStatistics
from groundstation.telemetry.samples import LogTable, SampleBatch

if TYPE_CHECKING:
    from groundstation.twin.twin import Shown


class Consumer(Protocol):
    """Recorder, viewer, stream, twin. None waits: what takes time has a queue with a bound."""

    def samples(self, batch: SampleBatch) -> None:
        """Decoded rows, one at least."""

    def note(self, note: LinkEvent | LinkStatistics | LogTable | Shown) -> None:
        """What there is beside samples: an event, the link's last second, log variables of a
        craft at moments of their own, half a second of the twin's predictions."""

    def split(self) -> None:
        """What follows comes from another link."""
