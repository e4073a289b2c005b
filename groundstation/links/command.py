"""The interface every command link has: setpoints and parameters towards the craft.

Telemetry comes in on one link, commands go out on another: a real system is a receiver and a
Crazyradio. Everything that passes in either direction is reported for the recording.
"""

from __future__ import annotations

import enum
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from groundstation.errors import BadInputError, LinkError
from groundstation.links.clock import HostClock, steady_clock
from groundstation.links.event import EventSink, LinkEvent
from groundstation.links.parameter_storage import ParameterStorage
from groundstation.links.supervisor import Supervisor
from groundstation.telemetry.samples import LogTable

THRUST_MOST = 60000
"""The firmware limits thrust to this."""
HEIGHT_MOST_M = 3.0
"""A Z-ranger sees 4 m, indoors, and less when it leans."""
SPEED_MOST_M_S = 2.0
"""A Flow deck loses the floor's pattern beyond that, less than 1 m above it."""
ANGLE_MOST_DEG = 45.0
YAW_RATE_MOST_DPS = 720.0
GAIN_MOST = 1000.0
"""No controller gain of the firmware is near this; the largest stock one is 500."""
DRIVES_MOTORS = ("motorPowerSet.", "health.startPropTest")
"""Parameters by which today's firmware turns motors without a setpoint."""
RESETS_ESTIMATOR = "kalman.resetEstimation"
"""Parameter that begins the estimator anew when 1 is written; a request, no setting."""
SINGLE_MOST = 3.4028234e38
"""The largest number of 32 bits."""
LIFE_S = 0.5
"""A setpoint with thrust that was made longer ago is not sent: the firmware itself holds one for
so long."""
LOOK_S = 0.01
"""How often who waits for what a craft says of itself looks."""

EntrySink = Callable[[dict[str, Any]], None]


class CommandState(enum.StrEnum):
    CLOSED = "closed"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    LOST = "lost"


