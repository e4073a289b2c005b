"""The numbers that the compiled models fly: one record per craft."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.model import Model, model_vehicle
from groundstation.dynamics.vehicle import Vehicle, lever_arm_m, rotor_positions_m
from groundstation.errors import BadInputError
from groundstation.telemetry.packet import STANDARD_GRAVITY

CRAFT = np.dtype(
    [
        ("mass", "f8"),
        ("gravity", "f8"),
        ("inertia", "f8", (3,)),
        ("thrust", "f8"),  # N per (rev/s)^2
        ("drag", "f8"),  # N m per (rev/s)^2
        ("rotor_x", "f8", (4,)),
        ("rotor_y", "f8", (4,)),
        ("rotor_inertia", "f8"),
        ("coupling", "f8"),  # 1: Omega x I Omega acts (eq. 3.49), 0: it does not
        ("gyroscopic", "f8"),  # 1: the rotors' angular momentum acts on roll and pitch
        ("spin_up", "f8"),  # 1: the rotors' acceleration acts on yaw (eq. 3.18)
        ("a0", "f8"),
        ("a1", "f8"),
        ("a2", "f8"),
    ]
)
"""Units SI but rotor speed in rev/s and motor constants as in ``MotorConstants``."""

Crafts = NDArray[np.void]
"""Records of ``CRAFT``, shape (m,): a batch over parameters."""


def craft_of_vehicle(
    vehicle: Vehicle, *, coupling: bool = True, gyroscopic: bool = True, spin_up: bool = True
) -> Crafts:
    """A profile as a record, shape (1,), with the rigid body's secondary torques on or off."""
    record = np.zeros(1, CRAFT)
    craft = record[0]
    craft["mass"], craft["gravity"] = vehicle.mass_kg, STANDARD_GRAVITY
    craft["inertia"] = vehicle.inertia_kg_m2
    craft["thrust"], craft["drag"] = vehicle.thrust_n, vehicle.drag_n_m
    places = rotor_positions_m(vehicle)
    craft["rotor_x"], craft["rotor_y"] = [x for x, _ in places], [y for _, y in places]
    craft["rotor_inertia"] = vehicle.rotor_inertia_kg_m2
    craft["coupling"], craft["gyroscopic"], craft["spin_up"] = coupling, gyroscopic, spin_up
    for name in ("a0", "a1", "a2"):
        craft[name] = getattr(vehicle.motor, name)
    return record


def craft_of_model(model: Model) -> Crafts:
    """The base model that was identified, shape (1,): no secondary torques.

    A model knows ratios only (c0 = k l / Ixx and so on). The mass and the ratio of Izz to
    Ixx + Iyy are the profile's; everything that can be observed follows from the model.

    Raises BadInputError where the model has no body.
    """
    if model.body is None:
        raise BadInputError(
            f"model for {model.vehicle}: it has no body constants, only ARX polynomials;"
            " fit a body ('groundstation fit body')"
        )
    vehicle, body = model_vehicle(model), model.body
    record = craft_of_vehicle(vehicle, coupling=False, gyroscopic=False, spin_up=False)
    craft = record[0]
    thrust = vehicle.mass_kg * body.thrust_per_mass
    ixx, iyy = (thrust * lever_arm_m(vehicle) / c for c in (body.c0, body.c1))
    izz = vehicle.inertia_kg_m2[2] / sum(vehicle.inertia_kg_m2[:2]) * (ixx + iyy)
    craft["inertia"] = ixx, iyy, izz
    craft["thrust"], craft["drag"] = thrust, body.c2 * izz
    craft["a0"], craft["a1"], craft["a2"] = model.motor.a0, model.motor.a1, model.motor.a2
    return record
