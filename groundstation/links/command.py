"""The command link: its interface, and the craft behind it (address, supervisor, storage,
landing).
"""

from __future__ import annotations

import contextlib
import enum
import io
import ipaddress
import math
import re
import struct
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from groundstation.errors import BadInputError, LinkError, install
from groundstation.telemetry.samples import LogTable

# The host clock: Unix time that never steps.
#
# Stamps are CLOCK_MONOTONIC plus a constant taken once, so that a stepped system
# clock (NTP, an operator) changes no interval inside a session.


HostClock = Callable[[], int]
"""Returns nanoseconds since the Unix epoch, never running backwards."""


def steady_clock() -> HostClock:
    """A clock anchored to the system's Unix time at this call and monotonic ever after."""
    anchor_ns = time.time_ns() - time.monotonic_ns()
    return lambda: anchor_ns + time.monotonic_ns()


# What a link tells beside its telemetry.


@dataclass(frozen=True, slots=True)
class LinkEvent:
    """Something worth telling the operator and the recording."""

    time_ns: int
    link: str
    kind: str
    """One word: opened, streaming, silent, lost, ended, closed, fault, restart ..."""
    text: str
    details: dict[str, Any] = field(default_factory=dict)


EventSink = Callable[[LinkEvent], None]


# What today's firmware says of its supervisor, its battery and its height, in words for an
# operator.


INFO, POWER = "supervisor.info", "pm.state"
HEIGHT, HEIGHT_VARIANCE = "stateEstimate.z", "kalman.varZ"
PLACE_VARIANCES = ("kalman.varX", "kalman.varY")
STATE = (INFO, POWER, HEIGHT, HEIGHT_VARIANCE, *PLACE_VARIANCES)
"""Log variables, slow ones."""
PLACE = tuple(f"stateEstimate.{name}" for name in ("x", "y", "z", "vx", "vy", "vz"))
LEAN = ("stabilizer.roll", "stabilizer.pitch")
"""Log variables, fast ones."""
LOW_POWER = 3
HEIGHT_KNOWN_M = 0.1
"""Standard error of a height, or a place, that a craft can be left with: the estimator begins at
1 m, and stays there or grows where nothing measures it; ranges, base stations or anchors make it
some mm to cm."""
_CAN_ARM, _ARMED, _ARMS_ITSELF, _FLIES = (1 << place for place in (0, 1, 2, 4))
_TUMBLED, _LOCKED, _CRASHED, _DECK_FAULT = (1 << place for place in (5, 6, 7, 11))
DISARMED_ITSELF = (
    "the craft has disarmed its motors by itself, as it does where it is not flown soon, and soon"
    " after a landing"
)
NOT_ARMED = "the craft is not armed: `groundstation motors arm`, or on the page (Arm...)"
TUMBLED = "the craft lies on its side or its back: set it upright"
BATTERY_LOW = "the craft warns that its battery is low: land"


@dataclass(frozen=True, slots=True)
class Place:
    """Position (m) and velocity (m/s) in the world frame of the craft's estimator. tilt_deg: of its
    axis from the vertical, NaN where it does not say. heard_s: when it came, monotonic. at_s: when
    the craft said so, by its own clock, NaN where that is not known."""

    x_m: float
    y_m: float
    z_m: float
    vx_m_s: float
    vy_m_s: float
    vz_m_s: float
    tilt_deg: float = math.nan
    heard_s: float = 0.0
    at_s: float = math.nan

    @classmethod
    def of(cls, values: dict[str, float], heard_s: float, at_s: float = math.nan) -> Place:
        """From the log variables of ``PLACE`` and, where there are any, of ``LEAN``."""
        roll, pitch = (math.radians(values.get(name, math.nan)) for name in LEAN)
        upright = math.cos(roll) * math.cos(pitch)
        x, y, z, vx, vy, vz = (values[name] for name in PLACE)
        return cls(x, y, z, vx, vy, vz, math.degrees(math.acos(upright)), heard_s, at_s)


