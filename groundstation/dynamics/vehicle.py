"""Vehicle profiles: what is known about a craft before anything is identified.

Built in are ``crazyflie1`` (the thesis's craft, plus configuration, with the add-on radio) and
``crazyflie21``; any other craft is a TOML file with the same keys.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import msgspec

from groundstation.errors import BadInputError


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
    battery: BatteryConstants
    gains: dict[str, float] = {}

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


def load_vehicle(source: str | Path) -> Vehicle:
    """A built-in profile by name, or a TOML file by path.

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
        vehicle = msgspec.toml.decode(path.read_bytes(), type=Vehicle)
    except (msgspec.DecodeError, UnicodeDecodeError, OSError) as error:
        raise BadInputError(f"vehicle profile {path}: {error}; correct the file") from error
    require_physical(vehicle, f"vehicle profile {path}")
    return vehicle


def require_physical(vehicle: Vehicle, where: str) -> None:
    """Raise BadInputError, beginning with ``where``, for a craft that cannot exist."""
    ixx, iyy, izz = vehicle.inertia_kg_m2
    positive = {
        "mass_kg": vehicle.mass_kg,
        "arm_m": vehicle.arm_m,
        "inertia_kg_m2": min(ixx, iyy, izz),
        "motor.a0": vehicle.motor.a0,
        "motor.a1": vehicle.motor.a1,
        "thrust_n": vehicle.thrust_n,
        "drag_n_m": vehicle.drag_n_m,
        "winding_ohm": vehicle.winding_ohm,
        "battery.capacity_mah": vehicle.battery.capacity_mah,
        "battery.back_emf_share": vehicle.battery.back_emf_share,
    }
    for key, value in positive.items():
        if not (math.isfinite(value) and value > 0):
            raise BadInputError(f"{where}: {key} is {value}, must be positive")
    not_negative = {
        "rotor_inertia_kg_m2": vehicle.rotor_inertia_kg_m2,
        "battery.internal_ohm": vehicle.battery.internal_ohm,
        "battery.supply_ohm": vehicle.battery.supply_ohm,
        "battery.electronics_a": vehicle.battery.electronics_a,
    }
    for key, value in not_negative.items():
        if not (math.isfinite(value) and value >= 0):
            raise BadInputError(f"{where}: {key} is {value}, must not be negative")
    for key, value in {"motor.a2": vehicle.motor.a2, **vehicle.gains}.items():
        if not math.isfinite(value):
            raise BadInputError(f"{where}: {key} is {value}, must be finite")
    if max(ixx, iyy, izz) > ixx + iyy + izz - max(ixx, iyy, izz):
        raise BadInputError(
            f"{where}: inertia_kg_m2 {ixx}, {iyy}, {izz} is not that of a body"
            " (the largest exceeds the sum of the others); correct it"
        )


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
    # Mass, arm and inertia of the public identification of the 2.x; thrust from its public
    # thrust-stand polynomial at hover, torque over thrust 0.006 m, motor lag 65 ms.
    "crazyflie21": Vehicle(
        name="crazyflie21",
        configuration="x",
        mass_kg=0.029,
        arm_m=0.046,
        inertia_kg_m2=(1.66e-5, 1.66e-5, 2.93e-5),
        motor=MotorConstants(a0=1.51, a1=10.7, a2=0.0085),
        thrust_n=8.6e-7,
        drag_n_m=5.2e-9,
        rotor_inertia_kg_m2=5.0e-8,
        battery=BatteryConstants(
            capacity_mah=250,
            internal_ohm=0.15,
            supply_ohm=0.06,
            back_emf_share=0.45,
            electronics_a=0.12,
        ),
    ),
}
