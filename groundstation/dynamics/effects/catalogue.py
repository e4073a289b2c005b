"""The named effects: parameters, limits, signs by which they are known, and what hides them.

Names and parameters are those of the stand-in (``docs/stand_in.md``), so a model file with
effects flies there unchanged. The forward physics is in ``dynamics/kernels.py`` (motors and
body) and ``dynamics/effects/sensors.py``. A user's own effect is an ``Effect`` with a ``law``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from groundstation.errors import BadInputError

Stage = Literal["motor", "body", "sensor"]
Channel = Literal[
    "gyro x",
    "gyro y",
    "gyro z",
    "accelerometer x",
    "accelerometer y",
    "accelerometer z",
    "roll",
    "pitch",
    "yaw",
]
Law = Callable[[Any, Any, Any, Any], None]
"""(values, state, rotor_slope, acceleration): adds to ``acceleration`` (6,): rad/s^2 about the
body axes, then m/s^2 along them. values: parameters in order. state: (17,) of
``dynamics/state.py``. rotor_slope: (4,) rev/s^2. Must be Python that numba compiles."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect.

    low, high: what is plausible on a small craft, signs included; beyond it a finding is refused.
    absent: the value at which the effect is not there. where: why the range.
    """

    name: str
    unit: str
    default: float
    low: float
    high: float
    absent: float = 0.0
    integer: bool = False


@dataclass(frozen=True, slots=True)
class Confusion:
    """Another effect that can look the same, and the manoeuvre that separates the two."""

    other: str
    manoeuvre: str


@dataclass(frozen=True, slots=True)
class Effect:
    """One physical effect.

    stage: where it enters. channels: where it shows first. adds: its law in words. signature:
    by what a person knows it. excited_by: what to fly so that it shows. law: forward physics of
    a user's own effect, None for those that the kernels know.
    """

    name: str
    stage: Stage
    parameters: tuple[Parameter, ...]
    adds: str
    signature: str
    excited_by: str
    channels: tuple[Channel, ...]
    confused_with: tuple[Confusion, ...] = ()
    law: Law | None = None

    def parameter(self, name: str) -> Parameter:
        """One of its parameters. Raises BadInputError, naming those there are."""
        for one in self.parameters:
            if one.name == name:
                return one
        names = ", ".join(p.name for p in self.parameters)
        raise BadInputError(f"effect {self.name}: no parameter {name!r}; there are {names}")

    def values(self, given: Mapping[str, float]) -> dict[str, float]:
        """Every parameter: the given value, or its default.

        Raises BadInputError for a parameter that does not exist or a value that is not finite.
        """
        for name in given:
            self.parameter(name)
        values = {p.name: float(given.get(p.name, p.default)) for p in self.parameters}
        for name, value in values.items():
            if not math.isfinite(value):
                raise BadInputError(f"effect {self.name}: {name} is {value}, must be finite")
        return values

    def absent(self, given: Mapping[str, float]) -> bool:
        """Whether these values amount to no effect at all."""
        values = self.values(given)
        sizes = [p for p in self.parameters if not p.integer]
        if self.name == "ground_effect":
            return values["gain"] == 0.0
        return all(values[p.name] == p.absent for p in sizes)

    def plausible(self, given: Mapping[str, float]) -> bool:
        """Whether every value lies in its range, or is the one that means absent."""
        values = self.values(given)
        return all(
            p.low <= values[p.name] <= p.high or values[p.name] == p.absent for p in self.parameters
        )


GYRO: tuple[Channel, ...] = ("gyro x", "gyro y", "gyro z")
TILT_RATES: tuple[Channel, ...] = ("gyro x", "gyro y")
FORCE: tuple[Channel, ...] = ("accelerometer x", "accelerometer y", "accelerometer z")
ANGLES: tuple[Channel, ...] = ("roll", "pitch", "yaw")

_ROTOR_INERTIA = (Parameter("rotor_inertia_kg_m2", "kg m^2", 5e-8, 1e-9, 4e-7),)
_THRUST_STEPS = (
    "steps of collective thrust over 60..140 % of hover, once with a full and once with an"
    " empty battery, and the motor bench"
)
_DOUBLETS = "fast roll and pitch doublets with attitude in the recording"
_HOVER_DOUBLETS = "fast roll and pitch doublets on the spot, too short to gain speed"
_TRANSLATE = "steady flight to and fro along both axes at 1..2 m/s, then hover"
_YAW_STEPS = "yaw steps both ways, then a steady turn at 3 rad/s"
_CLIMBS = "climbs and descents at several steady speeds, well above the ground"

LISTED: tuple[Effect, ...] = (
    Effect(
        "dead_time",
        "sensor",
        (Parameter("delay_s", "s", 0.004, 5e-5, 0.04),),
        "all measured outputs show the past by a pure delay",
        "rates, attitude and specific force all answer the motors late by the same time",
        _DOUBLETS,
        (*GYRO, *FORCE, *ANGLES),
        (
            Confusion("gyro_low_pass", f"{_DOUBLETS}: a low-pass lags the gyro alone"),
            Confusion("motor_braking_asymmetry", "thrust steps up and down: a delay is the same"),
        ),
    ),
    Effect(
        "gyro_low_pass",
        "sensor",
        (Parameter("bandwidth_hz", "Hz", 30.0, 4.0, 400.0),),
        "the gyro lags the true rate, first order; 0 Hz means no lag",
        "the gyro comes after the attitude that is its integral; fast motion is attenuated",
        _DOUBLETS,
        GYRO,
        (Confusion("dead_time", f"{_DOUBLETS}: a delay moves the attitude as well"),),
    ),
    Effect(
        "rotor_gyroscopic_torque",
        "body",
        _ROTOR_INERTIA,
        "+I_r q w on roll and -I_r p w on pitch, w = -n1 + n2 - n3 + n4 in rad/s",
        "roll and pitch couple while the craft is commanded to yaw, and not otherwise",
        "roll and pitch doublets while yaw commands hold the rotors' speeds apart",
        TILT_RATES,
        (
            Confusion(
                "inertia_coupling",
                "roll and pitch doublets during a yaw step (rotors apart, no yaw rate yet) and"
                " during a steady turn (yaw rate, rotors together)",
            ),
        ),
    ),
    Effect(
        "inertia_coupling",
        "body",
        (Parameter("fraction", "", 1.0, 0.1, 2.0),),
        "(Iyy-Izz) q r on roll, (Izz-Ixx) p r on pitch, (Ixx-Iyy) p q on yaw",
        "roll and pitch couple in proportion to the yaw rate",
        "roll and pitch doublets during a steady fast turn",
        GYRO,
        (
            Confusion(
                "rotor_gyroscopic_torque",
                "roll and pitch doublets during a steady turn: the rotors are then together",
            ),
            Confusion("imu_misalignment", "roll and pitch doublets without any yaw rate"),
        ),
    ),
    Effect(
        "rotor_acceleration_torque",
        "body",
        _ROTOR_INERTIA,
        "+I_r dw/dt on yaw",
        "yaw kicks at once when motors change speed, before drag has built up",
        "sharp yaw steps; roll doublets leave it alone",
        ("gyro z",),
        (
            Confusion("yaw_damping", _YAW_STEPS),
            Confusion("dead_time", f"{_DOUBLETS}: a delay acts on every axis"),
        ),
    ),
    Effect(
        "rate_damping",
        "body",
        (Parameter("damping_n_m_s", "N m s", 1e-5, 1e-7, 2e-4),),
        "-d p on roll, -d q on pitch",
        "angular acceleration falls short in proportion to the rate, alike on roll and pitch",
        _HOVER_DOUBLETS,
        TILT_RATES,
        (
            Confusion("quadratic_rate_damping", "doublets of several sizes, 1 to 6 rad/s"),
            Confusion("velocity_moment", f"{_HOVER_DOUBLETS}; {_TRANSLATE}"),
        ),
    ),
    Effect(
        "quadratic_rate_damping",
        "body",
        (Parameter("damping_n_m_s2", "N m s^2", 1.5e-5, 1e-7, 3e-4),),
        "-d p |p| on roll, -d q |q| on pitch",
        "angular acceleration falls short at high rates only",
        "large roll and pitch doublets, 3 rad/s and more",
        TILT_RATES,
        (Confusion("rate_damping", "doublets of several sizes, 1 to 6 rad/s"),),
    ),
    Effect(
        "centre_of_gravity_offset",
        "body",
        (
            Parameter("x_m", "m", 0.0, -0.008, 0.008),
            Parameter("y_m", "m", 0.0, -0.008, 0.008),
        ),
        "roll -y T, pitch +x T with the total thrust T; (x, y) is the centre of gravity",
        "constant roll or pitch torque that grows with thrust; the controller holds one motor up",
        "steps of collective thrust",
        TILT_RATES,
        (
            Confusion(
                "rotor_mismatch",
                "yaw and thrust steps: a weak rotor also changes yaw torque and total thrust",
            ),
        ),
    ),
    Effect(
        "rotor_mismatch",
        "body",
        (
            Parameter("rotor", "", 1.0, 1.0, 4.0, integer=True),
            Parameter("excess", "", 0.05, -0.4, 0.4),
        ),
        "thrust and drag of one rotor times 1 + excess",
        "constant torque about roll or pitch AND yaw, in the ratio that one rotor gives",
        "steps of collective thrust and of yaw",
        (*GYRO, "accelerometer z"),
        (
            Confusion(
                "centre_of_gravity_offset",
                "yaw and thrust steps: an offset changes neither yaw torque nor total thrust",
            ),
        ),
    ),
    Effect(
        "motor_dead_voltage",
        "motor",
        (Parameter("voltage_mv", "mV", 200.0, 10.0, 800.0),),
        "a motor turns with u - voltage, not less than 0",
        "thrust is too high in the model at low throttle and right at the speed it was fitted at",
        _THRUST_STEPS,
        ("accelerometer z", *TILT_RATES),
        (
            Confusion("supply_sag", _THRUST_STEPS),
            Confusion("battery_reading_lag", "thrust steps held for 2 s: a lag dies out"),
        ),
    ),
    Effect(
        "motor_braking_asymmetry",
        "motor",
        (Parameter("factor", "", 0.6, 0.1, 2.0, absent=1.0),),
        "a negative dn/dt times the factor",
        "thrust falls more slowly than it rises; torques lag on the motor that slows down",
        "fast thrust steps down and up, sharp doublets on all axes",
        ("accelerometer z", *GYRO),
        (Confusion("dead_time", "thrust steps up and down: a delay is the same both ways"),),
    ),
    Effect(
        "supply_sag",
        "motor",
        (Parameter("resistance_ohm", "ohm", 0.15, 0.003, 1.0),),
        "motors get the reported voltage less R times their summed supply current, duty"
        " (u - k_e n)/R_w each",
        "all four motors give less when any of them works hard",
        _THRUST_STEPS,
        ("accelerometer z", *TILT_RATES),
        (
            Confusion("motor_dead_voltage", _THRUST_STEPS),
            Confusion("battery_reading_lag", "thrust steps held for 2 s: a lag dies out"),
        ),
    ),
    Effect(
        "battery_reading_lag",
        "motor",
        (Parameter("time_constant_s", "s", 0.155, 0.01, 1.5),),
        "the reported voltage follows the real one, first order",
        "thrust is wrong for a moment after each thrust step, then right again",
        "fast steps of collective thrust over 60..140 % of hover",
        ("accelerometer z",),
        (
            Confusion("supply_sag", "thrust steps held for 2 s: sag stays, lag dies out"),
            Confusion("motor_braking_asymmetry", "thrust steps up and down: a lag is symmetric"),
        ),
    ),
    Effect(
        "gyro_bias",
        "sensor",
        (
            Parameter("x_dps", "deg/s", 0.0, -20.0, 20.0),
            Parameter("y_dps", "deg/s", 0.0, -20.0, 20.0),
            Parameter("z_dps", "deg/s", 0.0, -20.0, 20.0),
        ),
        "a constant added to the gyro",
        "the attitude does not turn as the gyro says: a constant rate is left over",
        "nothing special; attitude must be recorded",
        ANGLES,
        (
            Confusion(
                "attitude_filter_lean",
                "hover still for 10 s, then tilt: a bias drifts always, a lean only when tilted",
            ),
        ),
    ),
    Effect(
        "accelerometer_bias",
        "sensor",
        (
            Parameter("x_g", "g", 0.0, -0.3, 0.3),
            Parameter("y_g", "g", 0.0, -0.3, 0.3),
            Parameter("z_g", "g", 0.0, -0.3, 0.3),
        ),
        "a constant added to the accelerometer",
        "specific force is off by the same amount at any thrust and speed",
        "start and end at rest; steps of collective thrust",
        FORCE,
        (
            Confusion("imu_misalignment", "thrust steps: a tilt of the sensor grows with thrust"),
            Confusion("rotor_drag", _TRANSLATE),
        ),
    ),
    Effect(
        "imu_misalignment",
        "sensor",
        (
            Parameter("roll_deg", "deg", 0.0, -20.0, 20.0),
            Parameter("pitch_deg", "deg", 0.0, -20.0, 20.0),
            Parameter("yaw_deg", "deg", 0.0, -20.0, 20.0),
        ),
        "sensor axes turned Rz Ry Rx in the body; gyro, accelerometer and angles are the sensor's",
        "motion about one axis shows on another; thrust has a part in the sensor's plane",
        "doublets of one axis at a time, yaw steps, thrust steps",
        (*GYRO, "accelerometer x", "accelerometer y"),
        (
            Confusion("accelerometer_bias", "thrust steps: a bias stays the same"),
            Confusion("inertia_coupling", "roll and pitch doublets without any yaw rate"),
        ),
    ),
    Effect(
        "rotor_drag",
        "body",
        (Parameter("drag_n_s_m", "N s/m", 0.008, 3e-4, 0.06),),
        "in-plane force -d times the body velocity",
        "specific force in the plane against the velocity",
        _TRANSLATE,
        ("accelerometer x", "accelerometer y"),
        (
            Confusion("accelerometer_bias", _TRANSLATE),
            Confusion("imu_lever_arm", f"{_HOVER_DOUBLETS}; {_TRANSLATE}"),
        ),
    ),
    Effect(
        "velocity_moment",
        "body",
        (Parameter("moment", "rad/s^2 per m/s", 10.0, 0.2, 80.0),),
        "roll +c v, pitch -c u, (u, v) the body velocity forward and left",
        "the craft rears up against its motion: torque in proportion to speed",
        _TRANSLATE,
        TILT_RATES,
        (
            Confusion("rate_damping", f"{_HOVER_DOUBLETS}; {_TRANSLATE}"),
            Confusion("centre_of_gravity_offset", "flight to and fro: an offset keeps its sign"),
        ),
    ),
    Effect(
        "yaw_damping",
        "body",
        (Parameter("damping_n_m_s", "N m s", 4e-6, 5e-8, 1e-4),),
        "-d r on yaw",
        "a turn needs torque to be kept up, in proportion to the yaw rate",
        _YAW_STEPS,
        ("gyro z",),
        (Confusion("rotor_acceleration_torque", _YAW_STEPS),),
    ),
    Effect(
        "climb_inflow",
        "body",
        (Parameter("loss_g_per_m_s", "g per m/s", 0.03, 0.001, 0.2),),
        "-loss times the climb speed along the body's z",
        "thrust falls while climbing and grows while sinking",
        _CLIMBS,
        ("accelerometer z",),
        (
            Confusion("supply_sag", f"{_CLIMBS}; thrust steps on the spot"),
            Confusion("ground_effect", _CLIMBS),
        ),
    ),
    Effect(
        "imu_lever_arm",
        "sensor",
        (
            Parameter("x_m", "m", 0.0, -0.03, 0.03),
            Parameter("y_m", "m", 0.0, -0.03, 0.03),
            Parameter("z_m", "m", 0.0, -0.03, 0.03),
        ),
        "alpha x r + Omega x (Omega x r) in the accelerometer",
        "the accelerometer answers angular acceleration at once",
        "sharp doublets on all axes, a steady fast turn",
        FORCE,
        (Confusion("rotor_drag", f"{_HOVER_DOUBLETS}; {_TRANSLATE}"),),
    ),
    Effect(
        "ground_effect",
        "body",
        (
            # A small craft's ground effect reaches about as high as the craft is wide, and is
            # tenths of the thrust at the ground: what is weak and reaches far is something else.
            Parameter("height_m", "m", 0.08, 0.005, 0.17),
            Parameter("gain", "", 0.25, 0.10, 1.0),
        ),
        "thrust times 1 + gain exp(-z / height)",
        "thrust is too low in the model right after take-off and before landing",
        "take-off and landing inside the recording, low hover; height counts from the take-off",
        ("accelerometer z",),
        (
            Confusion("climb_inflow", _CLIMBS),
            Confusion("battery_reading_lag", "fast thrust steps high above the ground"),
        ),
    ),
    Effect(
        "attitude_filter_lean",
        "sensor",
        (Parameter("strength", "", 1.0, 0.05, 1.5),),
        "reported angles are a Mahony filter's at the firmware's gains: 1 is full, 0 the truth",
        "reported tilt creeps to level within some 2.5 s while the craft accelerates sideways",
        "long steady tilts of 10 deg and more, attitude recorded",
        ("roll", "pitch"),
        (
            Confusion(
                "gyro_bias",
                "hover still for 10 s, then tilt: a bias drifts always, a lean only when tilted",
            ),
        ),
    ),
)
"""The design's 23 effects, in its order."""

EFFECTS: Mapping[str, Effect] = {effect.name: effect for effect in LISTED}
"""The same by name."""
