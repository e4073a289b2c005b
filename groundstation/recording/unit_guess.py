"""In which unit a column is, and which way its axis points, by its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

RATES_HZ, USUAL_HZ = (1.0, 10_000.0), 100.0
"""Rows a second of any log, and of most."""
GYRO_RAD_S = 35.0
"""2000 deg/s: no gyro of a quadrotor measures more."""
SPAN_S = 0.05
"""Over which an angle's change is compared with the gyro: longer than any of them is renewed."""
ALIKE = 0.4
"""Correlation from which two series turn together."""
_TIMES = {"ms": 1e-3, "s": 1.0, "us": 1e-6, "ns": 1e-9}
_DUTY = (
    (1.05, "fraction", "within 0 to 1"),
    (101.0, "%", "within 0 to 100"),
    (255.5, "8-bit", "within 0 to 255"),
)


def unit_of(quantity: str, columns: Sequence[Array]) -> tuple[str, str]:
    """The likeliest unit of a quantity's columns, and why in a few words."""
    rows = min((len(one) for one in columns), default=0)
    values = np.concatenate([one[np.isfinite(one)] for one in columns] or [np.empty(0)])
    if not len(values):
        return _USUAL[quantity], "usual; it has no numbers"
    most = float(np.abs(values).max())
    if quantity == "time":
        return _time(columns[0])
    if quantity == "gyro":
        return _gyro(values, most)
    if quantity == "accelerometer":
        return _force(np.column_stack([one[:rows] for one in columns]))
    if quantity == "duty":
        return _duty(values, most)
    if quantity == "battery":
        return ("mV", f"about {np.median(values):.0f}") if most > 200 else ("V", f"to {most:.3g}")
    if quantity == "attitude":
        if most > 400:
            return "counts", f"to {most:.0f}: more than a turn in deg"
        if most > 6.3:
            return "deg", f"to {most:.3g}: more than a turn in rad"
        return "rad", f"none beyond {most:.3g}"
    if quantity == "rotor":
        if most > 3000:
            return "rpm", f"to {most:.0f}"
        return ("rad/s" if most > 500 else "rev/s"), f"to {most:.0f}"
    return _USUAL[quantity], ""


_USUAL = {
    **{"time": "s", "battery": "V", "duty": "fraction", "gyro": "deg/s", "accelerometer": "m/s^2"},
    **{"attitude": "deg", "quaternion": "1", "rotor": "rpm"},
}


def goes_on(values: Array) -> bool:
    """Whether a column can be a clock: it hardly ever goes back, and it moves."""
    known = values[np.isfinite(values)]
    if len(known) < 2 or len(known) < 0.9 * len(values):
        return False
    steps = np.diff(known)
    return bool((steps >= 0).mean() > 0.9 and (steps > 0).any())


def is_count(values: Array) -> bool:
    """Whether a column numbers the rows."""
    steps = np.diff(values)
    return len(steps) > 0 and bool((steps == steps[0]).all()) and abs(steps[0]) == 1


