"""The interface every command link has: setpoints and parameters towards the craft.

Telemetry comes in on one link, commands go out on another: a real system is a receiver and a
Crazyradio. Everything that passes in either direction is reported for the recording.
"""

from __future__ import annotations

import enum
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from groundstation.clock import HostClock, steady_clock
from groundstation.errors import BadInputError
from groundstation.links.base import EventSink, LinkEvent

THRUST_MOST = 60000
"""The firmware limits thrust to this."""
ANGLE_MOST_DEG = 45.0
YAW_RATE_MOST_DPS = 720.0

EntrySink = Callable[[dict[str, Any]], None]


class CommandState(enum.StrEnum):
    CLOSED = "closed"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    LOST = "lost"


class CommandLink(ABC):
    """Commands to one craft.

    on_event: told of state changes. on_entry: told of each command, for the recording:
    ``time_ns``, ``direction`` (out or in), ``kind`` (setpoint or parameter) and its values.
    """

    def __init__(self, uri: str, *, clock: HostClock | None = None) -> None:
        self.uri = uri
        self.clock = clock or steady_clock()
        self.state = CommandState.CLOSED
        self.on_event: EventSink = lambda event: None
        self.on_entry: EntrySink = lambda entry: None

    @abstractmethod
    async def open(self) -> None:
        """Connect and learn the craft's parameters. Raises LinkError when nothing answers."""

    @abstractmethod
    async def close(self) -> None:
        """Disconnect. Safe to call twice."""

    @abstractmethod
    def parameters(self) -> dict[str, float]:
        """Every parameter of the craft by full name, as last read."""

    def setpoint(self, roll_deg: float, pitch_deg: float, yaw_dps: float, thrust: int) -> None:
        """Send one setpoint in the firmware's convention: pitch nose up positive, yaw rate
        positive clockwise from above, thrust 0..60000. The firmware levels the craft 0.5 s
        after the last one and stops its motors after 2 s.

        Raises BadInputError before anything is sent for a value that is not finite or out of
        range, LinkError when the craft is not connected.
        """
        for name, value, most in (
            ("roll", roll_deg, ANGLE_MOST_DEG),
            ("pitch", pitch_deg, ANGLE_MOST_DEG),
            ("yaw rate", yaw_dps, YAW_RATE_MOST_DPS),
        ):
            if not (math.isfinite(value) and abs(value) <= most):
                raise BadInputError(f"setpoint: {name} {value} is outside -{most:g}..{most:g} deg")
        if not 0 <= thrust <= THRUST_MOST:
            raise BadInputError(f"setpoint: thrust {thrust} is outside 0..{THRUST_MOST}")
        self._send_setpoint(roll_deg, pitch_deg, yaw_dps, thrust)
        self._entry(
            "out", "setpoint", roll_deg=roll_deg, pitch_deg=pitch_deg, yaw_dps=yaw_dps,
            thrust=thrust,
        )  # fmt: skip

    async def write_parameter(self, name: str, value: float) -> float:
        """Write a parameter and return what the craft says it is now.

        Raises BadInputError for an unknown name or a value that is not finite, LinkError when
        the craft does not confirm it.
        """
        if name not in self.parameters():
            raise BadInputError(f"the craft has no parameter {name!r}")
        if not math.isfinite(value):
            raise BadInputError(f"parameter {name}: {value} is not a finite number")
        self._entry("out", "parameter", name=name, value=value)
        confirmed = await self._write_parameter(name, value)
        self._entry("in", "parameter", name=name, value=confirmed)
        return confirmed

    @abstractmethod
    def _send_setpoint(
        self, roll_deg: float, pitch_deg: float, yaw_dps: float, thrust: int
    ) -> None: ...

    @abstractmethod
    async def _write_parameter(self, name: str, value: float) -> float: ...

    def _entry(self, direction: str, kind: str, **values: Any) -> None:
        entry = {"time_ns": self.clock(), "direction": direction, "kind": kind}
        self.on_entry({**entry, "link": self.uri, **values})

    def _enter(self, state: CommandState, text: str) -> None:
        if state is not self.state:
            self.state = state
            self.on_event(LinkEvent(self.clock(), self.uri, state.value, text))
