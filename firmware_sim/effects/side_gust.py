"""A periodic gust from the right: outside every list."""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, each, sets
from firmware_sim.layout import Record


@inner
def side_gust(p: Record, time_s: float) -> Any:
    """A periodic gust from the right: force along inertial y (N) and roll torque (N m)."""
    wave = math.sin(2.0 * math.pi * p.gust_hz * time_s)
    return p.gust_force * wave, p.gust_moment * wave


EFFECT = Effect(
    parameters={
        "frequency_hz": (0.7, "Hz"),
        "force_n": (0.01, "N"),
        "moment_n_m": (1e-5, "N m"),
    },
    apply=sets(gust_hz="frequency_hz", gust_force="force_n", gust_moment="moment_n_m"),
    draw=each(frequency_hz=(0.3, 2.0), force_n=(0.004, 0.02), moment_n_m=(4e-6, 4e-5)),
    limits={"frequency_hz": (0.0, 250.0), "force_n": (-1.0, 1.0), "moment_n_m": (-0.01, 0.01)},
    listed=False,
)
