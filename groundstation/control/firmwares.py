"""Whose loops fly: the Crazyflie 1.0's release 2014.01.0, or those of today's 2.x and Brushless.

Both know their gains by the same parameter names, and mean other things by the same numbers:
2014's rate loops ask for PWM, today's for thrust, which the battery compensation turns into PWM.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from groundstation.dynamics.model import Model, model_vehicle
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import FULL_16_BIT

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
    {
        "roll": (
            "pid_rate.{}_kp",
            "pid_attitude.{}_kp",
            "pid_attitude.{}_ki",
            "pid_attitude.{}_kd",
        ),
        "yaw": ("pid_rate.{}_kp", "pid_rate.{}_ki"),
    },
)


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
        {
            "roll": (
                "pid_rate.{}_kp",
                "pid_rate.{}_ki",
                "pid_rate.{}_kd",
                "pid_attitude.{}_kp",
                "pid_attitude.{}_ki",
            ),
            "yaw": ("pid_rate.{}_kp", "pid_rate.{}_ki", "pid_attitude.{}_kp", "pid_attitude.{}_ki"),
        },
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
