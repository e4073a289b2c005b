"""What today's firmware says of its supervisor, its battery and its height, in words for an
operator."""

from __future__ import annotations

import math
from dataclasses import dataclass

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
    axis from the vertical, NaN where it does not say. heard_s: when it came, monotonic."""

    x_m: float
    y_m: float
    z_m: float
    vx_m_s: float
    vy_m_s: float
    vz_m_s: float
    tilt_deg: float = math.nan
    heard_s: float = 0.0

    @classmethod
    def of(cls, values: dict[str, float], heard_s: float) -> Place:
        """From the log variables of ``PLACE`` and, where there are any, of ``LEAN``."""
        roll, pitch = (math.radians(values.get(name, math.nan)) for name in LEAN)
        upright = math.cos(roll) * math.cos(pitch)
        x, y, z, vx, vy, vz = (values[name] for name in PLACE)
        return cls(x, y, z, vx, vy, vz, math.degrees(math.acos(upright)), heard_s)


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
