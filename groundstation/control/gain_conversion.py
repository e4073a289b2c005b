"""Gains from one loop's form to another's.

direct: u' in (rev/s)^2 per rad. whole: PWM counts (4096 full) per rad. Between them stand the
motors around hover, as they are once settled. firmware: that of 2014, whose cascade is, for a
setpoint that stands still,

    out = (K_r + F K_ri / s) ((K_a + S K_ai / s) e - w),    w = -de/dt

in 16-bit PWM per deg, with the release's ratios F = 3 and S = 1/2 of its integrals. So K_D is K_r,
K_P is K_r K_a + F K_ri, K_I is K_r S K_ai + F K_ri K_a; a product of both integrals is no PID. What
a conversion cannot keep: the derivative of a moving setpoint, and limits of integrals.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from groundstation.control.firmware_loop import integral_ratios, require_gains
from groundstation.control.firmwares import FULL, RELEASE_2014
from groundstation.control.pid import PidGains
from groundstation.control.thesis_loop import SUPPLY_MV, counts_per_control
from groundstation.dynamics.model import Model
from groundstation.dynamics.vehicle import PWM_FULL
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES

FORMS = ("direct", "whole", "firmware")
PER_DEG = FULL / PWM_FULL * math.pi / 180.0
"""16-bit PWM per deg for one count of 4096 per rad."""


def scaled(gains: PidGains, factor: float) -> PidGains:
    """All three gains times a factor."""
    return PidGains(*(factor * value for value in gains.as_tuple()))


def convert_gains(
    gains: Mapping[str, PidGains] | Mapping[str, float],
    source: str,
    target: str,
    model: Model,
    supply_mv: float = SUPPLY_MV,
) -> dict[str, PidGains] | dict[str, float]:
    """Gains of the form ``source`` as those of the form ``target`` for a model's motors.

    From the firmware's form all axes of which gains are given, the rest of them stock.
    Raises BadInputError for gains that the other form does not have.
    """
    counts = dict(zip(AXES, counts_per_control(model, supply_mv).tolist(), strict=True))
    if source == "firmware":
        values = {name: g for name, g in gains.items() if not isinstance(g, PidGains)}
        whole = {
            axis: _of_cascade({**RELEASE_2014.stock, **values}, axis)
            for axis in AXES
            if any(f".{axis}_" in name for name in values)
        }
    else:
        factor = counts if source == "direct" else dict.fromkeys(AXES, 1.0)
        by_axis = {axis: g for axis, g in gains.items() if isinstance(g, PidGains)}
        whole = {axis: scaled(g, factor[axis]) for axis, g in by_axis.items()}
    if target == "direct":
        return {axis: scaled(one, 1.0 / counts[axis]) for axis, one in whole.items()}
    if target == "whole":
        return whole
    made = {name: value for axis, one in whole.items() for name, value in _cascade(one, axis)}
    require_gains(made, "converted to the firmware's form")
    return made


def _of_cascade(values: Mapping[str, float], axis: str) -> PidGains:
    fast, slow = integral_ratios(RELEASE_2014)
    rate, rate_i = (values[f"pid_rate.{axis}_{k}"] for k in ("kp", "ki"))
    angle, angle_i, angle_d = (values[f"pid_attitude.{axis}_{k}"] for k in ("kp", "ki", "kd"))
    rate_i, angle_i = fast * rate_i, slow * angle_i
    if rate_i and angle_i:
        raise BadInputError(
            f"{axis}: an angle integral over a rate integral is no PID; set one of"
            f" pid_rate.{axis}_ki and pid_attitude.{axis}_ki to 0"
        )
    kp = rate * angle + rate_i * (1.0 + angle_d / slow)
    ki = rate * angle_i + rate_i * angle
    return scaled(PidGains(kp, ki, rate * (1.0 + angle_d / slow)), 1.0 / PER_DEG)


def _cascade(gains: PidGains, axis: str) -> list[tuple[str, float]]:
    fast, slow = integral_ratios(RELEASE_2014)
    kp, ki, kd = (PER_DEG * value for value in gains.as_tuple())
    if not kd > 0.0:
        raise BadInputError(f"{axis}: kd {gains.kd:g}: the firmware's rate loop needs one above 0")
    if axis == "yaw":
        if ki:
            raise BadInputError(
                f"yaw: ki {gains.ki:g}: the firmware's yaw has no loop for it; set it to 0"
            )
        return [("pid_rate.yaw_kp", kd), ("pid_rate.yaw_ki", kp / fast)]
    return [
        (f"pid_rate.{axis}_kp", kd),
        (f"pid_attitude.{axis}_kp", kp / kd),
        (f"pid_attitude.{axis}_ki", ki / kd / slow),
    ]