@dataclass(frozen=True, slots=True)
class Supervisor:
    """bits: of ``supervisor.info``, None: the craft does not say. low_battery: it warns of that.
    height_m: what its Kalman filter says, None where it is not sure of that. knows_place: whether
    that filter is sure of the position in the plane. place: where it was last, None before it said
    so."""

    bits: int | None = None
    low_battery: bool = False
    height_m: float | None = None
    knows_place: bool = False
    place: Place | None = None

    @classmethod
    def of(cls, values: dict[str, float]) -> Supervisor:
        """From log variables; what the firmware does not list is missing."""
        bits, height_m = values.get(INFO), values.get(HEIGHT, math.nan)
        return cls(
            None if bits is None else int(bits),
            values.get(POWER) == LOW_POWER,
            height_m if _is_sure(values, HEIGHT_VARIANCE) and math.isfinite(height_m) else None,
            all(_is_sure(values, name) for name in PLACE_VARIANCES),
        )

    @property
    def armed(self) -> bool | None:
        return None if self.bits is None else bool(self.bits & _ARMED)

    @property
    def arms_itself(self) -> bool:
        return bool((self.bits or 0) & _ARMS_ITSELF)

    @property
    def flies(self) -> bool:
        """Whether it takes itself for flying, as it does until 2 s after its motors last turned."""
        return bool((self.bits or 0) & _FLIES)

    @property
    def crashed(self) -> bool:
        """Whether it calls itself crashed, and flies no more until it is asked to recover."""
        return bool((self.bits or 0) & _CRASHED)

    @property
    def tumbled(self) -> bool:
        """Whether it lies on its side or its back."""
        return bool((self.bits or 0) & _TUMBLED)

    @property
    def trouble(self) -> str:
        """What is wrong with it, and what to do; empty where it says nothing of that."""
        bits = self.bits or 0
        if bits & _DECK_FAULT:  # it keeps the craft from flying, and locks it in flight
            return (
                "a deck of the craft has reported a fault of its hardware (its console says more):"
                " take the deck off, switch the craft off and on"
            )
        if bits & _LOCKED:
            return (
                "the craft has locked itself, by an emergency stop or because setpoints ceased in"
                " flight: switch it off and on"
            )
        if self.crashed:
            return (
                "the craft says that it has crashed: set it upright, then `groundstation motors"
                " recover`, or on the page (Recover), or switch it off and on"
            )
        if self.tumbled:
            return TUMBLED
        return ""

    @property
    def refusal(self) -> str:
        """Why it does not let itself be armed; empty where it says nothing of that."""
        if self.trouble or self.bits is None or self.bits & (_ARMED | _CAN_ARM):
            return self.trouble
        return "its checks before flight have not passed"

    @property
    def hindrance(self) -> str:
        """What keeps it from flying, and what to do; empty where it says nothing of that."""
        if self.trouble or self.bits is None or self.armed or self.arms_itself:
            return self.trouble
        return NOT_ARMED


def _is_sure(values: dict[str, float], variance: str) -> bool:
    """Whether a coordinate is known; a filter that does not run says 0."""
    return 0.0 < values.get(variance, 0.0) <= HEIGHT_KNOWN_M**2


# What a craft keeps of its parameters while it is switched off.
#
# Firmware of 2022 and later has a memory for them and loads it when it is switched on, over the
# values that its image was built with. The requests are those of CRTP port 2, channel 3: a command
# and the parameter's number, 16 bits, little-endian, which the answer repeats.


MISC = (2, 3)
"""Port and channel."""
STORE, GET_STATE, CLEAR = 3, 4, 5
STORED, NOT_STORED = 1, 0
READS_S, WRITES_S = 1.0, 3.0
"""How long an answer is waited for: a memory that is full is tidied up before it is written."""

Ask = Callable[[bytes, float], Awaitable[bytes | None]]
"""Sends a request, up to so many s; what its answer has behind the request's own bytes, or None."""


@dataclass(frozen=True, slots=True)
class StoredValue:
    """A parameter that can be stored. default: of the firmware. stored: None where nothing is."""

    default: float
    stored: float | None

    @property
    def loaded(self) -> float:
        """What it is after the next power-on."""
        return self.default if self.stored is None else self.stored


