"""Whether there is a craft that can be commanded, and whether its motors may be asked to turn."""

from __future__ import annotations

from collections.abc import Callable

from groundstation.errors import BadInputError
from groundstation.links.base import LinkState
from groundstation.links.command import CommandLink
from groundstation.service.flight_end import FlightEnd
from groundstation.service.freshness import Freshness


class Readiness:
    """telemetry: state of the telemetry link; why no craft can be commanded with it, or empty.
    contradiction: why what a craft says it is contradicts the configuration, or empty. clock:
    monotonic, s. closing: the daemon ends."""

    def __init__(
        self,
        telemetry: Callable[[], tuple[LinkState, str]],
        contradiction: Callable[[str], str],
        end: FlightEnd,
        clock: Callable[[], float],
    ) -> None:
        self._telemetry, self._contradiction = telemetry, contradiction
        self._end, self._clock = end, clock
        self._freshness = Freshness()
        self.closing = False

    @property
    def wanted(self) -> bool:
        """Whether there is a craft behind the telemetry that should be connected."""
        # a stand-in answers only once its link is open
        state, reason = self._telemetry()
        return state is LinkState.STREAMING and not reason and not self.closing

    def turn(self, now_s: float) -> None:
        """The loop that hears requests has turned."""
        self._freshness.turn(now_s)

    def require_craft(self, what: str) -> None:
        """Raises BadInputError where the craft that is heard is none that can be commanded, or
        will not be for long."""
        reason = "the daemon ends" if self.closing else self._telemetry()[1]
        if reason:
            raise BadInputError(f"no craft can {what}: {reason}")

    def require_vehicle(self, link: CommandLink) -> None:
        """Raises BadInputError where the craft says that it is another than is configured."""
        if reason := self._contradiction(link.vehicle):
            raise BadInputError(reason)

    def require_calm(self, refused: str, made_s: float | None = None) -> None:
        """Raises TakenError while a flight is being ended, LinkError for what is, or may be, too
        old. refused: what then was not done. made_s: when it was asked for, if that was told."""
        self._end.require_none(refused)
        self._freshness.require(refused, self._clock(), made_s)
