"""Vehicle profiles: what is known about a craft before anything is identified.

Built in are ``crazyflie1`` (the thesis's craft, plus configuration, with the add-on radio),
``crazyflie21``, ``crazyflie21plus``, ``crazyflie21upgrade`` and ``brushless``; any other craft is a
TOML file with the same keys, or with ``base`` and the keys in which it differs from that built-in
profile.
"""

from __future__ import annotations

import math
import warnings
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from groundstation.documents import decode_toml, explained, read_document
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import Array

BRUSHLESS_OHM = 1.0
"""Windings of brushless motors are below it, those of brushed ones above."""


class MotorConstants(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The identified motor dn/dt = a0 u - a1 n - a2 n^2 (thesis eq. 3.82).

    u in mV, n in rev/s; a0 in rev/s^2 per mV, a1 in 1/s, a2 in 1/rev.
    """

    a0: float
    a1: float
    a2: float

    def steady_rev_s(self, armature_mv: float) -> float:
        """Rotor speed (rev/s) at which a constant armature voltage (mV) settles."""
        if self.a2 == 0:
            return self.a0 * armature_mv / self.a1
        root = math.sqrt(self.a1**2 + 4 * self.a2 * self.a0 * max(armature_mv, 0.0))
        return (root - self.a1) / (2 * self.a2)

    def armature_mv(self, rotor_rev_s: float) -> float:
        """Armature voltage (mV) that holds a rotor speed (rev/s)."""
        return (self.a1 * rotor_rev_s + self.a2 * rotor_rev_s**2) / self.a0


Motors = tuple[MotorConstants, MotorConstants, MotorConstants, MotorConstants]
"""The motors of rotors M1..M4."""


def mean_motor(motors: Motors) -> MotorConstants:
    """The mean of each constant."""
    a0, a1, a2 = (sum(getattr(one, name) for one in motors) / 4 for name in ("a0", "a1", "a2"))
    return MotorConstants(a0, a1, a2)


def moved_motors(motors: Motors, mean: MotorConstants) -> Motors:
    """Motors whose mean becomes ``mean``, in unchanged proportion to each other.

    A constant whose mean was zero (a2 of first-order motors) is shifted instead.
    """
    old = mean_motor(motors)

    def moved(one: float, of: float, to: float) -> float:
        return one * to / of if of else one + to

    m1, m2, m3, m4 = (
        MotorConstants(
            moved(one.a0, old.a0, mean.a0),
            moved(one.a1, old.a1, mean.a1),
            moved(one.a2, old.a2, mean.a2),
        )
        for one in motors
    )
    return m1, m2, m3, m4


class BatteryConstants(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One lithium-polymer cell.

    internal_ohm: between the open-circuit voltage and the terminals, where it is measured.
    supply_ohm: between the terminals and the motors (wires, contacts, ground plane).
    back_emf_share: true back-EMF constant over its upper bound a1/a0 (a1 holds friction too);
        sets how much current the motors really draw.
    electronics_a: drawn by everything that is not a motor.
    """

    capacity_mah: float
    internal_ohm: float
    supply_ohm: float
    back_emf_share: float
    electronics_a: float


class Vehicle(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A craft, SI units; rotor speed in rev/s, armature voltage in mV.

    configuration: ``plus`` (M1 front, M2 right, M3 rear, M4 left) or ``x`` (M1 front right,
        M2 rear right, M3 rear left, M4 front left). M1 and M3 turn counter-clockwise.
    arm_m: rotor axis to the centre.
    inertia_kg_m2: principal moments about x, y, z.
    thrust_n: thrust of one rotor in N per (rev/s)^2.
    drag_n_m: drag torque of one rotor in N m per (rev/s)^2.
    rotor_inertia_kg_m2: motor shaft and propeller about the shaft.
    winding_ohm: armature resistance.
    gyro_filter_hz, accelerometer_filter_hz: corner of the on-board second-order low-pass
        (Butterworth, run at 1 kHz) that readings have passed before they are logged; 0: none.
    firmware: whose loops fly it: the Crazyflie 1.0's of 2014, or today's.
    gains: parameters of the on-board controller that differ from stock, by full name.
    """

    name: str
    configuration: Literal["plus", "x"] = "plus"
    mass_kg: float
    arm_m: float
    inertia_kg_m2: tuple[float, float, float]
    motor: MotorConstants
    thrust_n: float
    drag_n_m: float
    rotor_inertia_kg_m2: float
    winding_ohm: float = 2.3
    gyro_filter_hz: float = 0.0
    accelerometer_filter_hz: float = 0.0
    battery: BatteryConstants
    firmware: Literal["2014", "2.x"] = "2014"
    gains: dict[str, float] = {}

    @property
    def is_brushless(self) -> bool:
        """Whether its motors are, by their windings."""
        return self.winding_ohm < BRUSHLESS_OHM

    @property
    def thrust_per_mass(self) -> float:
        """(m/s^2) per (rev/s)^2 of one rotor."""
        return self.thrust_n / self.mass_kg

    @property
    def body_constants(self) -> tuple[float, float, float]:
        """c0, c1, c2 of thesis eq. 7.12-7.14 in (rad/s^2) per (rev/s)^2."""
        ixx, iyy, izz = self.inertia_kg_m2
        lever = lever_arm_m(self)
        return self.thrust_n * lever / ixx, self.thrust_n * lever / iyy, self.drag_n_m / izz


def lever_arm_m(vehicle: Vehicle) -> float:
    """Distance of a rotor from the roll (and pitch) axis: the arm, or arm/sqrt(2) in X."""
    return vehicle.arm_m if vehicle.configuration == "plus" else vehicle.arm_m / math.sqrt(2)


def rotor_positions_m(vehicle: Vehicle) -> tuple[tuple[float, float], ...]:
    """(x forward, y left) of rotors M1..M4 in the body frame."""
    lever = lever_arm_m(vehicle)
    if vehicle.configuration == "plus":
        return (lever, 0.0), (0.0, -lever), (-lever, 0.0), (0.0, lever)
    return (lever, -lever), (-lever, -lever), (-lever, lever), (lever, lever)


INERTIA_TOLERANCE = 0.05
"""Measured moments miss the triangle inequality by their errors; the values most often copied for
the Crazyflie 2.x (1.43e-5, 1.43e-5, 2.89e-5) by 1 %."""


def load_vehicle(source: str | Path) -> Vehicle:
    """A built-in profile by name, or a TOML file by path.

    Warns of moments of inertia that no body has by a few per cent.

    Raises BadInputError, naming the built-in profiles or the key that is wrong.
    """
    if str(source) in BUILT_IN:
        return BUILT_IN[str(source)]
    path = Path(source)
    if not path.is_file():
        raise BadInputError(
            f"vehicle profile {str(source)!r}: neither built in ({', '.join(BUILT_IN)}) nor a file;"
            " give one of these names or the path of a TOML profile"
        )
    try:
        given = decode_toml(read_document(path), dict[str, Any])
        base = given.pop("base", None)
        if base is not None:
            given = _based(base, given, path)
        vehicle = msgspec.convert(given, Vehicle)
    except (ValueError, OSError) as error:
        what = explained(error, Vehicle) if isinstance(error, msgspec.ValidationError) else error
        raise BadInputError(f"vehicle profile {path}: {what}; correct the file") from error
    require_physical(vehicle, f"vehicle profile {path}")
    return vehicle


def _based(base: object, given: dict[str, Any], path: Path) -> dict[str, Any]:
    """The built-in profile's keys with those of the file in their place."""
    if not isinstance(base, str) or base not in BUILT_IN:
        raise BadInputError(
            f"vehicle profile {path}: base is {base!r}; choose one of {', '.join(BUILT_IN)}"
        )
    if "name" not in given:
        raise BadInputError(f"vehicle profile {path}: needs a name of its own beside its base")
    return {**msgspec.to_builtins(BUILT_IN[base]), **given}


POSITIVE = (
    *("mass_kg", "arm_m", "inertia_kg_m2", "motor.a0", "motor.a1", "thrust_n", "drag_n_m"),
    *("winding_ohm", "battery.capacity_mah", "battery.back_emf_share"),
)
NOT_NEGATIVE = (
    *("rotor_inertia_kg_m2", "battery.internal_ohm", "battery.supply_ohm"),
    *("battery.electronics_a", "gyro_filter_hz", "accelerometer_filter_hz"),
)


def require_physical(vehicle: Vehicle, where: str) -> None:
    """Raise BadInputError, beginning with ``where``, for a craft that cannot exist."""
    for keys, allowed, must in (
        (POSITIVE, lambda value: value > 0, "be positive"),
        (NOT_NEGATIVE, lambda value: value >= 0, "not be negative"),
    ):
        for key in keys:
            value = attrgetter(key)(vehicle)
            value = min(value) if isinstance(value, tuple) else value
            if not (math.isfinite(value) and allowed(value)):
                raise BadInputError(f"{where}: {key} is {value}, must {must}")
    for key, value in {"motor.a2": vehicle.motor.a2, **vehicle.gains}.items():
        if not math.isfinite(value):
            raise BadInputError(f"{where}: {key} is {value}, must be finite")
    ixx, iyy, izz = vehicle.inertia_kg_m2
    largest = max(ixx, iyy, izz)
    excess = largest / (ixx + iyy + izz - largest) - 1.0
    if excess > 0.0:
        said = (
            f"{where}: inertia_kg_m2 {ixx}, {iyy}, {izz} is not that of a body"
            f" (the largest exceeds the sum of the others by {excess:.1%})"
        )
        if excess > INERTIA_TOLERANCE:
            raise BadInputError(f"{said}; correct it")
        warnings.warn(f"{said}; taken as it stands", stacklevel=2)


THESIS_MOTOR = MotorConstants(a0=0.862446, a1=6.814507, a2=0.006149)
"""Thesis eq. 7.10, with u in mV and n in rev/s."""

BUILT_IN: dict[str, Vehicle] = {
    # Mass with the add-on radio (thesis chapter 5); inertia is a geometric estimate; thrust from
    # the thesis's Figure 5.7: 1.14 g of specific force at the rotor speeds that its PWM, battery
    # and (7.10) give; drag so that c2 is the identified 0.0005. Battery resistances and
    # back-EMF share are tuned: about 7 minutes of hover on 170 mAh.
    "crazyflie1": Vehicle(
        name="crazyflie1",
        mass_kg=0.023,
        arm_m=0.045,
        inertia_kg_m2=(1.0e-5, 1.0e-5, 1.9e-5),
        motor=THESIS_MOTOR,
        thrust_n=9.66e-7,
        drag_n_m=9.5e-9,
        rotor_inertia_kg_m2=4.0e-8,
        battery=BatteryConstants(
            capacity_mah=170,
            internal_ohm=0.20,
            supply_ohm=0.08,
            back_emf_share=0.62,
            electronics_a=0.12,
        ),
    ),
    # Mass of the craft as sold; arm and inertia of the public identification of the 2.x. Motor and
    # thrust: rotor speeds measured in flight at 35 g (330 rev/s at 2.56 V, settling in 75 ms);
    # the firmware's thrust curve agrees (0.085 N at 2.56 V). Torque over thrust, filters: firmware.
    # Rotor inertia from yaw manoeuvres; back-EMF share so that it hovers for 7 minutes.
    "crazyflie21": Vehicle(
        name="crazyflie21",
        configuration="x",
        mass_kg=0.027,
        arm_m=0.046,
        inertia_kg_m2=(1.66e-5, 1.66e-5, 2.93e-5),
        motor=MotorConstants(a0=1.43, a1=8.8, a2=0.0070),
        thrust_n=7.9e-7,
        drag_n_m=5.8e-9,
        rotor_inertia_kg_m2=5.0e-8,
        gyro_filter_hz=80.0,
        accelerometer_filter_hz=30.0,
        firmware="2.x",
        battery=BatteryConstants(
            capacity_mah=250,
            internal_ohm=0.15,
            supply_ohm=0.06,
            back_emf_share=0.25,
            electronics_a=0.12,
        ),
    ),
}
BUILT_IN["crazyflie21plus"] = msgspec.structs.replace(
    # The same airframe; mass, thrust (0.071 N at 2.40 V) and torque over thrust of the firmware.
    BUILT_IN["crazyflie21"],
    name="crazyflie21plus",
    mass_kg=0.029,
    motor=MotorConstants(a0=1.36, a1=8.8, a2=0.0070),
    drag_n_m=5.5e-9,
)
BUILT_IN["crazyflie21upgrade"] = msgspec.structs.replace(
    # The thrust upgrade kit on a 2.1: mass, thrust (0.080 N at 1.86 V), torque over thrust of the
    # firmware. No rotor speed is published: thrust per speed squared goes with the fourth power of
    # the propeller's diameter (51 mm for 46 mm), the rotor's inertia with the third.
    BUILT_IN["crazyflie21"],
    name="crazyflie21upgrade",
    mass_kg=0.0325,
    motor=MotorConstants(a0=1.362, a1=8.8, a2=0.0040),
    thrust_n=1.19e-6,
    drag_n_m=6.1e-9,
    rotor_inertia_kg_m2=6.8e-8,
)
BUILT_IN["brushless"] = msgspec.structs.replace(
    # Mass, arm, torque over thrust and filters of the firmware; motor and thrust from rotor speeds
    # measured in flight (250 rev/s at 1.54 V, settling in 45 ms; 0.091 N each). Inertia is a
    # geometric estimate, the winding what its hover current of 5 A needs.
    BUILT_IN["crazyflie21"],
    name="brushless",
    mass_kg=0.0393,
    arm_m=0.050,
    inertia_kg_m2=(1.8e-5, 1.95e-5, 3.4e-5),
    motor=MotorConstants(a0=3.25, a1=17.5, a2=0.0097),
    thrust_n=1.46e-6,
    drag_n_m=8.3e-9,
    rotor_inertia_kg_m2=4.5e-8,
    winding_ohm=0.3,
    battery=BatteryConstants(
        capacity_mah=350,
        internal_ohm=0.08,
        supply_ohm=0.03,
        back_emf_share=0.5,
        electronics_a=0.12,
    ),
)


# From rotors to torques (thesis 3.8-3.9, 7.19), and what PWM counts are of (8.2).
#
# Rotors are numbered as in the vehicle profile; M1 and M3 turn counter-clockwise seen from above.
# In the X configuration each rotor acts on roll and pitch with the lever arm / sqrt(2), which the
# profile's body constants contain.


Configuration = Literal["plus", "x"]

PWM_FULL = 4096.0
"""PWM counts of 100 % duty (thesis 8.2.5)."""

MIXERS: dict[str, Array] = {
    "plus": np.array([[0, -1, 0, 1], [-1, 0, 1, 0], [-1, 1, -1, 1]], np.float64),
    "x": np.array([[-1, -1, 1, 1], [-1, 1, 1, -1], [-1, 1, -1, 1]], np.float64),
}
"""Rows u'1, u'2, u'3 over squared rotor speeds: thesis eq. 7.19, and the same for X."""
