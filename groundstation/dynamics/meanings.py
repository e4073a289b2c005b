"""What the numbers of a model mean, in words, and their units: for reports and pages."""

from __future__ import annotations

from groundstation.dynamics.model import ArxAxis
from groundstation.dynamics.registry import EFFECTS

_CONSTANTS = {
    "a0": ("rev/s² per mV", "speeding up of a motor by its voltage"),
    "a1": ("1/s", "slowing down of a motor with its speed"),
    "a2": ("1/rev", "slowing down with the square of the speed: air"),
    "c0": ("rad/s² per (rev/s)²", "roll acceleration by the rotors"),
    "c1": ("rad/s² per (rev/s)²", "pitch acceleration by the rotors"),
    "c2": ("rad/s² per (rev/s)²", "yaw acceleration by the rotors"),
    "thrust_per_mass": ("m/s² per (rev/s)²", "lift by the rotors, on each kilogram"),
    "delay_s": ("s", "from the recorded input to where it acts"),
    "sensor_lag_s": ("s", "time constant of the speed sensor"),
}


def meaning_of(name: str) -> tuple[str, str]:
    """(unit, meaning) of a constant or of ``effect.parameter``; empty where nobody listed it."""
    effect, _, key = name.rpartition(".")
    if effect not in EFFECTS:
        return _CONSTANTS.get(key, ("", ""))
    for one in EFFECTS[effect].parameters:
        if key == one.name:
            return one.unit, EFFECTS[effect].adds
        if one.unknown is not None and key == one.unknown.name:
            return one.unknown.unit, EFFECTS[effect].adds
    return "", EFFECTS[effect].adds


def arx_meaning(name: str, axis: ArxAxis, *, rates: bool) -> tuple[str, str]:
    """(unit, meaning) of a coefficient ``a1``... or ``b1``... of one axis's polynomials.

    rates: they give a body rate (``arx.of_rates``) and not an angle.
    """
    output, unit = ("rate", "rad/s") if rates else ("angle", "rad")
    order = int(name[1:])
    if name[0] == "a":
        return "1", f"{output} {1e3 * axis.ts * order:g} ms before, taken off"
    before_s = axis.ts * (axis.nk + order - 1)
    return f"{unit} per (rev/s)²", f"{output} by u' {1e3 * before_s:g} ms before"
