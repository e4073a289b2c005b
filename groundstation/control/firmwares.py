"""PID gains and whose loops fly with them: their form, their firmware, its thrust curve."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from groundstation.dynamics.craft import craft_of_model
from groundstation.dynamics.model import Model, model_vehicle
from groundstation.dynamics.simulation import hover_rev_s
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.recording.session import Recording
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import FULL_16_BIT
from groundstation.telemetry.samples import SampleBatch

# PID gains in the thesis's form, and the law they stand for.
#
# The law (thesis eq. 8.1, 8.4-8.7), at samples k of period Ts, e = r - y:
#
#     u[k] = K_P e[k] + K_I s[k] + K_D (e[k] - e[k-1]) / Ts,    s[k+1] = s[k] + Ts e[k]
#
# Eq. 8.1 prints z^-1 where z - 1 is meant: the integral is K_I Ts / (z - 1), a forward Euler sum.
# Its derivative K_D (z - 1) / Ts looks one sample ahead; what can be computed is one sample later,
# K_D (1 - z^-1) / Ts. P, PI and PD are PIDs with gains of zero.


class PidGains(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """K_P in output unit per rad, K_I per rad s, K_D per rad/s.

    On the direct loop the output is u' in (rev/s)^2; in the whole simulation it is PWM counts.
    """

    kp: float
    ki: float = 0.0
    kd: float = 0.0

    @property
    def kind(self) -> str:
        """``P``, ``PI``, ``PD`` or ``PID``."""
        return "P" + ("I" if self.ki else "") + ("D" if self.kd else "")

    def as_tuple(self) -> tuple[float, float, float]:
        return self.kp, self.ki, self.kd


_OUTPUT = {"direct": "(rev/s)²", "whole": "PWM counts"}
_PER = {"kp": "rad", "ki": "rad s", "kd": "rad/s"}


def gain_unit(name: str, loop: str) -> str:
    """Of ``kp``, ``ki`` or ``kd`` on the ``direct`` or the ``whole`` loop."""
    return f"{_OUTPUT[loop]} per {_PER[name]}"


def require_finite(gains: PidGains, where: str) -> None:
    """Raises BadInputError for a gain that is no finite number."""
    for name, value in zip(("kp", "ki", "kd"), gains.as_tuple(), strict=True):
        if not math.isfinite(value):
            raise BadInputError(f"{where}: {name} is {value}, must be a finite number")


# Whose loops fly: the Crazyflie 1.0's release 2014.01.0, or those of today's 2.x and Brushless.
#
# Both know their gains by the same parameter names, and mean other things by the same numbers:
# 2014's rate loops ask for PWM, today's for thrust, which the battery compensation turns into PWM.


Release = Literal["2014", "2.x"]
RELEASES: tuple[Release, ...] = get_args(Release)
Curve = tuple[float, float, float, float]
FULL = FULL_16_BIT + 1.0
"""Duty 1 in the firmware's 16 bits."""


@dataclass(frozen=True, slots=True)
class Firmware:
    """stock: every gain by parameter name. rate_limit, angle_limit: of the integrals of roll, pitch
    and yaw, in deg and deg s. curve: thrust of a motor in N from its voltage in V, constant first,
    and most_n the most it is taken to give, of a firmware that compensates the battery.
    designed: the gains that a design chooses, roll's and yaw's, without the axis.
    """

    name: Release
    stock: Mapping[str, float]
    rate_limit: tuple[float, float, float]
    angle_limit: tuple[float, float, float]
    designed: Mapping[str, tuple[str, ...]]
    curve: Curve = (0.0, 0.0, 0.0, 0.0)
    most_n: float = 0.0

    @property
    def is_today(self) -> bool:
        return self.name == "2.x"

    def gain_names(self, axis: str) -> tuple[str, ...]:
        """The parameters that a design chooses for an axis.

        2014's rate derivative has no effect (the clamp macro), its yaw has no angle
        loop, and the integral of roll and pitch is the angle loop's; their rate integral stays 0.
        """
        pattern = self.designed["yaw" if axis == "yaw" else "roll"]
        return tuple(each.format(axis) for each in pattern)

    def thrust(self, duty: ArrayLike, supply_mv: ArrayLike) -> Array:
        """The 16-bit thrust that a duty 0..1 at a supply was asked for with."""
        share = np.asarray(duty, np.float64)
        if not self.is_today:
            return share * FULL
        volts = share * np.asarray(supply_mv, np.float64) / 1000.0
        newtons = np.polynomial.polynomial.polyval(volts, self.curve)
        return np.maximum(newtons, 0.0) / self.most_n * FULL_16_BIT

    def volts_per_thrust(self, volts: float) -> float:
        """Motor voltage for one more unit of thrust at a voltage."""
        slope = np.polynomial.polynomial.polyval(
            volts, np.polynomial.polynomial.polyder(self.curve)
        )
        return float(self.most_n / FULL_16_BIT / slope)