class ParameterStorage:
    """That of one connected craft.

    numbers: of each parameter that can be stored, by full name, its number and the format of its
    value (``struct``). states: of those that were read. trouble: why the others were not, or empty.
    """

    def __init__(self, uri: str, numbers: Mapping[str, tuple[int, str]], ask: Ask) -> None:
        self.uri, self.numbers = uri, dict(numbers)
        self.states: dict[str, StoredValue] = {}
        self.trouble = ""
        self._ask = ask

    def require(self, name: str) -> None:
        """Raises BadInputError for a parameter that cannot be stored."""
        if name not in self.numbers:
            raise BadInputError(
                f"parameter {name} cannot be stored: this craft's firmware forgets it when it is"
                " switched off"
            )

    async def read(self, name: str) -> StoredValue:
        """Ask what is stored. Raises LinkError where the craft does not say."""
        answer = await self._asked(GET_STATE, name, READS_S)
        state = state_in(answer, self.numbers[name][1])
        if state is None:
            raise LinkError(f"{self.uri}: the craft does not say what it has stored of {name}")
        self.states[name] = state
        return state

    async def store(self, name: str, value: float) -> None:
        """Store the present value and read it back. value: what that is.

        Raises LinkError where the craft does not confirm it."""
        self.states.pop(name, None)
        if (await self._asked(STORE, name, WRITES_S))[:1] != b"\0":
            raise LinkError(
                f"{self.uri}: the craft refused to store {name}; its memory may be full"
            )
        state = await self.read(name)
        if state.stored is None or not math.isclose(state.stored, value, rel_tol=1e-6):
            raise LinkError(f"{self.uri}: {name} is stored as {state.stored}, not as {value:g}")

    async def clear(self, name: str) -> None:
        """Forget what is stored, if anything is, and read that back: the parameter is what it is
        until the next power-on. Raises LinkError where the craft does not confirm it."""
        self.states.pop(name, None)
        await self._asked(CLEAR, name, WRITES_S)
        if (await self.read(name)).stored is not None:
            raise LinkError(f"{self.uri}: the craft did not clear what it has stored of {name}")

    async def _asked(self, command: int, name: str, patience_s: float) -> bytes:
        self.require(name)
        answer = await self._ask(request(command, self.numbers[name][0]), patience_s)
        if answer is None:
            raise LinkError(
                f"{self.uri}: no answer about the stored value of {name} within {patience_s:g} s;"
                " try again"
            )
        return answer


def request(command: int, number: int) -> bytes:
    """What asks for something of a parameter."""
    return struct.pack("<BH", command, number)


def state_in(answer: bytes, form: str) -> StoredValue | None:
    """What the answer to ``GET_STATE`` says, behind the request's bytes; None for a refusal or an
    answer that is none. form: of the value, as ``<f``."""
    if not answer or answer[0] not in (STORED, NOT_STORED):
        return None
    size, is_stored = struct.calcsize(form), answer[0] == STORED
    if len(answer) < 1 + size * (1 + is_stored):
        return None
    (default,) = struct.unpack_from(form, answer, 1)
    stored = struct.unpack_from(form, answer, 1 + size)[0] if is_stored else None
    return StoredValue(float(default), None if stored is None else float(stored))


# How a craft that holds its height is brought down: level, slowly, motors off at the ground. Pure,
# on the clock of whoever uses it.


SINK_M_S = 0.3
"""A craft that meets the ground so fast stays upright; its propellers stay whole."""
LONGEST_S, GROUND_S = 6.0, 0.7
"""The whole landing, at most; how long no height is asked for before it is over at the latest."""
SLOW_M = 0.6
"""From so high on it sinks at ``SINK_M_S``, however high it began."""
FLOOR_M = 0.02
"""A craft that says it is lower than this stands: it falls the rest, and meets the floor with
0.5 m/s; from 5 cm it is 0.8 m/s. Where its sensor says more on the floor, the time ends it."""
CLIMBS_M_S, NEAR_M = 0.1, 0.05
"""One that is as low and climbs has just left the floor: cut there, it would fall from 20 cm. One
that is higher than the second and still moves is not down, whatever was asked for."""
CLIMBS_ON_S = 1.0
"""How long a craft that still climbs is asked for the height that it has, at most: asked for less,
one that has just taken off meets the floor with 0.9 m/s, with this 0.5 m/s at most."""
BELOW_M, STANDS_S, STILL_M = 0.25, 0.6, 0.02
"""A craft that is asked for so much less than its height, and for so long has not moved by more
than this, stands on something."""
LOW_M, MET_DPS = 0.15, 150.0
"""Asked for less than this, a craft that turns so fast has met the ground: level flight never
does."""
APART_M = 0.3
"""A height that was asked for and is so far from the measured one is not where it begins."""


