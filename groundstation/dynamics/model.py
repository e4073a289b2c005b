"""The model file: what identification found, in one JSON document, and where each part comes
from.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

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
from groundstation.telemetry.arrays import AXES, Array

# The model file: what identification found, in one JSON document.
#
# ``thesis`` names a built-in model with the numbers printed in the thesis (eq. 7.10, 7.18, 7.27
# and 7.31).


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
    (``craft.load_effects``); in a model file relative to that file's folder.
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
        files that do not say (``origin_of``).
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
    return ", ".join(f"{key} {one:.4g}" for key, one in msgspec.structs.asdict(constants).items())


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
    effects = [
        msgspec.structs.replace(term, source=term.source and str((folder / term.source).resolve()))
        for term in model.effects
    ]
    return msgspec.structs.replace(model, effects=tuple(effects))


def _with_disturbance(model: Model) -> Model:
    """The model with the disturbance where files have had it: among the effects."""
    for term in model.effects:
        if term.name == DISTURBANCE.name:
            x, y, z, u, v, w, time_s = (
                term.parameters[one.name].value for one in DISTURBANCE.parameters
            )
            return msgspec.structs.replace(
                model,
                effects=tuple(other for other in model.effects if other is not term),
                disturbance=Disturbance((x, y, z), (u, v, w), time_s),
            )
    return model


def _require_usable(model: Model, where: str) -> None:
    motors = {"motor": model.motor}
    motors |= {f"motors[{i}]": one for i, one in enumerate(model.motors or ())}
    numbers = {
        f"{name}.{key}": getattr(one, key) for name, one in motors.items() for key in ("a0", "a1")
    }
    if model.body is not None:
        numbers |= {f"body.{key}": getattr(model.body, key) for key in BODY}
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
        **dict.fromkeys(("roll", "pitch"), ArxAxis(2, 1, 8, (-1.959, 0.9567), (4.222e-8,), 0.002)),
        "yaw": ArxAxis(2, 1, 8, (-1.995, 0.9949), (1.382e-9,), 0.002),
    },
    created_by="thesis",
)


# Where the parts of a model come from: fitted, of a vehicle's profile, or given by hand.
#
# A fit of the motor or of ARX polynomials leaves the profile's body in its file. Nobody measured
# that body: on the stand-in it is even the truth. ``Model.origin`` says so part by part, and what
# needs a fitted body refuses one that is not.


FITTED, PROFILE, GIVEN = "fitted", "profile", "given"
PARTS = ("motor", "body", "arx")
BODY = ("c0", "c1", "c2", "thrust_per_mass")


def origin_of(model: Model) -> dict[str, str]:
    """Part -> fitted, profile or given, for the parts that the model has.

    What the file does not say follows from the account of its fits; what is in none of them is the
    profile's where it is equal to it to the last digit, else given.
    """
    has = (part for part in PARTS if getattr(model, part) is not None)
    return {part: model.origin.get(part) or _assumed(model, part) for part in has}


def with_origin(model: Model) -> Model:
    """The model with its parts' origins in it, as a fit writes them."""
    origin = origin_of(model) | {part: FITTED for part in PARTS if part in model.fit}
    left = model.fit.get("body", {}).get("not_identified", ())
    origin |= {f"body.{name}": PROFILE for name in left if name in BODY}
    return msgspec.structs.replace(model, origin=origin)


def require_fitted_body(model: Model, where: str) -> None:
    """Raises BadInputError, beginning with ``where``, for a model whose body nobody fitted."""
    if model.body is not None and model.origin.get("body") == PROFILE:
        turns = "" if model.arx is None else "its ARX polynomials turn it, thrust needs a body; "
        raise BadInputError(
            f"{where}: {turns}its body constants are those of the profile {model.vehicle!r}, not"
            f" fitted; fit them: groundstation fit body REC... --model {where} -o body.json"
        )


def origin_notes(model: Model) -> list[str]:
    """What a user of the model must know about where its parts come from, a line each."""
    of, found = f"those of the profile {model.vehicle!r}, not fitted", []
    if not model.origin and model.fit and model.body is not None and "body" not in model.fit:
        equal = " (they equal the profile's)" if _assumed(model, "body") == PROFILE else ""
        found.append(
            "made before files said what was fitted: its body constants are taken as fitted" + equal
        )
    whole = [part for part in ("motor", "body") if model.origin.get(part) == PROFILE]
    found += [f"{part} constants are {of}" for part in whole]
    single = [name for name in BODY if model.origin.get(f"body.{name}") == PROFILE]
    if single and "body" not in whole:
        found.append(f"{', '.join(single)}: {of}")
    searched = model.fit.get("discrepancy", {}).get("verdict", "unexplained")
    if model.fit.get("body", {}).get("quality") and searched == "unexplained":
        found.append("its body predicts unseen data worse than their mean: only search with it")
    return found


def _assumed(model: Model, part: str) -> str:
    if part in model.fit:
        return FITTED
    of_profile = getattr(vehicle_model(model_vehicle(model)), part)
    return PROFILE if getattr(model, part) == of_profile else GIVEN


# ARX polynomials as simulators (thesis eq. 7.9, 7.32-7.34).


