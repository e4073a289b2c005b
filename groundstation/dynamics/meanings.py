"""What a model's numbers mean in words, and what the model is good for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from groundstation.dynamics.model import ArxAxis, Model, model_vehicle
from groundstation.dynamics.registry import DELAY, EFFECTS
from groundstation.dynamics.vehicle import Vehicle
from groundstation.telemetry.arrays import AXES
from groundstation.text import listed

# What the numbers of a model mean, in words, and their units: for reports and pages.


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

    rates: they give a body rate (``model.of_rates``) and not an angle.
    """
    output, unit = ("rate", "rad/s") if rates else ("angle", "rad")
    order = int(name[1:])
    if name[0] == "a":
        return "1", f"{output} {1e3 * axis.ts * order:g} ms before, taken off"
    before_s = axis.ts * (axis.nk + order - 1)
    return f"{unit} per (rev/s)²", f"{output} by u' {1e3 * before_s:g} ms before"


# What a fitted model is good for: the one judgement that fits, reports and designs ask.
#
# It uses all that a model file says of its fit: standard errors, what was not identified, held-out
# predictions, inputs that show in the residuals, delay, and the distance from the profile's
# constants. An axis is as good as the worst of these says.


CONSTANT = dict(zip(AXES, ("c0", "c1", "c2"), strict=True))
DESIGN, MOST_STDERR = 0.1, 0.15
"""Standard errors over the value: up to which a constant bears a design as it is, and beyond which
no gains are given. Twice that, either way, is a loop gain that one design cannot serve at full
performance."""
MOST_DELAY_S = 0.002
"""Delay that a design bears beside the model's: the most for a standard error of it, and for a
delay that a fit found and left out."""
UNUSUAL = 2.5
"""Times the profile's value, or one over it, that is worth a word: measured constants of one type
of craft lie within a half of each other."""
DEAD_TIME = DELAY.partition(".")[0]
POOR = "poor"
"""``quality`` of a body in a model file that predicts unseen data worse than their mean, by far."""
FOUND = ("effects_found", "found_in_part")
"""Verdicts of a search whose model is better than the one that it was given."""


class Use(IntEnum):
    """What an axis of a model is good for, the least first."""

    NOTHING = 0
    """It was not identified: the file has the profile's value."""
    SEARCH = 1
    """It predicts unseen data worse than their mean: a search for what is missing begins with it,
    and nothing else does."""
    SIMULATION = 2
    """A rough simulation: no gains are designed on it."""
    FIRST_DESIGN = 3
    """A first, cautious design: its gains are to be tried with care."""
    DESIGN = 4
    """A design as it is."""


WORDS = {
    Use.DESIGN: "good enough to design with",
    Use.FIRST_DESIGN: "for a first, cautious design",
    Use.SIMULATION: "for a rough simulation only",
    Use.SEARCH: "only to search for what is missing",
    Use.NOTHING: "not identified",
}


SEARCHED = {
    "effects_found": Use.FIRST_DESIGN,
    "found_in_part": Use.SIMULATION,
    "no_discrepancy": Use.SIMULATION,
}
"""What a poor body is good for behind a search, by its verdict: errors beyond noise bear no design.
"""


@dataclass(frozen=True, slots=True)
class Suitability:
    """use: of one axis. reasons: why it is no better, in words, the gravest first. key: of the
    estimate that the first of them is about. share: standard error over value of the axis's
    constant, None where that is not known."""

    use: Use
    reasons: tuple[str, ...]
    key: str
    share: float | None

    @property
    def designs(self) -> bool:
        """Whether gains are designed on it."""
        return self.use >= Use.FIRST_DESIGN


def suitability(model: Model) -> dict[str, Suitability]:
    """Axis -> what the model is good for there. Empty where no fit of the body is in the file: then
    nothing is known of its errors."""
    account = model.fit.get("body", {})
    if not account.get("estimates"):
        return {}
    vehicle, known = model_vehicle(model), _known(account)
    found = {}
    for axis in AXES:
        name = CONSTANT[axis]
        tied = "c0" if name == "c1" and name not in known else name
        share = _share(*known[tied]) if tied in known else None
        said = [
            *((*one, name) for one in _of_the_axis(model, account, vehicle, axis, share)),
            *((*one, DELAY) for one in _of_the_delay(model, account)),
        ]
        said.sort(key=lambda one: one[0])  # stable: of one use the first that was said
        use, key = (said[0][0], said[0][2]) if said else (Use.DESIGN, name)
        found[axis] = Suitability(use, tuple(words for _, words, _ in said), key, share)
    return found


def verdict(found: Mapping[str, Suitability]) -> str:
    """The axes by what they are good for, each with its gravest reason, in one sentence."""
    parts = []
    if best := [axis for axis, one in found.items() if one.use == Use.DESIGN]:
        parts.append(f"good enough to design {listed(best)} with")
    for use in (Use.FIRST_DESIGN, Use.SIMULATION, Use.SEARCH, Use.NOTHING):
        by_reason: dict[str, list[str]] = {}
        for axis, one in found.items():
            if one.use == use:
                by_reason.setdefault(one.reasons[0], []).append(axis)
        parts += [f"{listed(axes)}: {WORDS[use]} ({why})" for why, axes in by_reason.items()]
    words = "; ".join(parts)
    return words[:1].upper() + words[1:]


