"""The drawing of the craft."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import rerun as rr

from groundstation.rerun_log.channels import CRAFT, MOTORS

NOSE = (255, 64, 129)


def craft_drawing() -> Iterator[tuple[str, Any]]:
    """A Crazyflie in plus configuration, metres, body FLU, above a compass rose in world ENU."""
    yield "/", rr.ViewCoordinates.RIGHT_HAND_Z_UP
    arm, rotor_radius, rotor_height = 0.046, 0.0225, 0.013
    tips = np.array([(arm, 0, 0), (0, -arm, 0), (-arm, 0, 0), (0, arm, 0)])
    metal, dark = (176, 182, 192), (96, 102, 112)
    yield (
        f"{CRAFT}/arms",
        rr.LineStrips3D([tips[[0, 2]], tips[[1, 3]]], radii=0.0028, colors=dark),
    )
    yield (
        f"{CRAFT}/board",
        rr.Boxes3D(
            half_sizes=[(0.015, 0.015, 0.0015), (0.012, 0.008, 0.004)],
            centers=[(0, 0, 0.002), (0, 0, 0.007)],
            colors=[dark, metal],
            fill_mode="solid",
        ),
    )
    yield (
        f"{CRAFT}/motors",
        rr.Cylinders3D(
            lengths=[0.02] * 4,
            radii=[0.004] * 4,
            centers=tips + np.array([0, 0, 0.002]),
            colors=metal,
            fill_mode="solid",
        ),
    )
    yield (
        f"{CRAFT}/rotors",
        rr.Cylinders3D(
            lengths=[0.0015] * 4,
            radii=[rotor_radius] * 4,
            centers=tips + np.array([0, 0, rotor_height]),
            colors=MOTORS,
            fill_mode="solid",
        ),
    )
    yield (
        f"{CRAFT}/nose",
        rr.Arrows3D(
            origins=[(arm, 0, rotor_height + 0.004)],
            vectors=[(0.052, 0, 0)],
            radii=0.0022,
            colors=NOSE,
        ),
    )
    yield from _compass_rose(radius=0.105, below=0.06)


def _compass_rose(radius: float, below: float) -> Iterator[tuple[str, Any]]:
    """A still reference under the craft: a circle with a mark every 30 deg, east and north."""
    grey = (120, 126, 138)
    angles = np.radians(np.arange(0, 361, 5))
    circle = np.stack([np.cos(angles), np.sin(angles), np.full(len(angles), -below)], axis=1)
    circle[:, :2] *= radius
    marks = [np.array([point, point * (0.92, 0.92, 1)]) for point in circle[:-1:6]]
    cross = [circle[[0, 36]], circle[[18, 54]], np.array([(0, 0, -below), (0, 0, 0)])]
    yield (
        "/world/compass",
        rr.LineStrips3D([circle, *marks, *cross], radii=0.0005, colors=grey),
    )
    yield (
        "/world/directions",
        rr.Points3D(
            circle[[0, 18]] * (1.12, 1.12, 1),
            labels=["east (x)", "north (y)"],
            radii=0.0005,
            colors=grey,
            show_labels=True,
        ),
    )
