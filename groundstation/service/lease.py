"""One client's right to command."""

from __future__ import annotations

from dataclasses import dataclass

from groundstation.service.motor_stop import Stop


@dataclass(slots=True)
class Lease:
    """Times are monotonic. ended: why it is over, empty while it is in force. stop: of its motors,
    the last one."""

    client: str
    token: str
    heard_s: float
    """When the client last said anything."""
    setpoint_s: float = 0.0
    """When its last setpoint was made."""
    thrust: int = 0
    height_m: float | None = None
    levelled: bool = False
    """By the dead man."""
    held_level: bool = False
    """By the operator."""
    flew: bool = False
    """Whether motors ever ran for it."""
    ended: str = ""
    stop: Stop | None = None

    @property
    def flies(self) -> bool:
        """Whether motors run for it."""
        return bool(self.thrust) or self.height_m is not None

    def set_down(self) -> None:
        self.thrust, self.height_m = 0, None