class CommandLink(ABC):
    """Commands to one craft.

    on_event: told of state changes. on_entry: told of each command, for the recording:
    ``time_ns``, ``direction`` (out or in), ``kind`` (setpoint, parameter or parameters), the
    ``client`` who wanted it, and its values.
    superseded: setpoints that a newer one replaced before the radio took them.
    armed: what the craft last said; None before it did.
    supervisor: what it last said of what keeps it from flying, of its battery and of its place.
    on_table: given its places, for the recording.
    storage: what it keeps of its parameters while it is switched off; None where it keeps nothing.
    """

    monotonic = staticmethod(time.monotonic)
    """Of the life of setpoints, s."""
    settles_s = 0.0
    """How long zero thrust must go on after a flight, lest the craft's supervisor locks it."""

    def __init__(self, uri: str, *, clock: HostClock | None = None) -> None:
        self.uri = uri
        self.clock = clock or steady_clock()
        self.state = CommandState.CLOSED
        self.superseded = 0
        self.armed: bool | None = None
        self.supervisor = Supervisor()
        self.storage: ParameterStorage | None = None
        self.on_event: EventSink = lambda event: None
        self.on_entry: EntrySink = lambda entry: None
        self.on_table: Callable[[LogTable], None] = lambda table: None

    @property
    def firmware(self) -> str:
        """Whose loops the craft flies, 2014 or 2.x; empty where nothing says so."""
        return ""

    @property
    def vehicle(self) -> str:
        """The profile of what the craft says it is, empty where it does not say."""
        return ""

    @property
    def craft_id(self) -> str:
        """The craft's own number, hexadecimal; empty where it does not say."""
        return ""

    @property
    def holds_height(self) -> bool:
        """Whether the craft takes a height in the place of thrust."""
        return False

    @property
    def holds_place(self) -> bool:
        """Whether the craft takes a velocity over the ground in the place of an attitude."""
        return False

    @property
    def disarms_in_flight(self) -> bool:
        """Whether the craft is one that was armed by request, or may have been, and that can be
        disarmed while it flies: its motors stop at once and it is not locked."""
        return False

    @abstractmethod
    async def open(self) -> None:
        """Connect and learn the craft's parameters. Raises LinkError when nothing answers."""

    @abstractmethod
    async def close(self) -> None:
        """Disconnect. Safe to call twice."""

    @abstractmethod
    def parameters(self) -> dict[str, float]:
        """Every parameter of the craft by full name, as last read."""

    def setpoint(
        self,
        roll_deg: float,
        pitch_deg: float,
        yaw_dps: float,
        thrust: int,
        *,
        height_m: float | None = None,
        vx_m_s: float | None = None,
        vy_m_s: float | None = None,
        client: str = "",
        until_s: float | None = None,
    ) -> int:
        """Hand over one setpoint without waiting for the radio; when, Unix ns.

        Signs are those of the telemetry samples: roll left side up, pitch nose down, yaw rate
        counter-clockwise from above. thrust: 0..60000. The firmware levels the craft 0.5 s after
        the last setpoint and stops its motors after 2 s. height_m: the craft finds the thrust that
        brings it there, see ``holds_height``; thrust is 0 then. vx_m_s, vy_m_s: forward and left as
        the craft is headed: it finds the attitude that gives it that velocity at its height, see
        ``holds_place``; roll and pitch are 0 then. client: who wants it, recorded.
        until_s: monotonic, when the radio must have taken it, ``LIFE_S`` from now at the latest;
        without thrust and height it is never too late.

        Raises BadInputError before anything is sent for a value that is not finite or out of
        range, or a height or velocity for a craft that cannot hold one; LinkError when it is not
        connected.
        """
        _require_velocity(roll_deg, pitch_deg, height_m, vx_m_s, vy_m_s)
        for name, value, most in (
            ("roll_deg", roll_deg, ANGLE_MOST_DEG),
            ("pitch_deg", pitch_deg, ANGLE_MOST_DEG),
            ("yaw_dps", yaw_dps, YAW_RATE_MOST_DPS),
        ):
            if not (math.isfinite(value) and abs(value) <= most):
                raise BadInputError(f"setpoint: {name} {value} is outside -{most:g}..{most:g}")
        if not 0 <= thrust <= THRUST_MOST:
            raise BadInputError(f"setpoint: thrust {thrust} is outside 0..{THRUST_MOST}")
        latest_s = self.monotonic() + LIFE_S
        until_s = latest_s if until_s is None else min(until_s, latest_s)
        if height_m is None:
            until_s = until_s if thrust else math.inf
            self._send_setpoint(roll_deg, pitch_deg, yaw_dps, thrust, until_s)
        else:
            self._require_held(thrust, height_m, moves=vx_m_s is not None)
            if vx_m_s is None or vy_m_s is None:
                self._send_height(roll_deg, pitch_deg, yaw_dps, height_m, until_s)
            else:
                self._send_hover(vx_m_s, vy_m_s, yaw_dps, height_m, until_s)
        more = {"height_m": height_m, "vx_m_s": vx_m_s, "vy_m_s": vy_m_s}
        return self._entry(
            "out",
            "setpoint",
            client=client,
            roll_deg=roll_deg,
            pitch_deg=pitch_deg,
            yaw_dps=yaw_dps,
            thrust=thrust,
            **{name: value for name, value in more.items() if value is not None},
        )

    def _require_held(self, thrust: int, height_m: float, *, moves: bool) -> None:
        """Raises BadInputError for a height, or with it a velocity, that this craft cannot hold."""
        if not 0.0 <= height_m <= HEIGHT_MOST_M:
            raise BadInputError(f"setpoint: height {height_m} m is outside 0..{HEIGHT_MOST_M:g}")
        if thrust:
            raise BadInputError("setpoint: give thrust or height_m, not both")
        if self.state is not CommandState.CONNECTED:
            return
        if not self.holds_height:
            raise BadInputError(
                "setpoint: this craft holds no height: it needs today's firmware and a deck"
                " that measures it (Flow or Z-ranger), or a positioning system"
            )
        if moves and not self.holds_place:
            raise BadInputError(
                "setpoint: this craft holds no velocity: it needs today's firmware and a"
                " Flow deck, or a positioning system"
            )

    def require_parameter(self, name: str, value: float) -> None:
        """Raises BadInputError for an unknown name or a value that no craft should get."""
        if name.startswith(DRIVES_MOTORS):
            raise BadInputError(
                f"parameter {name}: turns motors past the setpoints, which nothing here then ends"
            )
        if name not in self.parameters():
            raise BadInputError(f"the craft has no parameter {name!r}")
        if not abs(value) <= SINGLE_MOST:
            raise BadInputError(f"parameter {name}: {value} is not a finite number")
        if name.startswith("pid_") and not 0 <= value <= GAIN_MOST:
            raise BadInputError(f"parameter {name}: {value:g} is outside 0..{GAIN_MOST:g}")
        whole = self._whole_range(name)
        if whole is not None and not (value == int(value) and whole[0] <= value <= whole[1]):
            raise BadInputError(
                f"parameter {name}: {value:g} is not a whole number {whole[0]}..{whole[1]}"
            )

    async def write_parameter(self, name: str, value: float, *, client: str = "") -> float:
        """Write a parameter and return what the craft says it is now: the same number, rounded
        to the 32 bits it has there.

        Raises as ``require_parameter``, LinkError when the craft does not confirm it.
        """
        self.require_parameter(name, value)
        self._entry("out", "parameter", client=client, name=name, value=value)
        confirmed = await self._write_parameter(name, value)
        self._entry("in", "parameter", client=client, name=name, value=confirmed)
        if not math.isclose(confirmed, value, rel_tol=1e-6, abs_tol=1e-30):
            raise LinkError(f"{self.uri}: parameter {name} is {confirmed:g}, not {value:g}")
        return confirmed

    def clear_assists(self) -> list[str]:
        """Ask the craft to leave modes in which zero thrust does not stop its motors; the
        parameters that are reset, without waiting for them."""
        return []

    def emergency_stop(self) -> bool:
        """Let the firmware cut its motors at once; whether it can. It flies no more until it is
        switched off and on."""
        return False

    def arm(self, armed: bool) -> bool:
        """Arm or disarm the motors; whether this firmware knows the request. Its answer comes
        later, as ``armed``."""
        return False

    def withdraw_arming(self) -> None:
        """A request to arm or to recover that still waits for the radio is not sent."""
        return None

    def recover(self) -> None:
        """Ask a craft to be ready again, where ``supervisor`` says that it has crashed, and then
        says what becomes of it."""
        raise NotImplementedError

    def record_parameters(self, client: str) -> None:
        """Put every parameter, as last read, into the recording."""
        self._entry("in", "parameters", client=client, values=self.parameters())

    @abstractmethod
    def _send_setpoint(
        self, roll_deg: float, pitch_deg: float, yaw_dps: float, thrust: int, until_s: float
    ) -> None: ...

    def _send_height(
        self, roll_deg: float, pitch_deg: float, yaw_dps: float, height_m: float, until_s: float
    ) -> None:
        """Only where ``holds_height`` says so."""
        raise NotImplementedError

    def _send_hover(
        self, vx_m_s: float, vy_m_s: float, yaw_dps: float, height_m: float, until_s: float
    ) -> None:
        """Only where ``holds_place`` says so."""
        raise NotImplementedError

    @abstractmethod
    async def _write_parameter(self, name: str, value: float) -> float: ...

    @abstractmethod
    def _whole_range(self, name: str) -> tuple[int, int] | None:
        """What fits a parameter that holds whole numbers, None for one that does not. Raises
        BadInputError for one that can only be read."""

    def _entry(self, direction: str, kind: str, **values: Any) -> int:
        time_ns = self.clock()
        entry = {"time_ns": time_ns, "direction": direction, "kind": kind}
        self.on_entry({**entry, "link": self.uri, **values})
        return time_ns

    def _enter(self, state: CommandState, text: str) -> None:
        if state is not self.state:
            self.state = state
            self.on_event(LinkEvent(self.clock(), self.uri, state.value, text))


def _require_velocity(
    roll_deg: float,
    pitch_deg: float,
    height_m: float | None,
    vx_m_s: float | None,
    vy_m_s: float | None,
) -> None:
    """Raises BadInputError for a velocity that is half of one, out of range or beside others."""
    if vx_m_s is None and vy_m_s is None:
        return
    if vx_m_s is None or vy_m_s is None:
        raise BadInputError("setpoint: give vx_m_s and vy_m_s, or neither")
    for name, value in (("vx_m_s", vx_m_s), ("vy_m_s", vy_m_s)):
        if not (math.isfinite(value) and abs(value) <= SPEED_MOST_M_S):
            raise BadInputError(
                f"setpoint: {name} {value} is outside -{SPEED_MOST_M_S:g}..{SPEED_MOST_M_S:g}"
            )
    if height_m is None:
        raise BadInputError("setpoint: vx_m_s and vy_m_s need height_m")
    if roll_deg or pitch_deg:
        raise BadInputError("setpoint: give roll_deg and pitch_deg, or vx_m_s and vy_m_s, not both")