def _gains(**loops: tuple[float, float, float]) -> dict[str, float]:
    """``rate_kp=(roll, pitch, yaw)`` and so on, by parameter name."""
    return {
        f"pid_{'rate' if key.startswith('rate') else 'attitude'}.{axis}_{key[-2:]}": value
        for key, values in loops.items()
        for axis, value in zip(AXES, values, strict=True)
    }


_YAW_2014 = ("pid_rate.{}_kp", "pid_rate.{}_ki")
_TILT_2014 = ("pid_rate.{}_kp", *(f"pid_attitude.{{}}_{k}" for k in ("kp", "ki", "kd")))
RELEASE_2014 = Firmware(
    "2014",
    _gains(
        rate_kp=(70.0, 70.0, 50.0),
        rate_ki=(0.0, 0.0, 25.0),
        rate_kd=(0.0, 0.0, 0.0),
        angle_kp=(3.5, 3.5, 0.0),
        angle_ki=(2.0, 2.0, 0.0),
        angle_kd=(0.0, 0.0, 0.0),
    ),
    (100.0, 100.0, 500.0),
    (20.0, 20.0, 360.0),
    {"roll": _TILT_2014, "yaw": _YAW_2014},
)
_YAW_TODAY = (*_YAW_2014, "pid_attitude.{}_kp", "pid_attitude.{}_ki")
_TILT_TODAY = (*_YAW_2014, "pid_rate.{}_kd", "pid_attitude.{}_kp", "pid_attitude.{}_ki")


def _today(kp: float, ki: float, curve: Curve, most_n: float) -> Firmware:
    return Firmware(
        "2.x",
        _gains(
            rate_kp=(kp, kp, 120.0),
            rate_ki=(ki, ki, 16.7),
            rate_kd=(2.5, 2.5, 0.0),
            angle_kp=(6.0, 6.0, 6.0),
            angle_ki=(3.0, 3.0, 1.0),
            angle_kd=(0.0, 0.0, 0.35),
        ),
        (33.3, 33.3, 166.7),
        (20.0, 20.0, 360.0),
        {"roll": _TILT_TODAY, "yaw": _YAW_TODAY},
        curve,
        most_n,
    )


PLATFORMS: dict[str, Firmware] = {
    "crazyflie21": _today(250.0, 500.0, (-0.014831, 0.047245, -0.018474, 0.0059609), 0.12),
    "crazyflie21plus": _today(250.0, 500.0, (-0.024765, 0.065238, -0.026793, 0.0067768), 0.12),
    "crazyflie21upgrade": _today(250.0, 500.0, (0.0067281, 0.010116, 0.010263, 0.0028358), 0.18),
    "brushless": _today(200.0, 400.0, (-0.014059, 0.042653, 0.0018328, 0.0020577), 0.2),
}
"""Today's gains and thrust curves by craft, from the firmware's sources of August 2026."""


def firmware_of_vehicle(vehicle: Vehicle, release: str | None = None) -> Firmware:
    """The firmware that flies a vehicle; release: another than its profile says.

    Raises BadInputError for a release that is none, or one that cannot fly it.
    """
    name = vehicle.firmware if release is None else require_release(release)
    if name == "2014":
        return RELEASE_2014
    if vehicle.configuration != "x":
        raise BadInputError(
            f"vehicle {vehicle.name} is a plus, today's firmware flies an x: say --firmware 2014,"
            f" or fit with --vehicle {', '.join(PLATFORMS)} or a profile of your own"
        )
    if vehicle.name in PLATFORMS:
        return PLATFORMS[vehicle.name]
    return PLATFORMS["brushless" if vehicle.is_brushless else "crazyflie21"]


def firmware_of_model(model: Model, release: str | None = None) -> Firmware:
    """The firmware that flies a model, with the thrust curve that its flights showed. Raises
    BadInputError as ``firmware_of_vehicle`` does."""
    firmware = firmware_of_vehicle(model_vehicle(model), release)
    if model.firmware_curve is None or not firmware.is_today:
        return firmware
    return replace(firmware, curve=model.firmware_curve)


