"""The numbers that the search estimates, and how they map to a model file.

A ``point`` is a dictionary from key to value: ``c0``, ``c1``, ``c2``, ``thrust_per_mass``, ``a0``,
``a1``, ``a2``, ``attitude_timing`` and the unknowns of effects (``dynamics/unknowns.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from groundstation.dynamics.craft import find_effect, load_effects
from groundstation.dynamics.effect import (
    Effect,
    Key,
    Parameter,
    Unknown,
    to_point,
    to_stderr,
    to_values,
    variants,
)
from groundstation.dynamics.model import (
    BodyConstants,
    EffectTerm,
    Estimate,
    Model,
    require_body,
    with_motor,
)
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.vehicle import MotorConstants
from groundstation.errors import BadInputError

Point = dict[str, float]

BODY_KEYS = ("c0", "c1", "c2", "thrust_per_mass")
MOTOR_KEYS = ("a0", "a1", "a2")
SENSOR_LAG = "rotor_speed_sensor.lag_s"
"""Of the sensor behind measured rotor speeds, first order."""
TIMING = "attitude_timing"
"""Where within its period the attitude filter takes the gyro: 0 over all of it, 1 at its end."""


@dataclass(frozen=True, slots=True)
class Variant:
    """One way in which an effect may be there.

    unknowns: its sizes, then its shapes. source: the user's file that defines it, if one does.
    """

    unknowns: tuple[Key, ...]
    source: str = ""

    @property
    def definition(self) -> Effect:
        return self.unknowns[0].effect

    @property
    def effect(self) -> str:
        return self.definition.name

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(one.key for one in self.unknowns)

    @property
    def sizes(self) -> tuple[str, ...]:
        """Unknowns that alone make the effect; the others only shape it."""
        return tuple(one.key for one in self.unknowns if one.parameter.kind == "size")

    @property
    def start(self) -> tuple[tuple[float, ...], ...]:
        """Values from which joint fits start, one tuple each; empty where any will do."""
        return tuple(zip(*(one.parameter.starts for one in self.unknowns), strict=False))

    @property
    def tried(self) -> Key | None:
        """The shape of which several values are screened; such an effect has no columns before one
        of them promises something."""
        return next((one for one in self.unknowns if one.parameter.tried), None)

    @property
    def label(self) -> str:
        return self.effect if self.definition.choice is None else self.keys[0]


VARIANTS: tuple[Variant, ...] = tuple(
    Variant(keys) for effect in EFFECTS.values() for keys in variants(effect)
)
"""The listed effects'."""
RENAMES: tuple[Variant, ...] = tuple(one for one in VARIANTS if one.definition.renames)
"""Those that are another name for the change of a base constant, and so no candidates."""
ALONG: Variant = next(one for one in VARIANTS if SENSOR_LAG in one.keys)
"""The one that is fitted along with the base constants where rotor speeds were recorded."""
KEYS: dict[str, Key] = {one.key: one for variant in VARIANTS for one in variant.unknowns}
ABSENT: dict[str, float] = {key: one.absent for key, one in KEYS.items()}


def absent(key: str) -> float:
    """The value of an unknown at which its effect is not there."""
    return ABSENT.get(key, 0.0)


def value(point: Mapping[str, float], key: str) -> float:
    """A number of a point; an effect's that is not in it is absent."""
    return point.get(key, absent(key))


def own_effects(path: str | Path) -> list[Variant]:
    """The effects that a user's file defines, as candidates. Raises BadInputError like
    ``load_effects``, and for one without a size."""
    source = str(Path(path).resolve())
    effects = load_effects(source)
    for name, effect in effects.items():
        if not effect.sizes:
            raise BadInputError(
                f"effect file {source}: {name} has no size, a parameter that alone makes the"
                " effect; nothing could be found of it"
            )
    return [one for effect in effects.values() for one in _own(effect, source)]


def own_of(model: Model) -> list[Variant]:
    """The user's own effects that a model has already."""
    return [
        one
        for term in model.effects
        if term.source
        for one in _own(find_effect(term.name, term.source), term.source)
    ]


def _own(effect: Effect, source: str) -> list[Variant]:
    ways = variants(_counted(effect))
    return [Variant(tuple(replace(k, effect=effect) for k in keys), source) for keys in ways]


def _counted(effect: Effect) -> Effect:
    """The effect with unknowns that are 0 where it is absent, and its shapes at their default."""

    def counted(one: Parameter) -> Parameter:
        key = Key("", effect, one)
        zero = key.absent
        if one.kind == "choice" or zero == 0.0:
            return one
        unknown = Unknown(
            one.name if one.unknown is None else one.unknown.name,
            key.unit,
            lambda value: one.to_unknown(value) - zero,
            lambda value: one.from_unknown(value + zero),
        )
        low, high = key.bounds
        return replace(one, unknown=unknown, bounds=(low - zero, high - zero))

    return replace(effect, parameters=tuple(map(counted, effect.parameters)))


def joined(known: Sequence[Variant], candidates: Sequence[Variant]) -> list[Variant]:
    """The model's own effects and further candidates.

    Raises BadInputError where two files define one name.
    """
    found = {one.keys: one for one in known}
    for one in candidates:
        other = found.setdefault(one.keys, one)
        if other.source != one.source:
            raise BadInputError(
                f"effect {one.effect}: defined in {one.source} and, for the model, in"
                f" {other.source}; rename one"
            )
    return list(found.values())


def point_of(model: Model) -> Point:
    """Where a search starts: the model's constants, and the effects it has already."""
    body = require_body(model)
    point: Point = {key: getattr(body, key) for key in BODY_KEYS}
    point.update({key: getattr(model.motor, key) for key in MOTOR_KEYS})
    point[TIMING] = 0.0
    for term in model.effects:
        given = {name: one.value for name, one in term.parameters.items()}
        effect = find_effect(term.name, term.source)
        point.update(to_point(_counted(effect) if term.source else effect, given))
    return point


def model_of(
    point: Mapping[str, float],
    errors: Mapping[str, float],
    keys: Sequence[str],
    model: Model,
    own: Sequence[Variant] = (),
) -> Model:
    """The model file of a point: ``model`` with its constants and the effects behind ``keys``.

    errors: standard errors by key. own: the user's own effects among them.
    """
    import msgspec

    there = [v for v in (*VARIANTS, *own) if v.keys[0] in keys]
    terms = [
        EffectTerm(v.effect, estimates_of(v, point, errors), v.source)
        for v in sorted(there, key=lambda v: list(keys).index(v.keys[0]))
    ]
    return msgspec.structs.replace(
        with_motor(model, MotorConstants(*(point[key] for key in MOTOR_KEYS))),
        body=BodyConstants(*(point[key] for key in BODY_KEYS)),
        effects=tuple(terms),
    )


def estimates_of(
    variant: Variant, point: Mapping[str, float], errors: Mapping[str, float]
) -> dict[str, Estimate]:
    """A variant's parameters as the model file has them."""
    spread = to_stderr(variant.unknowns, point, errors)
    return {
        name: Estimate(value, spread.get(name), variant.definition.parameter(name).unit)
        for name, value in to_values(variant.unknowns, point).items()
    }