def ratio(angle: Array, angle_s: Array, rate: Array, rate_s: Array) -> tuple[float, float] | None:
    """How fast an angle turns over what a gyro says, in their own units, and their correlation;
    None where that cannot be told. Angles beyond a turn's half are taken to jump."""
    known = np.isfinite(rate) & np.isfinite(rate_s)
    rate, rate_s = rate[known], rate_s[known]
    given = np.isfinite(angle) & np.isfinite(angle_s)
    angle, angle_s = angle[given], angle_s[given]
    if len(rate) < 20 or len(angle) < 20 or (np.diff(rate_s) < 0).any():
        return None
    place = np.clip(np.searchsorted(angle_s, rate_s, side="right") - 1, 0, len(angle) - 1)
    on_rows = angle[place]
    step_s = float(np.median(np.diff(rate_s)))
    if not step_s > 0:
        return None
    span = max(1, round(SPAN_S / step_s))
    if len(rate) < 3 * span + 10:
        return None
    half = 3.2 if np.abs(on_rows).max() < 6.4 else 180.0
    change = on_rows[span:] - on_rows[:-span]
    took_s = rate_s[span:] - rate_s[:-span]
    total = np.concatenate([[0.0], np.cumsum(rate)])
    mean = (total[span + 1 : -1] - total[1 : -span - 1]) / span
    change, took_s = change[: len(mean)], took_s[: len(mean)]
    sound = (np.abs(change) < half) & (took_s > 0) & (took_s < 4 * SPAN_S)
    if sound.sum() < 10:
        return None
    turned, said = change[sound] / took_s[sound], mean[sound]
    size = float(np.sqrt((turned**2).sum() * (said**2).sum()))
    if size == 0.0:
        return None
    alike = float((turned * said).sum()) / size
    return float(np.sqrt((turned**2).sum() / (said**2).sum())), alike


def nearest(measured: float, sizes: Mapping[str, float]) -> tuple[str, float]:
    """The unit whose size is nearest, and how many times the measure is off it."""
    off = {unit: abs(float(np.log(measured / size))) for unit, size in sizes.items()}
    unit = min(off, key=lambda one: off[one])
    return unit, float(np.exp(off[unit]))


def points_down(z: Array) -> bool:
    """Whether an accelerometer's z reads gravity the other way round."""
    known = z[np.isfinite(z)]
    return len(known) > 0 and float(np.median(known)) < -0.5 * float(np.abs(known).mean()) < 0


def _time(values: Array) -> tuple[str, str]:
    steps = np.diff(values[np.isfinite(values)])
    steps = steps[steps > 0]
    if not len(steps):
        return "s", "usual; it does not go on"
    step = float(np.median(steps))
    rates = {unit: 1.0 / (step * size) for unit, size in _TIMES.items()}
    unit = min(rates, key=lambda one: abs(np.log(rates[one] / USUAL_HZ)))
    return unit, f"a row every {step:.6g}: {rates[unit]:.4g} Hz"


def _gyro(values: Array, most: float) -> tuple[str, str]:
    usual = float(np.percentile(np.abs(values), 99))
    if most > 5000:
        return "counts", f"to {most:.0f}: too fast for deg/s"
    if most > GYRO_RAD_S:
        return "deg/s", f"to {most:.3g}: too fast for rad/s"
    if usual < 10:
        return "rad/s", f"to {most:.3g}: hardly moving in deg/s"
    return "deg/s", f"to {most:.3g}; may be rad/s"


def _force(values: Array) -> tuple[str, str]:
    """By the length of the vector, or what its longest part is."""
    length = np.linalg.norm(values, axis=1)
    length = length[np.isfinite(length)]
    if not len(length):
        return "m/s^2", "usual; it has no numbers"
    mean = float(np.median(length))
    if mean < 1e-9:
        return "m/s^2", "usual; it reads nothing"
    sizes = {"m/s^2": STANDARD_GRAVITY, "g": 1.0, "counts": 4096.0, "g/2048": 2048.0}
    unit, times = nearest(mean, sizes)
    if times > 1.6:
        return unit, f"mean {mean:.3g}; not sure"
    return unit, f"mean {mean:.4g}: gravity in {unit}"


def _duty(values: Array, most: float) -> tuple[str, str]:
    least = float(values.min())
    for limit, unit, why in _DUTY:
        if most <= limit:
            return unit, why
    if least >= 900 and most <= 2200:
        return "pwm-us", f"{least:.0f} to {most:.0f}: pulses in us"
    if least in (0.0, 48.0) and 1000 < most <= 2047:
        return "dshot", f"{least:.0f} to {most:.0f}"
    if most <= 4096:
        return "12-bit", f"to {most:.0f}, below 4096"
    return "16-bit", f"to {most:.0f}, below 65536"
