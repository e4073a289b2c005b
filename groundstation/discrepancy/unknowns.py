"""The numbers that the search estimates, and how they map to a model file.

A ``point`` is a dictionary from key to value: ``c0``, ``c1``, ``c2``, ``thrust_per_mass``,
``a0``, ``a1``, ``a2``, ``attitude_timing`` and ``effect.parameter``. Inside the search a
low-pass is a time constant and a mismatch has one number for each rotor, so that every unknown
is 0 (the braking factor 1) where its effect is absent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from groundstation.discrepancy.own_candidates import OwnEffect, own_terms, term_of
from groundstation.dynamics.effects.catalogue import EFFECTS, Effect
from groundstation.dynamics.model import BodyConstants, EffectTerm, Estimate, Model
from groundstation.dynamics.vehicle import MotorConstants
from groundstation.errors import BadInputError

Point = dict[str, float]

BODY_KEYS = ("c0", "c1", "c2", "thrust_per_mass")
MOTOR_KEYS = ("a0", "a1", "a2")
TIMING = "attitude_timing"
"""Where within its period the attitude filter takes the gyro: 0 over all of it, 1 at its end."""


@dataclass(frozen=True, slots=True)
class Variant:
    """One way in which an effect may be there.

    keys: its unknowns. start: values from which the joint fits start, one tuple each. own: what a
    user's own effect needs beside.
    """

    effect: str
    keys: tuple[str, ...]
    start: tuple[tuple[float, ...], ...]
    own: OwnEffect | None = None

    @property
    def definition(self) -> Effect:
        """Its entry in the catalogue, or in the user's file."""
        return EFFECTS[self.effect] if self.own is None else self.own.effect

    @property
    def label(self) -> str:
        return self.keys[0] if self.effect == "rotor_mismatch" else self.effect


def _plain(effect: str, *starts: tuple[float, ...]) -> Variant:
    names = [p.name for p in EFFECTS[effect].parameters]
    return Variant(effect, tuple(f"{effect}.{name}" for name in names), starts)


LOW_PASS = "gyro_low_pass.time_constant_s"
VARIANTS: tuple[Variant, ...] = (
    _plain("dead_time"),
    Variant("gyro_low_pass", (LOW_PASS,), ()),
    _plain("rotor_gyroscopic_torque"),
    _plain("inertia_coupling"),
    _plain("rotor_acceleration_torque"),
    _plain("rate_damping"),
    _plain("quadratic_rate_damping"),
    _plain("centre_of_gravity_offset"),
    *(Variant("rotor_mismatch", (f"rotor_mismatch.{i}",), ()) for i in (1, 2, 3, 4)),
    _plain("motor_dead_voltage"),
    _plain("motor_braking_asymmetry"),
    _plain("supply_sag"),
    _plain("battery_reading_lag", (0.08,), (0.25,), (0.6,)),
    _plain("gyro_bias"),
    _plain("accelerometer_bias"),
    _plain("imu_misalignment"),
    _plain("rotor_drag"),
    _plain("velocity_moment"),
    _plain("yaw_damping"),
    _plain("climb_inflow"),
    _plain("imu_lever_arm"),
    Variant("ground_effect", ("ground_effect.gain", "ground_effect.height_m"), ()),
    _plain("attitude_filter_lean"),
)
ABSENT: dict[str, float] = {key: 0.0 for variant in VARIANTS for key in variant.keys}
ABSENT["motor_braking_asymmetry.factor"] = 1.0
ABSENT["ground_effect.height_m"] = 0.08
EFFECT_KEYS = tuple(ABSENT)


def absent(key: str) -> float:
    """The value of an unknown at which its effect is not there."""
    return ABSENT.get(key, 0.0)


def own_variant(own: OwnEffect) -> Variant:
    return Variant(own.effect.name, own.keys, (), own)


def effect_of(key: str) -> str:
    """The effect an unknown belongs to."""
    return key.partition(".")[0]


def point_of(model: Model) -> Point:
    """Where a search starts: the model's constants, and the effects it has already."""
    body = model.body
    if body is None:
        raise BadInputError(
            f"model for {model.vehicle}: it has no body constants, only ARX polynomials;"
            " fit a body ('groundstation fit body')"
        )
    point: Point = {key: getattr(body, key) for key in BODY_KEYS}
    point.update({key: getattr(model.motor, key) for key in MOTOR_KEYS})
    point[TIMING] = 0.0
    for term in model.effects:
        if term.name not in EFFECTS:
            continue
        values = EFFECTS[term.name].values({k: e.value for k, e in term.parameters.items()})
        if term.name == "gyro_low_pass":
            width = values["bandwidth_hz"]
            point[LOW_PASS] = 1.0 / (2.0 * math.pi * width) if width > 0.0 else 0.0
        elif term.name == "rotor_mismatch":
            point[f"rotor_mismatch.{round(values['rotor'])}"] = values["excess"]
        else:
            point.update({f"{term.name}.{key}": value for key, value in values.items()})
    point.update(own_terms(model)[1])
    return point


def model_of(
    point: Mapping[str, float],
    errors: Mapping[str, float],
    keys: tuple[str, ...],
    model: Model,
    own: Sequence[OwnEffect] = (),
) -> Model:
    """The model file of a point: ``model`` with its constants and the effects behind ``keys``.

    errors: standard errors by key. own: the user's own effects among them.
    """
    import msgspec

    names = list(dict.fromkeys(effect_of(key) for key in keys))
    theirs = {one.effect.name: one for one in own}
    terms = [
        term_of(theirs[name], point, errors)
        if name in theirs
        else EffectTerm(name, parameters_of(name, point, errors, keys))
        for name in names
    ]
    return msgspec.structs.replace(
        model,
        motor=MotorConstants(*(point[key] for key in MOTOR_KEYS)),
        body=BodyConstants(*(point[key] for key in BODY_KEYS)),
        effects=tuple(terms),
    )


def estimates_of(
    variant: Variant, point: Mapping[str, float], errors: Mapping[str, float]
) -> dict[str, Estimate]:
    """A variant's parameters as the model file has them."""
    if variant.own is not None:
        return variant.own.estimates(point, errors)
    return parameters_of(variant.effect, point, errors, variant.keys)


def parameters_of(
    effect: str, point: Mapping[str, float], errors: Mapping[str, float], keys: tuple[str, ...]
) -> dict[str, Estimate]:
    """An effect's parameters as the model file has them."""
    catalogue = EFFECTS[effect]
    if effect == "gyro_low_pass":
        lag = point[LOW_PASS]
        width = 1.0 / (2.0 * math.pi * lag) if lag > 0.0 else 0.0
        relative = errors.get(LOW_PASS, 0.0) / lag if lag > 0.0 else 0.0
        return {"bandwidth_hz": Estimate(width, width * relative, "Hz")}
    if effect == "rotor_mismatch":
        key = next(key for key in keys if effect_of(key) == effect)
        return {
            "rotor": Estimate(float(key.rpartition(".")[2]), None, ""),
            "excess": Estimate(point[key], errors.get(key), ""),
        }
    found = {}
    for parameter in catalogue.parameters:
        key = f"{effect}.{parameter.name}"
        found[parameter.name] = Estimate(
            point.get(key, ABSENT[key]), errors.get(key), parameter.unit
        )
    return found