class Landing:
    """One landing, begun at ``now_s`` (any monotonic clock, s).

    height_m: that was asked for last; None: the measured one. measured_m: the craft's own, None
    where it does not say. over: why it is, empty while it goes on.
    """

    def __init__(
        self, now_s: float, height_m: float | None = None, measured_m: float | None = None
    ) -> None:
        known_m = 0.0 if measured_m is None else measured_m
        is_there = height_m is not None and (
            measured_m is None or abs(height_m - measured_m) <= APART_M
        )
        self.over = ""
        self._asked_s = self._begun_s = now_s
        self._from_m = max(height_m if height_m is not None and is_there else known_m, 0.0)
        self._measured: deque[tuple[float, float]] = deque()

    def asked_m(self, now_s: float) -> float:
        """The height to ask for, m."""
        time_s, high_m = max(now_s - self._begun_s, 0.0), self._from_m
        slow_m = min(high_m, SLOW_M)
        left_s = self._asked_s + LONGEST_S - self._begun_s - GROUND_S - slow_m / SINK_M_S
        fast_s = min(left_s, (high_m - slow_m) / SINK_M_S)
        if time_s < fast_s:
            return high_m - (high_m - slow_m) * time_s / fast_s
        return max(slow_m - SINK_M_S * (time_s - fast_s), 0.0)

    def tick(
        self,
        now_s: float,
        measured_m: float | None = None,
        turns_dps: float | None = None,
        climb_m_s: float | None = None,
    ) -> float | None:
        """The height to ask for now, m, or None: it is over, and the motors are to stop.

        measured_m: the craft's own height. turns_dps: its fastest rate about any axis. climb_m_s:
        upwards. None where it does not say.
        """
        climbs = climb_m_s is not None and climb_m_s > CLIMBS_M_S
        if climbs and measured_m is not None and now_s - self._asked_s < CLIMBS_ON_S:
            self._begun_s, self._from_m = now_s, max(measured_m, 0.0)
        asked_m = self.asked_m(now_s)
        self.over = self.over or self._ended(now_s, asked_m, measured_m, turns_dps, climbs)
        return None if self.over else asked_m

    def _ended(
        self,
        now_s: float,
        asked_m: float,
        measured_m: float | None,
        turns_dps: float | None,
        climbs: bool,
    ) -> str:
        still = measured_m is not None and self._is_still(now_s, measured_m)
        if measured_m is not None:
            if measured_m <= FLOOR_M and not climbs:
                return "it is on the floor"
            if asked_m <= measured_m - BELOW_M and still:
                return "it stands on something"
        if turns_dps is not None and turns_dps > MET_DPS and asked_m <= LOW_M:
            return "it has met the ground"
        sinks = measured_m is not None and measured_m > NEAR_M and not still
        sank = now_s - self._begun_s >= GROUND_S and self.asked_m(now_s - GROUND_S) <= 0.0
        is_late = now_s - self._asked_s >= LONGEST_S
        return "its time is up" if (sank and not sinks) or is_late else ""

    def _is_still(self, now_s: float, measured_m: float) -> bool:
        """Whether the height has not moved for ``STANDS_S``."""
        kept = self._measured
        kept.append((now_s, measured_m))
        while len(kept) > 1 and kept[1][0] <= now_s - STANDS_S:
            kept.popleft()
        heights = [height_m for _, height_m in kept]
        return kept[0][0] <= now_s - STANDS_S and max(heights) - min(heights) <= STILL_M


# Where a craft is reached: addresses as cflib writes them, by which dongle or cable they lead, and
# what answers there.


ADDRESSES = (
    "udp://HOST:PORT, usb://0 or radio://0/80/2M/E7E7E7E7E7 (dongle or its serial number, channel 0"
    " to 125, rate 250K, 1M or 2M, address of ten hexadecimal digits)"
)
LOOKED_THROUGH = ("radio://0/0/2M", "usb://0")
"""The dongle and the cable that ``in_reach`` opens."""
HINT = f"install it with {install('radio')}"

_RADIO = re.compile(
    r"radio://(?P<dongle>\d{1,9}|[0-9A-Fa-f]{10,32})/(?P<channel>\d{1,3})"
    r"(/(250K|1M|2M)(/[0-9A-Fa-f]{1,10})?)?/?(\?rate_limit=\d+)?"
)
_CABLE = re.compile(r"usb://(?P<cable>\d+)")
_LAST_CHANNEL, _LEAST_SERIAL = 125, 10


