"""What the numbers of a model mean, in words, and their units: for reports and pages."""

from __future__ import annotations

from collections.abc import Mapping

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

_PHYSICS = {
    # name: (what people call it, what its size does; keys are parameters)
    "accelerometer_bias": ("accelerometer offset", "the accelerometer is off by a constant"),
    "accelerometer_filter": ("accelerometer filter", "the accelerometer comes filtered"),
    "attitude_filter_lean": (
        "tilt leaning with acceleration",
        "the reported tilt gives way to sideways acceleration, {strength:.2g} of what the"
        " firmware's filter does",
    ),
    "battery_reading_lag": (
        "late battery reading",
        "the reported voltage comes {time_constant_s:.2g} s after the real one",
    ),
    "centre_of_gravity_offset": (
        "centre of gravity off the middle",
        "thrust turns the craft, for it does not act at the centre of gravity",
    ),
    "climb_inflow": (
        "thrust lost in climbing",
        "each m/s of climb takes {loss_g_per_m_s:.2g} g of thrust",
    ),
    "dead_time": ("dead time", "everything measured comes {delay_ms:.3g} ms late"),
    "ground_effect": (
        "ground effect",
        "near the ground there is up to {gain_percent:.2g} % more thrust, gone {height_m:.2g} m up",
    ),
    "gyro_bias": ("gyro offset", "the gyro is off by a constant"),
    "gyro_filter": ("gyro filter", "the gyro comes filtered"),
    "gyro_low_pass": (
        "slow gyro",
        "the gyro shows motion above {bandwidth_hz:.3g} Hz late and too small",
    ),
    "imu_lever_arm": (
        "sensor off the centre",
        "the accelerometer does not sit at the centre of gravity: turning shows as acceleration",
    ),
    "imu_misalignment": ("sensor turned", "the sensor sits turned on the craft"),
    "inertia_coupling": (
        "unequal inertias",
        "two rates at once turn the craft about the third axis, {fraction:.2g} of their product",
    ),
    "mass_change": ("other mass", "the weight is off by {percent:+.2g} %"),
    "motor_braking_asymmetry": (
        "slow braking motors",
        "motors slow down {factor:.2g} times as fast as they speed up",
    ),
    "motor_coasting": (
        "coasting motors",
        "{share_percent:.2g} % of a motor's braking is missing: it coasts, and air slows it down",
    ),
    "motor_dead_voltage": (
        "motor dead voltage",
        "the first {voltage_mv:.3g} mV turn no motor",
    ),
    "position_aided_lean": (
        "tilt leaning, aided by position",
        "the reported tilt leans into forces that the position estimate does not expect",
    ),
    "propeller_imbalance": ("propeller out of balance", "rotor {rotor:.0f} shakes the craft"),
    "quadratic_rate_damping": (
        "air resistance to fast turning",
        "turning is braked with the square of the rate",
    ),
    "rate_damping": ("damping of roll and pitch", "turning is braked in proportion to the rate"),
    "rotor_acceleration_torque": (
        "torque of accelerating rotors",
        "rotors that speed up turn the craft the other way about yaw",
    ),
    "rotor_drag": (
        "drag of the rotors",
        "the craft is braked by {drag_mn_s_m:.2g} mN for each m/s that it moves",
    ),
    "rotor_gyroscopic_torque": (
        "gyroscopic rotors",
        "turning in roll turns the craft in pitch, and back, while the rotors differ",
    ),
    "rotor_mismatch": (
        "one rotor differs",
        "thrust and drag of rotor {rotor:.0f} are off by {excess_percent:+.2g} %",
    ),
    "rotor_speed_sensor": (
        "late rotor speeds",
        "recorded rotor speeds come {lag_ms:.3g} ms after the true ones",
    ),
    "slung_load": (
        "swinging load",
        "{percent:.2g} % of the craft's weight swings on a line of {length_m:.2g} m",
    ),
    "supply_sag": (
        "supply sag",
        "each ampere of the motors takes {resistance_mohm:.3g} mV from all of them",
    ),
    "velocity_moment": (
        "tipping moment of blade flapping",
        "the craft is tipped back by {moment:.3g} rad/s² for each m/s that it moves",
    ),
    "wind": ("slow air", "moments and forces that drift, of no known cause"),
    "yaw_damping": ("damping of yaw", "a yaw turn is braked in proportion to its rate"),
}
_SHOWN_IN = (
    ("", "_percent", 100.0),
    ("_s", "_ms", 1e3),
    ("_n_s_m", "_mn_s_m", 1e3),
    ("_ohm", "_mohm", 1e3),
)
"""Ending of a parameter in SI, of the same as it is shown, and how many of that make one."""


def title_of(effect: str) -> str:
    """What people call an effect; of one's own effects the name, with spaces."""
    return _PHYSICS[effect][0] if effect in _PHYSICS else effect.replace("_", " ")


def physics_of(effect: str, values: Mapping[str, float]) -> str:
    """What an effect of these parameters does to the craft; empty for one's own effects."""
    if effect not in _PHYSICS:
        return ""
    shown = dict(values)
    for si, ending, scale in _SHOWN_IN:
        shown |= {
            name.removesuffix(si) + ending: scale * value
            for name, value in values.items()
            if name.endswith(si)
        }
    return _PHYSICS[effect][1].format_map(shown)


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
