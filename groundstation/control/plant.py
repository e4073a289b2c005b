"""The craft as the closed-loop simulations turn it: motors, torques, rotation, sensor delay.

Rotation only: none of the torques of the base model depends on place or velocity, so a 6-DOF
craft turns exactly like this. Of a model's effects those that act on rotation are taken along;
``plant_of_model`` says which are not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.mixer import MIXERS
from groundstation.dynamics.model import Model, model_vehicle
from groundstation.dynamics.motor import REVOLUTION
from groundstation.errors import BadInputError
from groundstation.telemetry.packet import STANDARD_GRAVITY

Array = NDArray[np.float64]

PLANT = np.dtype(
    [
        ("a0", "f8"),
        ("a1", "f8"),
        ("a2", "f8"),
        ("c", "f8", (3,)),  # rad/s^2 per (rev/s)^2 of the mixer (eq. 7.12-7.14)
        ("mix", "f8", (3, 4)),  # the mixer (eq. 7.19)
        ("strength", "f8", (4,)),  # thrust and drag of each rotor, 1: as modelled
        ("coupling", "f8", (3,)),  # of qr, pr, pq (eq. 3.51-3.53), 0: absent
        ("gyroscopic", "f8", (2,)),  # of q w and p w, w in rev/s
        ("spin_up", "f8"),  # of dw/dt on yaw
        ("damping", "f8", (3,)),  # 1/s
        ("quadratic", "f8", (2,)),  # 1/rad
        ("offset", "f8", (2,)),  # rad/s^2 per (rev/s)^2 of all rotors (centre of gravity)
        ("dead_mv", "f8"),
        ("braking", "f8"),  # factor on negative dn/dt
        ("delay_s", "f8"),  # of everything that is measured
        ("lag_s", "f8"),  # first-order lag of the gyro
        ("airframe_x", "i8"),
        ("fusion", "i8"),  # 1: angles from the Mahony filter, 0: the true ones
    ]
)


@dataclass(frozen=True, slots=True)
class Plant:
    """record: ``PLANT``, shape (1,). hover_rev_s: rotor speed that carries the craft.
    hover_mv: the armature voltage for it. left_out: effects of the model that are not simulated.
    """

    record: NDArray[np.void]
    hover_rev_s: float
    hover_mv: float
    left_out: tuple[str, ...]

    def changed(self, **values: float) -> Plant:
        """The same with scalar fields of the record replaced."""
        record = self.record.copy()
        for name, value in values.items():
            record[name] = value
        return Plant(record, self.hover_rev_s, self.hover_mv, self.left_out)


def plant_of_model(model: Model, fusion: bool = True) -> Plant:
    """A fitted model with its effects.

    fusion: the controller hears the firmware's attitude filter; otherwise the true angles.

    Raises BadInputError for a model without a body.
    """
    if model.body is None:
        raise BadInputError(
            f"model for {model.vehicle}: it has no body constants, only ARX polynomials;"
            " fit a body ('groundstation fit body')"
        )
    vehicle, body, motor = model_vehicle(model), model.body, model.motor
    record = np.zeros(1, PLANT)
    p = record[0]
    p["a0"], p["a1"], p["a2"] = motor.a0, motor.a1, motor.a2
    p["c"] = body.c0, body.c1, body.c2
    p["mix"] = MIXERS[vehicle.configuration]
    p["strength"], p["braking"], p["fusion"] = 1.0, 1.0, fusion
    p["airframe_x"] = vehicle.configuration == "x"
    ixx, iyy, izz = vehicle.inertia_kg_m2
    left_out = []
    for term in model.effects:
        value = {name: estimate.value for name, estimate in term.parameters.items()}
        match term.name:
            case "dead_time":
                p["delay_s"] += value["delay_s"]
            case "gyro_low_pass":
                p["lag_s"] = 1 / (2 * math.pi * value["bandwidth_hz"])
            case "inertia_coupling":
                share = value["fraction"]
                p["coupling"] = (
                    share * (iyy - izz) / ixx,
                    share * (izz - ixx) / iyy,
                    share * (ixx - iyy) / izz,
                )
            case "rotor_gyroscopic_torque":
                momentum = REVOLUTION * value["rotor_inertia_kg_m2"]
                p["gyroscopic"] = momentum / ixx, momentum / iyy
            case "rotor_acceleration_torque":
                p["spin_up"] = REVOLUTION * value["rotor_inertia_kg_m2"] / izz
            case "rate_damping":
                p["damping"][:2] = value["damping_n_m_s"] / ixx, value["damping_n_m_s"] / iyy
            case "quadratic_rate_damping":
                damping = value["damping_n_m_s2"]
                p["quadratic"] = damping / ixx, damping / iyy
            case "yaw_damping":
                p["damping"][2] = value["damping_n_m_s"] / izz
            case "centre_of_gravity_offset":
                thrust = vehicle.mass_kg * body.thrust_per_mass
                p["offset"] = -value["y_m"] * thrust / ixx, value["x_m"] * thrust / iyy
            case "rotor_mismatch":
                p["strength"][round(value["rotor"]) - 1] += value["excess"]
            case "motor_dead_voltage":
                p["dead_mv"] = value["voltage_mv"]
            case "motor_braking_asymmetry":
                p["braking"] = value["factor"]
            case "attitude_filter_lean":
                pass
            case other:
                left_out.append(other)
    hover = math.sqrt(STANDARD_GRAVITY / (4 * body.thrust_per_mass))
    return Plant(record, hover, motor.armature_mv(hover) + float(p["dead_mv"]), tuple(left_out))
