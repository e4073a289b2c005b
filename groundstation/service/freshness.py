"""How old a request that turns motors is: one that was made too long ago is not followed."""

from __future__ import annotations

from groundstation.errors import LinkError
from groundstation.links.command import LIFE_S

STOOD_S = 0.3
"""A loop that did not turn for so long stood still."""
WAKES_S = 0.5
"""So long after that requests come in that were made before."""


class Freshness:
    """Of what is heard by a loop that says when it turns: what waits in sockets while a process
    stands still has no age but the one that it brings along."""

    def __init__(self) -> None:
        self._turned_s: float | None = None
        self._until_s = 0.0

    def turn(self, now_s: float) -> None:
        """The loop that hears requests has turned."""
        if self._stands(now_s):
            self._until_s = now_s + WAKES_S
        self._turned_s = now_s

    def require(self, refused: str, now_s: float, made_s: float | None = None) -> None:
        """Raises LinkError for a request that is, or may be, too old.

        refused: what then was not done. made_s: when it was made, where it says so, by the clock
        that ``now_s`` is of."""
        if made_s is None:
            if self._stands(now_s) or now_s < self._until_s:
                raise LinkError(f"the daemon stood still, and nobody knows since when: {refused}")
        elif now_s > made_s + LIFE_S:
            raise LinkError(f"the setpoint was made {now_s - made_s:.1f} s ago: too old to be sent")

    def _stands(self, now_s: float) -> bool:
        return self._turned_s is not None and now_s - self._turned_s > STOOD_S
