"""The model file: what identification found, in one JSON document.

``thesis`` names a built-in model with the numbers printed in the thesis (eq. 7.10, 7.18, 7.27
and 7.31).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import msgspec

from groundstation.documents import decode_json, read_document, seems
from groundstation.dynamics.registry import DISTURBANCE, EFFECTS
from groundstation.dynamics.vehicle import (
    THESIS_MOTOR,
    MotorConstants,
    Motors,
    Vehicle,
    load_vehicle,
    mean_motor,
    moved_motors,
    require_physical,
)
from groundstation.errors import BadInputError
from groundstation.paths import write_whole

SCHEMA_VERSION = 1
MEAN_TOLERANCE = 1e-3
"""Relative difference from which ``motor`` is not the mean of ``motors``; rounding is below."""


class BodyConstants(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Body rates and specific force from squared rotor speeds (thesis eq. 7.12-7.14).

    c0, c1, c2: roll, pitch, yaw acceleration in (rad/s^2) per (rev/s)^2 of the mixer (7.19).
    thrust_per_mass: specific force along z in (m/s^2) per (rev/s)^2, summed over the rotors.
    """

    c0: float
    c1: float
    c2: float
    thrust_per_mass: float


class ArxAxis(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A(q) y = q^-nk B(q) u for one axis; a starts at a1 (a0 is 1), ts in seconds."""

    na: int
    nb: int
    nk: int
    a: tuple[float, ...]
    b: tuple[float, ...]
    ts: float


class Estimate(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A parameter with its standard error (None where it was given, not estimated)."""

    value: float
    stderr: float | None = None
    unit: str = ""

    def __str__(self) -> str:
        spread = "" if self.stderr is None else f" ± {self.stderr:.2g}"
        return f"{self.value:.4g}{spread} {self.unit}".rstrip()


class EffectTerm(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A named effect on top of the base model.

    source: the Python file that defines it where it is not one of the list
    (``effects.own``); in a model file relative to that file's folder.
    """

    name: str
    parameters: dict[str, Estimate]
    source: str = ""

    def __repr__(self) -> str:
        return f"{self.name} {', '.join(f'{key} {one}' for key, one in self.parameters.items())}"


class Disturbance(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Slow forces and moments without a law, as a first-order Gauss-Markov process: standard
    deviations of moments (rad/s^2) and forces (m/s^2) along the body's axes, time constant (s)."""

    moments: tuple[float, float, float]
    forces: tuple[float, float, float]
    time_s: float

    def __str__(self) -> str:
        return (
            f"moments of {max(self.moments):.2g} rad/s^2 and forces of {max(self.forces):.2g}"
            f" m/s^2 at most, {self.time_s:g} s"
        )


class Model(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An identified craft.

    vehicle: name of the profile the model was fitted for.
    vehicle_profile: the profile itself where it is not a built-in one.
    motor, motors: the mean motor, and those of rotors M1..M4 where they were told apart.
    origin: part (motor, body, arx, or one constant, body.c2) -> fitted, profile or given; empty in
        files that do not say (``dynamics.origin``).
    disturbance: what an observer follows beside the effects; None: nothing.
    firmware_curve: thrust in N, by the firmware's own scale, of a motor at a voltage in V, constant
        first, as flights showed it; None: the one that belongs to the profile.
    fit: how it was fitted (recordings with hashes, samples, method, errors, covariance).
    """

    schema_version: int = SCHEMA_VERSION
    vehicle: str
    vehicle_profile: Vehicle | None = None
    motor: MotorConstants
    motors: Motors | None = None
    body: BodyConstants | None = None
    arx: dict[str, ArxAxis] | None = None
    effects: tuple[EffectTerm, ...] = ()
    disturbance: Disturbance | None = None
    origin: dict[str, Literal["fitted", "profile", "given"]] = {}
    firmware_curve: tuple[float, float, float, float] | None = None
    fit: dict[str, Any] = {}
    created_by: str = ""

    def __repr__(self) -> str:
        """What was identified, in a line; the account of the fit is in ``fit``."""
        parts = [f"motor {_numbers(self.motor)}"]
        if self.body is not None:
            parts.append(f"body {_numbers(self.body)}")
        if self.arx is not None:
            parts.append(f"arx {', '.join(self.arx)}")
        parts += map(repr, self.effects)
        if self.disturbance is not None:
            parts.append(f"disturbance of {self.disturbance}")
        return f"Model({self.vehicle}: {'; '.join(parts)})"


def load_model(source: str | Path) -> Model:
    """Read a model file, or the built-in ``thesis``.

    Raises BadInputError with the path inside the document that is wrong.
    """
    if str(source) == THESIS.created_by:
        return THESIS
    path = Path(source)
    content = b""
    try:
        content = read_document(path)
        model = decode_json(content, Model)
    except FileNotFoundError as error:
        raise BadInputError(
            f"model {str(source)!r}: no such file; give a model file or the built-in 'thesis'"
        ) from error
    except OSError as error:
        raise BadInputError(f"model {path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise BadInputError(f"model {path}: not a model file: {error}{seems(content)}") from error
    if model.schema_version != SCHEMA_VERSION:
        raise BadInputError(
            f"model {path}: schema_version {model.schema_version}, this version reads"
            f" {SCHEMA_VERSION}; fit the model again or use the version that made it"
        )
    _require_usable(model, f"model {path}")
    return _with_disturbance(_with_sources_from(path.parent, model))


def _numbers(constants: msgspec.Struct) -> str:
    values = msgspec.structs.asdict(constants)
    return ", ".join(f"{key} {value:.4g}" for key, value in values.items())


def save_model(model: Model, path: str | Path) -> None:
    """Write a model file, indented so that people and diffs can read it."""
    _require_usable(model, f"model for {path}")
    try:
        text = msgspec.json.format(msgspec.json.encode(model), indent=2) + b"\n"
        write_whole(Path(path), text)
    except OSError as error:
        raise BadInputError(f"model {path}: cannot be written: {error.strerror}") from error


def model_vehicle(model: Model) -> Vehicle:
    """The profile the model belongs to."""
    return model.vehicle_profile or load_vehicle(model.vehicle)


def require_body(model: Model) -> BodyConstants:
    """Its body's constants. Raises BadInputError for a model that cannot fly."""
    if model.body is None:
        raise BadInputError(
            f"model for {model.vehicle}: it has no body constants, only ARX polynomials: thrust,"
            " and when the craft flies, are not in it; fit a body ('groundstation fit body')"
        )
    return model.body


def rotor_motors(model: Model) -> Motors:
    """The motor of each rotor M1..M4; four equal ones where they were not told apart."""
    motor = model.motor
    return model.motors or (motor, motor, motor, motor)


def with_motor(model: Model, motor: MotorConstants) -> Model:
    """The model with another mean motor; where it has four, they move along with it."""
    motors = None if model.motors is None else moved_motors(model.motors, motor)
    return msgspec.structs.replace(model, motor=motor, motors=motors)


def vehicle_model(vehicle: Vehicle) -> Model:
    """The base model that the profile's physical constants amount to."""
    c0, c1, c2 = vehicle.body_constants
    return Model(
        vehicle=vehicle.name,
        vehicle_profile=vehicle,
        motor=vehicle.motor,
        body=BodyConstants(c0, c1, c2, vehicle.thrust_per_mass),
        created_by="vehicle profile",
    )


def _with_sources_from(folder: Path, model: Model) -> Model:
    effects = tuple(
        msgspec.structs.replace(term, source=str((folder / term.source).resolve()))
        if term.source
        else term
        for term in model.effects
    )
    return msgspec.structs.replace(model, effects=effects)


def _with_disturbance(model: Model) -> Model:
    """The model with the disturbance where files have had it: among the effects."""
    for term in model.effects:
        if term.name == DISTURBANCE.name:
            found = [term.parameters[one.name].value for one in DISTURBANCE.parameters]
            x, y, z, u, v, w, time_s = found
            return msgspec.structs.replace(
                model,
                effects=tuple(other for other in model.effects if other is not term),
                disturbance=Disturbance((x, y, z), (u, v, w), time_s),
            )
    return model


def _require_usable(model: Model, where: str) -> None:
    motors = {"motor": model.motor}
    motors.update({f"motors[{i}]": one for i, one in enumerate(model.motors or ())})
    numbers = {
        f"{name}.{key}": getattr(one, key) for name, one in motors.items() for key in ("a0", "a1")
    }
    if model.body is not None:
        for key in ("c0", "c1", "c2", "thrust_per_mass"):
            numbers[f"body.{key}"] = getattr(model.body, key)
    for key, value in numbers.items():
        if not (math.isfinite(value) and value > 0):
            raise BadInputError(f"{where}: {key} is {value}, must be positive and finite")
    for name, one in motors.items():
        if not (math.isfinite(one.a2) and one.a2 >= 0.0):
            raise BadInputError(f"{where}: {name}.a2 is {one.a2}, must be finite, 0 or more")
    if model.motors is not None:
        mean = mean_motor(model.motors)
        for key in ("a0", "a1", "a2"):
            value, expected = getattr(model.motor, key), getattr(mean, key)
            if abs(value - expected) > MEAN_TOLERANCE * abs(expected):
                raise BadInputError(
                    f"{where}: motor.{key} is {value}, but the mean of motors is {expected};"
                    " correct it, or leave 'motors' out"
                )
    for term in model.effects:
        if not term.source:
            _require_known(term, where)
    if model.vehicle_profile is not None:
        require_physical(model.vehicle_profile, f"{where}: vehicle_profile")
    if model.body is None and model.arx is None:
        raise BadInputError(f"{where}: holds neither body nor arx: nothing to simulate")


def _require_known(term: EffectTerm, where: str) -> None:
    if term.name not in EFFECTS:
        raise BadInputError(
            f"{where}: effect {term.name!r}: there are {', '.join(EFFECTS)};"
            " an effect of your own needs the file that defines it as 'source'"
        )
    given = {name: one.value for name, one in term.parameters.items()}
    try:
        EFFECTS[term.name].values(given)
        EFFECTS[term.name].require_sizes(given)
    except BadInputError as error:
        raise BadInputError(f"{where}: {error}") from error


THESIS = Model(
    vehicle="crazyflie1",
    motor=THESIS_MOTOR,
    # thrust_per_mass is not printed; it follows from Figure 5.7 as in the crazyflie1 profile.
    body=BodyConstants(c0=0.0136, c1=0.0136, c2=0.0005, thrust_per_mass=4.2e-5),
    arx={
        "roll": ArxAxis(2, 1, 8, (-1.959, 0.9567), (4.222e-8,), 0.002),
        "pitch": ArxAxis(2, 1, 8, (-1.959, 0.9567), (4.222e-8,), 0.002),
        "yaw": ArxAxis(2, 1, 8, (-1.995, 0.9949), (1.382e-9,), 0.002),
    },
    created_by="thesis",
)
