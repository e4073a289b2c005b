"""What today's firmware says of its supervisor, its battery and its height, in words for an
operator."""

from __future__ import annotations

import math
from dataclasses import dataclass

INFO, POWER = "supervisor.info", "pm.state"
HEIGHT, HEIGHT_VARIANCE = "stateEstimate.z", "kalman.varPZ"
STATE = (INFO, POWER, HEIGHT, HEIGHT_VARIANCE)
"""Log variables, slow ones."""
LOW_POWER = 3
HEIGHT_KNOWN_M = 0.1
"""Standard error of a height that a craft can be left with: the estimator begins at 1 m, and stays
there or grows where nothing measures the height; ranges, base stations or anchors make it some mm
to cm."""
_CAN_ARM, _ARMED, _ARMS_ITSELF, _FLIES = (1 << place for place in (0, 1, 2, 4))
_TUMBLED, _LOCKED, _CRASHED, _DECK_FAULT = (1 << place for place in (5, 6, 7, 11))
DISARMED_ITSELF = (
    "the craft has disarmed its motors by itself, as it does where it is not flown soon, and soon"
    " after a landing"
)
TUMBLED = "the craft lies on its side or its back: set it upright"
BATTERY_LOW = "the craft warns that its battery is low: land"


@dataclass(frozen=True, slots=True)
class Supervisor:
    """bits: of ``supervisor.info``, None: the craft does not say. low_battery: it warns of that.
    height_m: what its Kalman filter says, None where it is not sure of that."""

    bits: int | None = None
    low_battery: bool = False
    height_m: float | None = None

    @classmethod
    def of(cls, values: dict[str, float]) -> Supervisor:
        """From log variables; what the firmware does not list is missing."""
        bits, height_m = values.get(INFO), values.get(HEIGHT, math.nan)
        # a filter that does not run says 0
        is_sure = 0.0 < values.get(HEIGHT_VARIANCE, 0.0) <= HEIGHT_KNOWN_M**2
        return cls(
            None if bits is None else int(bits),
            values.get(POWER) == LOW_POWER,
            height_m if is_sure and math.isfinite(height_m) else None,
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
        return "the craft is not armed: `groundstation motors arm`, or on the page (Arm...)"