def is_address(uri: str) -> bool:
    """Whether cflib can make anything of it: of what it cannot it says so in words of Python, and
    a wrong channel it finds only once there is a dongle."""
    if radio := _RADIO.fullmatch(uri):
        return int(radio["channel"]) <= _LAST_CHANNEL
    if not uri.startswith("udp://"):
        return _CABLE.fullmatch(uri) is not None
    try:
        parts = urlsplit(uri)
        return bool(parts.hostname and parts.port)
    except ValueError:  # the port
        return False


def is_software(uri: str) -> bool:
    """Whether a software craft of this machine answers there: UDP leads to real ones as well."""
    if uri.startswith("software:"):
        return True
    try:
        address = udp_address(uri)
        host = "" if address is None else address[0]
        return host == "localhost" or (
            isinstance(found := ipaddress.ip_address(host), ipaddress.IPv4Address)
            and found.is_loopback
        )
    except (BadInputError, ValueError):
        return False


def udp_address(uri: str) -> tuple[str, int] | None:
    """Host and port of ``udp://HOST:PORT``, None for another scheme. Raises BadInputError."""
    parts = urlsplit(uri)
    if parts.scheme != "udp":
        return None
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if host is None or port is None:
        raise BadInputError(f"command link {uri!r}: give it as udp://HOST:PORT")
    return host, port


def ways_of(uris: Iterable[str]) -> dict[str, set[str]]:
    """Names of the dongle or cable that each address leads through, empty for another link.

    A dongle has two, its number and its serial number, where it is plugged in and tells: USB is
    asked, so not on the event loop.
    """
    found: dict[str, set[str]] = {}
    for uri in uris:
        cable, radio = _CABLE.fullmatch(uri), _RADIO.fullmatch(uri)
        found[uri] = {f"cable {int(cable['cable'])}"} if cable else set()
        if radio:
            found[uri] = both_names(radio["dongle"], _serial_numbers())
    return found


def both_names(dongle: str, plugged_in: Sequence[str]) -> set[str]:
    """Of a dongle given by one of them. plugged_in: serial numbers in the order of the numbers."""
    dongle = str(int(dongle)) if len(dongle) < _LEAST_SERIAL else dongle.upper()
    names = {dongle}
    for number, serial in enumerate(plugged_in):
        if dongle in (str(number), serial.upper()):
            names |= {str(number), serial.upper()}
    return {f"dongle {name}" for name in names}


def _serial_numbers() -> list[str]:
    """Of the dongles that are plugged in; empty where a user may not read one, or without cflib."""
    try:
        from cflib.drivers.crazyradio import get_serials

        return [str(serial) for serial in get_serials()]
    except Exception:  # of libusb, pyusb and cflib: whoever opens the dongle is told why
        return []


def in_reach() -> list[str]:
    """Addresses of the craft that answer a dongle or a cable; takes seconds with a dongle.

    Raises BadInputError without cflib.
    """
    try:
        from cflib.crtp.radiodriver import RadioDriver
        from cflib.crtp.usbdriver import UsbDriver
    except ImportError as error:
        raise BadInputError(f"to look for craft cflib is needed: {HINT}") from error
    found: list[str] = []
    with contextlib.redirect_stdout(io.StringIO()):  # cflib prints what it does not find
        for driver in (RadioDriver(), UsbDriver()):
            found += [uri for uri, *_ in driver.scan_interface(None)]
    return found


# The interface every command link has: setpoints and parameters towards the craft.
#
# Telemetry comes in on one link, commands go out on another: a real system is a receiver and a
# Crazyradio. Everything that passes in either direction is reported for the recording.


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
            ("vx_m_s", vx_m_s, SPEED_MOST_M_S),
            ("vy_m_s", vy_m_s, SPEED_MOST_M_S),
        ):
            if value is not None and not (math.isfinite(value) and abs(value) <= most):
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
    """Raises BadInputError for a velocity that is half of one, or beside others."""
    if vx_m_s is None and vy_m_s is None:
        return
    if vx_m_s is None or vy_m_s is None:
        raise BadInputError("setpoint: give vx_m_s and vy_m_s, or neither")
    if height_m is None:
        raise BadInputError("setpoint: vx_m_s and vy_m_s need height_m")
    if roll_deg or pitch_deg:
        raise BadInputError("setpoint: give roll_deg and pitch_deg, or vx_m_s and vy_m_s, not both")