def profile_constants(vehicle: Vehicle) -> dict[str, float]:
    """What a profile says of each constant that a fit finds."""
    motor = vehicle.motor
    return {
        **dict(zip(CONSTANT.values(), vehicle.body_constants, strict=True)),
        "thrust_per_mass": vehicle.thrust_per_mass,
        **{"a0": motor.a0, "a1": motor.a1, "a2": motor.a2},
    }


def is_unusual(value: float, usual: float, times: float = UNUSUAL) -> bool:
    """Whether a constant lies beyond so many times the profile's."""
    return not 1 / times < value / usual < times


def _known(account: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Name -> value and standard error, by the covariance where there is one: designs use it."""
    found = account["estimates"]
    errors = [float(error) for error in found["stderr"]]
    for place, row in enumerate(found.get("covariance", ())):
        errors[place] = math.sqrt(max(row[place], 0.0)) if row[place] is not None else math.inf
    columns = zip(found["names"], found["values"], errors, strict=True)
    return {str(name): (float(value), error) for name, value, error in columns}


def _share(value: float, error: float) -> float:
    return error / abs(value) if value else math.inf


def _of_the_axis(
    model: Model, account: Mapping[str, Any], vehicle: Vehicle, axis: str, share: float | None
) -> Iterator[tuple[Use, str]]:
    """Why an axis is no better than this use."""
    name = CONSTANT[axis]
    if name in account.get("not_identified", {}):
        yield Use.NOTHING, f"the file has the profile's {name}"
        return
    if share is not None and not share <= DESIGN:
        use = Use.FIRST_DESIGN if share <= MOST_STDERR else Use.SIMULATION
        yield use, f"known to {100 * share:.0f} % only"
    search = model.fit.get("discrepancy", {})
    poor = account.get("quality") == POOR
    if poor:
        use = SEARCHED.get(search.get("verdict", ""), Use.SEARCH)
        since = ", before a search found what it lacks" if use > Use.SEARCH else ""
        yield use, f"its fit predicts unseen data far worse than their mean{since}"
    for horizon, use in (("20ms", Use.SIMULATION), ("50ms", Use.FIRST_DESIGN)):
        percent = _held_out(account, f"gyro_{axis}_fit_percent_{horizon}")
        if percent is not None and percent < 0.0 and not poor:
            far = horizon.replace("ms", " ms")
            yield use, f"unseen data are predicted worse than by their mean {far} ahead"
    percent = _held_out(account, "accelerometer_z_fit_percent")
    if percent is not None and percent < 0.0:
        yield Use.FIRST_DESIGN, "thrust on unseen data is predicted worse than by its mean"
    value = getattr(model.body, name, None)
    usual = profile_constants(vehicle)[name]
    if value is not None and usual and is_unusual(value, usual):
        yield Use.FIRST_DESIGN, f"{name} is {_times(value / usual)} the profile's"
    if axis in account.get("crossed", ()):
        yield Use.FIRST_DESIGN, "it turns with the torque of another axis as well"
    if account.get("contradictions"):
        yield Use.FIRST_DESIGN, "channels of the recordings contradict each other"
    if search.get("verdict") == "unexplained":
        yield Use.FIRST_DESIGN, "a search for what is missing left errors unexplained"
    test = account.get("residual_tests", {}).get(f"{axis} rate", {}).get("cross_correlation", {})
    if not search and not test.get("passes", True):  # a search has looked into it
        yield Use.FIRST_DESIGN, "the input still shows in its residuals"


def _of_the_delay(model: Model, account: Mapping[str, Any]) -> Iterator[tuple[Use, str]]:
    """The same of the delay, which every loop has."""
    _, error = _known(account).get(DELAY, (0.0, 0.0))
    if not error <= MOST_DELAY_S:
        yield Use.SIMULATION, f"the dead time is known to ±{1e3 * error:.1f} ms only"
    along = account.get("fitted_along", {}).get(DELAY, {}).get("value", 0.0)
    has_one = any(term.name == DEAD_TIME for term in model.effects)
    if not has_one and DEAD_TIME in account.get("left_out", ()) and along > MOST_DELAY_S:
        late = f"{1e3 * along:.1f} ms"
        yield Use.FIRST_DESIGN, f"the model has no dead time and the data show {late}"


def _held_out(account: Mapping[str, Any], name: str) -> float | None:
    held = account.get("validation")
    value = held.get(name) if isinstance(held, Mapping) else None
    return None if value is None else float(value)


def _times(ratio: float) -> str:
    return f"{ratio:.2g} times" if ratio > 1.0 else f"1/{1 / ratio:.2g} of"