SLOPE_ROWS = 2
"""An angle's slope is taken over so many rows: the firmware refreshes it every second one."""
Turning = Literal["body", "arx"]
"""What of a model turns the craft: the equations of its body, or its ARX polynomials."""


def turning_of(model: Model, said: str | None = None) -> Turning:
    """What turns the craft: as a user says, else ARX polynomials of all axes that were fitted.

    Raises BadInputError for a word that is neither, or polynomials that the model lacks.
    """
    whole = model.arx is not None and set(AXES) <= set(model.arx)
    if said is None:
        return "arx" if whole and origin_of(model)["arx"] == FITTED else "body"
    if said == "arx" and not whole:
        has = ", ".join(model.arx or {}) or "none"
        raise BadInputError(
            f"attitude arx: the model has ARX polynomials of {has}, all of {', '.join(AXES)} are"
            " needed; fit them: groundstation fit arx"
        )
    if said not in ("body", "arx"):
        raise BadInputError(f"attitude {said}: there are body, arx")
    return "arx" if said == "arx" else "body"


def of_rates(model: Model) -> bool:
    """Whether the polynomials give body rates (``fit arx --gyro``) and not angles."""
    return model.fit.get("arx", {}).get("channel") == "gyro"


def arx_labels(model: Model) -> str:
    """The structures of all axes as the thesis writes them."""
    found = (model.arx or {}).items()
    return ", ".join(f"{axis} ARX({one.na},{one.nb},{one.nk})" for axis, one in found)


def simulate_arx(axis: ArxAxis, inputs: ArrayLike, past_outputs: ArrayLike = ()) -> Array:
    """Outputs (k,) of a free run: the model hears its inputs and its own outputs only.

    inputs: (k,) mixer outputs u' in (rev/s)^2; what came before them is taken as zero.
    past_outputs: up to ``na`` outputs (rad) before the first, oldest first, otherwise zero.
    """
    from scipy.signal import lfilter, lfiltic

    past = np.asarray(past_outputs, np.float64)[::-1][: axis.na]
    numerator, denominator = np.array([*[0.0] * axis.nk, *axis.b]), np.array([1.0, *axis.a])
    state = lfiltic(numerator, denominator, past)
    outputs, _ = lfilter(numerator, denominator, np.asarray(inputs, np.float64), zi=state)
    return np.asarray(outputs)


def arx_ahead(
    axis: ArxAxis, inputs: Array, outputs: Array, starts: NDArray[np.int64], rows: int, every: int
) -> Array:
    """Outputs (m, rows + 1) from each of ``starts`` (m,) to ``rows`` rows later.

    Each free run begins with the measured ``outputs`` (n,) up to its start, which is column 0, and
    is driven by ``inputs`` (n,). every: rows per step of the model, over which the inputs are
    means that end with their row; between steps the output moves on a straight line. What would
    lie before the first row repeats it.
    """
    steps = -(-rows // every)
    known = max(axis.na, 1)
    run = np.empty((len(starts), known + steps))
    for i in range(known):
        run[:, known - 1 - i] = outputs[np.maximum(starts - i * every, 0)]
    for j in range(1, steps + 1):
        at, value = known - 1 + j, np.zeros(len(starts))
        for i, a in enumerate(axis.a, 1):
            value -= a * run[:, at - i]
        for k, b in enumerate(axis.b):
            acted = starts + (j - axis.nk - k) * every
            value += b * inputs[np.clip(acted, 0, len(inputs) - 1)]
        run[:, at] = value
    place = np.arange(rows + 1) / every
    before = np.minimum(place.astype(np.int64), steps - 1)
    share = place - before
    run = run[:, known - 1 :]
    return (1.0 - share) * run[:, before] + share * run[:, before + 1]


def angle_polynomial(model: Model, axis: str) -> ArxAxis:
    """One axis from u' to its angle, of a model whose polynomials give angles or rates.

    Rates are integrated by the trapezoidal rule; body rates count as Euler rates (thesis 3.54).
    """
    one = (model.arx or {})[axis]
    if not of_rates(model):
        return one
    a = np.convolve([1.0, *one.a], [1.0, -1.0])[1:]
    b = 0.5 * one.ts * np.convolve(one.b, [1.0, 1.0])
    return ArxAxis(len(a), len(b), one.nk, tuple(a.tolist()), tuple(b.tolist()), one.ts)


def stacked(axes: Sequence[ArxAxis]) -> tuple[Array, Array, NDArray[np.int64]]:
    """a (m, na), b (m, nb), the shorter filled with zeros, and nk (m,)."""
    a = np.zeros((len(axes), max((one.na for one in axes), default=0)))
    b = np.zeros((len(axes), max((one.nb for one in axes), default=0)))
    for i, one in enumerate(axes):
        a[i, : one.na], b[i, : one.nb] = one.a, one.b
    return a, b, np.array([one.nk for one in axes], np.int64)


def poles(axis: ArxAxis) -> NDArray[np.complex128]:
    """Roots of A(z), largest magnitude first; outside the unit circle is unstable."""
    roots = np.roots([1.0, *axis.a]).astype(np.complex128)
    return roots[np.argsort(-np.abs(roots))]
