"""The numbers that the compiled models fly: one record per craft."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.effects.catalogue import Effect
from groundstation.dynamics.effects.own import MOST_VALUES, find_effect, law_address
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
        ("coupling", "f8"),  # share of Omega x I Omega that acts (eq. 3.49), 1 in physics
        ("gyroscopic", "f8"),  # rotor inertia whose angular momentum acts on roll and pitch
        ("spin_up", "f8"),  # rotor inertia whose acceleration acts on yaw (eq. 3.18)
        ("a0", "f8"),
        ("a1", "f8"),
        ("a2", "f8"),
        # named effects, 0 where absent; laws and units in docs/stand_in.md
        ("strength", "f8", (4,)),  # of each rotor's thrust and drag, 1 in the base model
        ("dead_mv", "f8"),
        ("braking", "f8"),  # 1 in the base model
        ("sag_ohm", "f8"),
        ("winding_ohm", "f8"),
        ("back_emf_mv", "f8"),  # per rev/s, the bound a1/a0
        ("rate_damping", "f8"),
        ("quadratic_damping", "f8"),
        ("yaw_damping", "f8"),
        ("gravity_x", "f8"),
        ("gravity_y", "f8"),
        ("air", "f8"),  # 1: one of the next three is not zero
        ("rotor_drag", "f8"),
        ("velocity_moment", "f8"),
        ("climb_inflow", "f8"),  # m/s^2 per m/s
        ("ground_gain", "f8"),
        ("ground_height", "f8"),
        ("law", "i8"),  # address of a user's own law, 0: none
        ("law_values", "f8", (MOST_VALUES,)),
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
    craft["coupling"] = coupling
    craft["gyroscopic"] = vehicle.rotor_inertia_kg_m2 if gyroscopic else 0.0
    craft["spin_up"] = vehicle.rotor_inertia_kg_m2 if spin_up else 0.0
    for name in ("a0", "a1", "a2"):
        craft[name] = getattr(vehicle.motor, name)
    craft["strength"], craft["braking"] = 1.0, 1.0
    craft["winding_ohm"] = vehicle.winding_ohm
    craft["back_emf_mv"] = vehicle.motor.a1 / vehicle.motor.a0
    return record


def craft_of_model(model: Model) -> Crafts:
    """What was identified, shape (1,): the base model, and those of its effects that act on
    motors and body. (What its effects do to the sensors is in ``effects.sensors``.)

    A model knows ratios only (c0 = k l / Ixx and so on). The mass and the ratio of Izz to
    Ixx + Iyy are the profile's; everything that can be observed follows from the model.

    Raises BadInputError where the model has no body, or an effect that does not exist.
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
    for name in ("a0", "a1", "a2"):
        craft[name] = getattr(model.motor, name)
    craft["back_emf_mv"] = model.motor.a1 / model.motor.a0
    _add_effects(craft, model)
    return record


FIELDS = {
    "rotor_gyroscopic_torque": {"gyroscopic": "rotor_inertia_kg_m2"},
    "rotor_acceleration_torque": {"spin_up": "rotor_inertia_kg_m2"},
    "inertia_coupling": {"coupling": "fraction"},
    "rate_damping": {"rate_damping": "damping_n_m_s"},
    "quadratic_rate_damping": {"quadratic_damping": "damping_n_m_s2"},
    "yaw_damping": {"yaw_damping": "damping_n_m_s"},
    "centre_of_gravity_offset": {"gravity_x": "x_m", "gravity_y": "y_m"},
    "motor_dead_voltage": {"dead_mv": "voltage_mv"},
    "motor_braking_asymmetry": {"braking": "factor"},
    "supply_sag": {"sag_ohm": "resistance_ohm"},
    "rotor_drag": {"rotor_drag": "drag_n_s_m"},
    "velocity_moment": {"velocity_moment": "moment"},
    "ground_effect": {"ground_height": "height_m", "ground_gain": "gain"},
}
"""effect -> record field -> parameter, where a parameter is a field as it stands."""


def _add_effects(craft: np.void, model: Model) -> None:
    own: list[tuple[Effect, list[float]]] = []
    for term in model.effects:
        effect = find_effect(term.name, term.source)
        values = effect.values({name: one.value for name, one in term.parameters.items()})
        for field, parameter in FIELDS.get(effect.name, {}).items():
            craft[field] = values[parameter]
        if effect.name == "climb_inflow":
            craft["climb_inflow"] = values["loss_g_per_m_s"] * STANDARD_GRAVITY
        elif effect.name == "rotor_mismatch":
            craft["strength"][int(values["rotor"]) - 1] *= 1.0 + values["excess"]
        elif effect.law is not None:
            own.append((effect, list(values.values())))
    craft["air"] = any(
        craft[name] != 0.0 for name in ("rotor_drag", "velocity_moment", "climb_inflow")
    )
    if own:
        numbers = [value for _, values in own for value in values]
        if len(numbers) > MOST_VALUES:
            raise BadInputError(
                f"model for {model.vehicle}: its own effects have {len(numbers)} parameters,"
                f" at most {MOST_VALUES} can act"
            )
        laws = tuple(effect.law for effect, _ in own if effect.law is not None)
        craft["law"] = law_address(laws, tuple(len(values) for _, values in own))
        craft["law_values"][: len(numbers)] = numbers
