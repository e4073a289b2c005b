"""PID gains in the thesis's form, and the law they stand for.

The law (thesis eq. 8.1, 8.4-8.7), at samples k of period Ts, e = r - y:

    u[k] = K_P e[k] + K_I s[k] + K_D (e[k] - e[k-1]) / Ts,    s[k+1] = s[k] + Ts e[k]

Eq. 8.1 prints z^-1 where z - 1 is meant: the integral is K_I Ts / (z - 1), a forward Euler sum.
Its derivative K_D (z - 1) / Ts looks one sample ahead; what can be computed is one sample later,
K_D (1 - z^-1) / Ts. P, PI and PD are PIDs with gains of zero.
"""

from __future__ import annotations

import math

import msgspec

from groundstation.errors import BadInputError


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
