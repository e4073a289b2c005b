"""What the viewer calls things, and the units in which people read them.

People get degrees, deg/s, g, per cent, volts and rpm.

| entity | values |
|---|---|
| /craft | orientation of the craft: body FLU in the world ENU |
| /telemetry/attitude, rates, accelerometer, motors, battery, rotors | see ``GROUPS`` |
| /link/NAME | link statistics: those of ``STATISTICS`` |
| /events, /commands | what happened and what was commanded, as text |
| /tables/NAME/VARIABLE | what a craft logs besides its telemetry, further tables of a file |
| /twin/rates, attitude, accelerometer, gap | live only: measured beside predicted (``twin_log``) |

Timelines: ``device_time`` (duration) and ``host_time`` (Unix).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.packet import STANDARD_GRAVITY

APPLICATION = "groundstation"
DEVICE_TIME = "device_time"
HOST_TIME = "host_time"

CRAFT = "/craft"
TABLES = "tables"
EVENTS = "/events"
COMMANDS = "/commands"
LINK = "/link"

ROLL, PITCH, YAW = (239, 83, 80), (102, 187, 106), (66, 165, 245)
MOTORS = ((255, 167, 38), (38, 198, 218), (171, 127, 230), (212, 225, 87))
"""Colours of M1..M4, the same on the craft and in the plots."""


@dataclass(frozen=True, slots=True)
class Group:
    """A channel of the samples and how people read it.

    per_si: what one SI unit is in the shown unit.
    """

    entity: str
    column: str
    per_si: float
    names: tuple[str, ...]
    colors: tuple[tuple[int, int, int], ...]


GROUPS: tuple[Group, ...] = (
    Group(
        "/telemetry/attitude",
        "attitude",
        180 / np.pi,
        ("roll", "pitch (nose down +)", "yaw"),
        (ROLL, PITCH, YAW),
    ),
    Group(
        "/telemetry/rates",
        "gyro",
        180 / np.pi,
        ("roll rate", "pitch rate", "yaw rate"),
        (ROLL, PITCH, YAW),
    ),
    Group(
        "/telemetry/accelerometer",
        "accelerometer",
        1 / STANDARD_GRAVITY,
        ("forward", "left", "up"),
        (ROLL, PITCH, YAW),
    ),
    Group(
        "/telemetry/motors",
        "duty",
        100.0,
        ("M1 front", "M2 right", "M3 rear", "M4 left"),
        MOTORS,
    ),
    Group("/telemetry/battery", "battery_v", 1.0, ("battery",), ((255, 202, 40),)),
    Group("/telemetry/rotors", "rotor_rev_s", 60.0, ("M1", "M2", "M3", "M4"), MOTORS),
    Group("/telemetry/motor_steps", "duty_step", 100.0, ("M1", "M2", "M3", "M4"), MOTORS),
)
"""Shown in degrees, deg/s, g, % duty, V and rpm."""

STATISTICS: dict[str, tuple[str, tuple[int, int, int]]] = {
    "loss_pct": ("lost (%)", (239, 83, 80)),
    "latency_ms": ("latency (ms)", (255, 202, 40)),
    "rate_hz": ("samples (1/s)", (102, 187, 106)),
    "packets_hz": ("packets (1/s)", (66, 165, 245)),
    "copies": ("copies per sample", (171, 127, 230)),
    "latency_p99_ms": ("latency, 99 % (ms)", (255, 167, 38)),
    "jitter_ms": ("jitter (ms)", (212, 225, 87)),
    "clock_ppm": ("device clock (ppm)", (38, 198, 218)),
}
"""The link statistics that can be plotted; the layout shows the first three."""


def scaled(group: Group, values: NDArray[np.float32]) -> NDArray[np.float64]:
    """SI values in the unit that people read."""
    return values.astype(np.float64) * group.per_si