def require_release(name: str) -> Release:
    """Raises BadInputError for what is no firmware."""
    for release in RELEASES:
        if name == release:
            return release
    raise BadInputError(f"--firmware {name}: there are {', '.join(RELEASES)}")


# What a firmware makes of thrust, as flights show it: releases differ by -6 to +28 % at hover.
#
# The controller's output ``stabilizer.thrust`` stands beside the duty and the battery of the same
# moment. A flight stays near its hover, where the level and the slope of the curve count: they are
# measured, and its bend is the profile's.


THRUST = "stabilizer.thrust"
"""The log variable, in units of 16 bits; in any table of a recording."""
LEAST_THRUST = 0.15
"""Of full thrust, below which a craft stands, or falls."""
NEAR_S = 0.02
"""A row of telemetry so near says what the motors did then."""
LEAST_ROWS = 200
TRIMS, OUTSIDE, LEAST_KEPT = 4, 6.0, 0.6
"""Rows so many times the median error off are left out, and the rest is fitted again: motors that
idle, are limited or stand. Where too many are, it is no curve."""
LEAST_R2 = 0.9
"""Of the thrust that is left, the share that the voltage has to explain: the firmware reckons one
from the other without noise, a table of another meaning explains none."""
FURTHEST = 2.0
"""Times the profile's slope: no release is further from another."""


def flown_curve(recordings: Sequence[Recording], firmware: Firmware) -> Curve | None:
    """The curve of ``Firmware.curve``'s kind that these flights show; None where no thrust was
    logged, or it does not tell."""
    pairs = [pair for one in recordings for pair in _pairs(one)]
    if not firmware.is_today or sum(len(thrust) for thrust, _ in pairs) < LEAST_ROWS:
        return None
    thrust, volts = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    newtons = thrust * firmware.most_n
    shape = np.polynomial.polynomial.polyval(volts, firmware.curve)
    kept, slope, level = np.ones(len(shape), bool), 1.0, 0.0
    for _ in range(TRIMS):
        slope, level = np.polyfit(shape[kept], newtons[kept], 1).tolist()
        left = np.abs(newtons - level - slope * shape)
        kept = left <= OUTSIDE * np.median(left)
    if not 1.0 / FURTHEST <= slope <= FURTHEST or kept.sum() < LEAST_KEPT * len(kept):
        return None
    if np.corrcoef(shape[kept], newtons[kept])[0, 1] ** 2 < LEAST_R2:
        return None
    first, *others = (slope * factor for factor in firmware.curve)
    return (first + level, others[0], others[1], others[2])


def against(curve: Curve, firmware: Firmware, model: Model) -> str:
    """How steep a curve is at a model's hover beside that of its profile, in words."""
    volts = model.motor.armature_mv(hover_rev_s(craft_of_model(model))) / 1000.0
    flown, assumed = (
        1e6 * one.volts_per_thrust(volts) for one in (replace(firmware, curve=curve), firmware)
    )
    return (
        f"The firmware's thrust curve, as flown: {flown:.1f} µV a unit of thrust at hover, where"
        f" the profile's has {assumed:.1f} ({100.0 * (flown / assumed - 1.0):+.0f} %); designs use"
        " the flown one."
    )


def _pairs(recording: Recording) -> list[tuple[Array, Array]]:
    """Thrust, as a share of the full one, and the motors' mean voltage (V) while it flew."""
    found = []
    for table in recording.tables.values():
        if THRUST not in table.columns:
            continue
        thrust = np.asarray(table.columns[THRUST], np.float64) / FULL_16_BIT
        volts = _volts(recording.samples, np.asarray(table.time_s, np.float64))
        flies = np.isfinite(thrust) & np.isfinite(volts) & (thrust > LEAST_THRUST) & (thrust < 1.0)
        found.append((thrust[flies], volts[flies]))
    return found


def _volts(samples: SampleBatch, time_s: Array) -> Array:
    """Mean voltage (V) of the motors at moments of the device's clock; NaN where no row is near, or
    one of them is at its limit."""
    rows = np.searchsorted(samples.time_s, time_s).clip(1, max(len(samples) - 1, 1))
    if len(samples) < 2:
        return np.full(len(time_s), np.nan)
    rows -= time_s - samples.time_s[rows - 1] < samples.time_s[rows] - time_s
    duty = samples.duty[rows]
    free = (duty.min(axis=1) > 0.0) & (duty.max(axis=1) < 1.0)
    free &= np.abs(samples.time_s[rows] - time_s) <= NEAR_S
    return np.where(free, duty.mean(axis=1) * samples.battery_v[rows], np.nan)
