"""What ``bench motor`` commands: thrust up and down, 100 times a second (thesis 7.2.1).

The craft is fixed to the bench, so roll, pitch and yaw rate stay zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from groundstation.control.programme import RATE_HZ, AbortLimits, LowBattery, reason_to_abort
from groundstation.errors import BadInputError
from groundstation.telemetry.packet import FULL_16_BIT

Shape = Literal["steps", "staircase", "chirp"]
SHAPES: tuple[Shape, ...] = ("steps", "staircase", "chirp")
LEAST, MOST = 0.16, 0.9
"""Share of full thrust: below, the firmware of 2014 takes it for none; above, it clips at 0.915."""
RAMP_S = 1.0
STAIRS = 8
CHIRP_HZ = (0.1, 5.0)

FIXED = AbortLimits(tilt_deg=180.0, rate_dps=300.0)
"""A fixed craft hardly turns, whatever its angle; its sensor feels the motors shake."""
TILT_CHANGE_DEG = 20.0
"""The reported angles of a fixed craft wander by less."""


@dataclass(frozen=True, slots=True)
class ThrustProfile:
    """shape: ``steps`` (a new level between low and high every hold_s, at random), ``staircase``
    (eight levels up and down again, hold_s each) or ``chirp`` (a sine of 0.1 to 5 Hz). low, high:
    shares of full thrust. seconds: between the ramps up and down of 1 s each."""

    shape: Shape = "steps"
    low: float = 0.3
    high: float = 0.8
    hold_s: float = 0.4
    seconds: float = 40.0
    seed: int = 0

    def thrusts(self) -> NDArray[np.int64]:
        """16-bit thrust of every 10 ms, (k,); begins and ends with motors off."""
        time = np.arange(round(self.seconds * RATE_HZ)) / RATE_HZ
        if self.shape == "chirp":
            slow, fast = CHIRP_HZ
            turns = slow * time + (fast - slow) * time**2 / (2.0 * self.seconds)
            share = -np.cos(2.0 * math.pi * turns)
        else:
            number = (time / self.hold_s + 1e-9).astype(int)
            share = self._levels(int(number[-1]) + 1)[number]
        levels = self.low + (self.high - self.low) * (share + 1.0) / 2.0
        rise = np.linspace(0.0, 1.0, round(RAMP_S * RATE_HZ), endpoint=False)
        whole = np.concatenate([levels[0] * rise, levels, levels[-1] * rise[::-1], [0.0]])
        return np.rint(FULL_16_BIT * whole).astype(np.int64)

    def _levels(self, count: int) -> NDArray[np.float64]:
        """Levels in turn, -1 to 1."""
        if self.shape == "steps":
            return np.random.default_rng(self.seed).uniform(-1.0, 1.0, count)
        up = np.linspace(-1.0, 1.0, STAIRS)
        return np.resize(np.concatenate([up, up[-2:0:-1]]), count)

    def as_dict(self) -> dict[str, Any]:
        """For the mark in the recording."""
        return {name: getattr(self, name) for name in self.__slots__}


def require_drivable(profile: ThrustProfile) -> None:
    """Raises BadInputError for what no motor should be driven with, saying what may be."""
    if profile.shape not in SHAPES:
        raise BadInputError(f"--profile {profile.shape}: there are {', '.join(SHAPES)}")
    for name, value, low, high, unit in (
        ("--low", profile.low, LEAST, MOST, "of full thrust"),
        ("--high", profile.high, LEAST, MOST, "of full thrust"),
        ("--hold", profile.hold_s, 0.1, 10.0, "s"),
        ("--seconds", profile.seconds, 4.0, 180.0, "s"),
    ):
        if not low <= value <= high:
            raise BadInputError(f"{name} {value:g}: must be {low:g}..{high:g} {unit}")
    if not profile.high - profile.low >= 0.1:
        raise BadInputError(
            f"--low {profile.low:g}, --high {profile.high:g}: 0.1 apart at least, or the motor"
            " shows nothing"
        )


def reason_to_stop(answer: Mapping[str, Any], at_rest: Mapping[str, Any], low: LowBattery) -> str:
    """Why the motors must stop now, from the daemon's answer to a setpoint; empty while all is
    well. at_rest: the telemetry before the motors turned. low: of this run."""
    reason = reason_to_abort(answer, low, FIXED)
    if reason:
        return f"{reason}: is the craft loose?" if reason.startswith("rate") else reason
    now = answer["telemetry"]
    tilted = max(abs(now[name] - at_rest[name]) for name in ("roll_deg", "pitch_deg"))
    if not tilted <= TILT_CHANGE_DEG:
        return f"tilted by {tilted:.0f} deg since the start: is the craft loose?"
    return ""
