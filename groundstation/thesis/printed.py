"""What the thesis prints of identification; of its controllers see ``control.thesis_tables``."""

from __future__ import annotations

PACKET = (
    ("Timestamp", "microseconds", "2"),
    ("Battery voltage", "millivolts", "2"),
    ("Motor PWM", "1:4096", "1.5 x 4"),
    ("Gyroscope axes", "degrees per second", "2 x 3"),
    ("Accelerometer axes", "g-force", "2 x 3"),
    ("Roll, pitch, yaw", "degrees", "2 x 3"),
    ("Debug / motor speed", "-", "4"),
)
"""Table 5.1: data, unit, bytes."""

MOTOR_FIT = {"identification": 86.80, "validation 1": 79.45, "validation 2": 91.73}
"""Table 7.1, fit in percent."""

BODY_RMS = {
    ("roll", "identification"): 0.0847,
    ("roll", "validation"): 0.1209,
    ("pitch", "validation"): 0.0345,
    ("yaw", "identification"): 0.0230,
    ("yaw", "validation"): 0.0181,
}
"""Table 7.2, rad."""

Order = tuple[int, int, int]
ROLL_ARX: dict[Order, tuple[float, float]] = {
    (2, 2, 0): (0.0134, 0.0277),
    (2, 1, 8): (0.0103, 0.0296),
    (2, 1, 9): (0.0099, 0.0301),
    (2, 1, 7): (0.0127, 0.0304),
    (2, 1, 6): (0.0140, 0.0309),
    (3, 1, 4): (0.0184, 0.0332),
    (4, 2, 0): (0.0192, 0.0340),
    (2, 2, 9): (0.0122, 0.0345),
    (2, 2, 6): (0.0157, 0.0367),
    (3, 1, 9): (0.0205, 0.0388),
    (3, 2, 9): (0.0207, 0.0392),
    (2, 1, 5): (0.0232, 0.0396),
    (2, 2, 8): (0.0163, 0.0413),
    (3, 1, 8): (0.0238, 0.0420),
    (4, 2, 9): (0.0256, 0.0446),
    (4, 1, 9): (0.0264, 0.0460),
    (2, 2, 2): (0.0223, 0.0463),
    (2, 2, 7): (0.0199, 0.0486),
    (4, 1, 8): (0.0316, 0.0523),
    (2, 1, 4): (0.0355, 0.0550),
}
"""Table 7.3: structure -> RMS in rad on identification and validation data, in printed order."""

YAW_ARX: dict[Order, tuple[float, float]] = {
    (2, 1, 8): (0.0129, 0.0140),
    (3, 2, 8): (0.0124, 0.0172),
    (2, 1, 7): (0.0142, 0.0277),
    (2, 2, 8): (0.0096, 0.0419),
    (2, 2, 7): (0.0115, 0.0461),
    (3, 2, 7): (0.0113, 0.0573),
    (2, 1, 9): (0.0091, 0.0694),
    (2, 2, 6): (0.0107, 0.0746),
    (3, 1, 9): (0.0089, 0.0795),
    (4, 2, 9): (0.0103, 0.0849),
    (3, 2, 9): (0.0101, 0.0896),
    (2, 2, 9): (0.0086, 0.0957),
    (2, 2, 5): (0.0094, 0.1056),
    (3, 1, 8): (0.0085, 0.1077),
    (3, 2, 6): (0.0096, 0.1149),
    (2, 1, 6): (0.0083, 0.1188),
    (2, 2, 4): (0.0090, 0.1229),
    (4, 2, 8): (0.0095, 0.1251),
    (3, 1, 7): (0.0081, 0.1309),
    (2, 1, 5): (0.0081, 0.1342),
}
"""Table 7.5, as Table 7.3."""

ROLL_ON_PITCH = 0.0411
"""Table 7.4: ARX(2,1,8) of roll on pitch, validation, rad."""

ROLL_STEPS = {
    (2, 2, 0): "too small to be true",
    (2, 1, 8): "plausible, chosen",
    (3, 1, 4): "not that of a free body",
    (4, 2, 0): "not that of a free body",
}
"""Figures 7.45 to 7.48: what the thesis says of the step responses."""

CROSS = {
    (2, 2, 0): "correlated",
    (2, 1, 8): "passes",
    (3, 1, 4): "correlated",
    (4, 2, 0): "correlated",
}
"""Figures 7.49 to 7.52: residuals against the input."""

WITHOUT = (
    ("Figures 1.1 to 1.14", "photographs of other quadrotors"),
    ("Figures 2.1, 2.2", "drawings of the configurations; signs and mixer: docs/hardware.md"),
    ("Figures 3.1 to 3.8", "block diagrams and drawings; the equations: docs/thesis_errata.md"),
    ("Figures 4.1 to 4.15", "photographs and diagrams of the craft and its sensors"),
    ("Figures 5.1 to 5.6", "photographs of the add-on; its protocol: docs/hardware.md"),
    ("Table 6.1, Figures 6.1, 6.2", "which sensors give which angles; drawings of sensor axes"),
    ("Figures 7.1, 7.2, 7.12, 7.32", "block diagrams of eq. 7.9, 3.82, 7.12-7.17 and 7.19"),
    ("Figures 7.7, 7.8, 7.26, 7.33", "screenshots of Matlab; here: docs/identification.md"),
    ("Figures 8.1 to 8.9", "block diagrams of the simulation; here: docs/pid.md"),
    ("Figures 8.11, 8.13, 8.15, 8.17", "block diagrams of the controllers, eq. 8.4 to 8.7"),
)
"""What has no counterpart, and why."""
