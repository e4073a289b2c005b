"""The sensor is not at the centre of gravity."""

from __future__ import annotations

from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, Values, vector
from firmware_sim.layout import RATE, Record


@inner
def lever_arm_acceleration(p: Record, y: Any, dy: Any) -> Any:
    """alpha x r + Omega x (Omega x r) in m/s^2, all in body axes."""
    x, v, z = p.lever[0], p.lever[1], p.lever[2]
    ax, ay, az = dy[RATE], dy[RATE + 1], dy[RATE + 2]
    wx, wy, wz = y[RATE], y[RATE + 1], y[RATE + 2]
    along = wx * x + wy * v + wz * z
    square = wx * wx + wy * wy + wz * wz
    return (
        ay * z - az * v + wx * along - square * x,
        az * x - ax * z + wy * along - square * v,
        ax * v - ay * x + wz * along - square * z,
    )


NAMES = ("x_m", "y_m", "z_m")


def _apply(p: Any, values: Values) -> None:
    p["lever"] = [values[name] for name in NAMES]
    p["levered"] = int(any(values.values()))


def _present(p: Any) -> Values | None:
    if not p["lever"].any():
        return None
    return dict(zip(NAMES, p["lever"].tolist(), strict=True))


EFFECT = Effect(
    parameters=dict.fromkeys(NAMES, (0.0, "m")),
    apply=_apply,
    present=_present,
    draw=vector(1e-3, 6e-3, *NAMES),
)
