"""The numbers that the compiled models fly: one record per craft, a user's own effects
included.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from groundstation.documents import read_document
from groundstation.dynamics.effect import (
    ANGLES,
    FORCE,
    GYRO,
    STATE_SLOTS,
    VALUE_SLOTS,
    Effect,
    Role,
    Stage,
)
from groundstation.dynamics.model import Model, model_vehicle, require_body, rotor_motors
from groundstation.dynamics.registry import COMPILED, DISTURBANCE, EFFECTS, at_stage
from groundstation.dynamics.vehicle import (
    MotorConstants,
    Motors,
    Vehicle,
    lever_arm_m,
    rotor_positions_m,
)
from groundstation.errors import BadInputError
from groundstation.telemetry.packet import STANDARD_GRAVITY

# Which Python files of effects may run: a model that names one is a program, not only data.


CONSENT = "GROUNDSTATION_TRUST_EFFECTS"
"""``ALL`` or the SHA-256 of a file: what it names may run, and is known from then on."""
ALL = "1"
_SOURCE_MOST = 1 << 20


def trusted_source(path: Path) -> bytes:
    """The content of a Python file that may run: one whose SHA-256 is known, or with consent.

    Raises OSError where it cannot be read, BadInputError where nobody has consented.
    """
    content = read_document(path, _SOURCE_MOST)
    digest = _digest(content)
    if digest in _known():
        return content
    if os.environ.get(CONSENT, "") not in (ALL, digest):
        raise BadInputError(
            f"effect file {path} is a Python program that would run with your rights (SHA-256"
            f" {digest[:16]}..., not known here); read it, and if you trust it say so once with"
            " 'groundstation --trust-effects COMMAND ...'"
        )
    with contextlib.suppress(OSError):  # then it is asked again
        _known_path().parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with _known_path().open("a", encoding="utf-8") as file:
            file.write(f"{digest}  {path!s:.200}\n".replace("\n", " ").strip() + "\n")
    return content


def consent(path: Path | None = None) -> None:
    """Let this program, and those it starts, run the file that the user named; without one, all.

    Raises OSError where it cannot be read.
    """
    digest = ALL if path is None else _digest(read_document(path, _SOURCE_MOST))
    if os.environ.get(CONSENT) != ALL:
        os.environ[CONSENT] = digest


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _known() -> set[str]:
    try:
        lines = read_document(_known_path()).decode(errors="replace").splitlines()
    except OSError:
        return set()
    return {line.split(" ", 1)[0] for line in lines}


def _known_path() -> Path:
    folder = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(folder).expanduser() / "groundstation" / "trusted_effects"


# A user's own effects beside the listed ones.
#
# A user's file (``--effects FILE``, or a model's ``source``) defines any number at its top level.
# Whoever flies a model with a source runs that file, as with any Python program: only one that is
# known, or consented to (``groundstation.dynamics.craft``).


@cache
def load_effects(path: str | Path) -> Mapping[str, Effect]:
    """The effects that a Python file defines at its top level, by name.

    Raises BadInputError where the file may not or cannot be run, defines none, takes a listed
    name, or defines one whose law cannot be compiled.
    """
    try:
        found: dict[str, Any] = {"__name__": "effects", "__file__": str(path)}
        exec(compile(trusted_source(Path(path)), str(path), "exec"), found)
    except BadInputError:
        raise
    except FileNotFoundError as error:
        raise BadInputError(f"effect file {path}: no such file; correct the path") from error
    except Exception as error:  # whatever a user's file raises is said as it is
        raise BadInputError(f"effect file {path}: {type(error).__name__}: {error}") from error
    theirs = {value.name: value for value in found.values() if isinstance(value, Effect)}
    if not theirs:
        raise BadInputError(f"effect file {path}: defines no Effect; see docs/simulate.md")
    for effect in theirs.values():
        if effect.name in EFFECTS:
            raise BadInputError(f"effect file {path}: {effect.name} is built in; rename yours")
        _require_law(effect, path)
    return theirs


def find_effect(name: str, source: str | Path = "") -> Effect:
    """An effect by name: listed, or from the user's file ``source``.

    Raises BadInputError with the names there are.
    """
    known = load_effects(source) if source else EFFECTS
    if name not in known:
        where = f" in {source}" if source else ""
        raise BadInputError(f"effect {name!r}: there are{where} {', '.join(known)}")
    return known[name]


def _require_law(effect: Effect, path: str | Path) -> None:
    """Raises BadInputError for an effect that cannot be flown."""
    where = f"effect file {path}: {effect.name}"
    if not callable(effect.law):
        raise BadInputError(f"{where} has no law")
    if effect.stage not in get_args(Stage):
        raise BadInputError(
            f"{where}: stage {effect.stage!r}; there are {', '.join(get_args(Stage))}"
        )
    if effect.states and effect.stage not in ("body", "sensor"):
        raise BadInputError(f"{where}: only an effect of the body or a sensor may have states")
    if effect.stage in COMPILED:
        from groundstation.dynamics.chains import own_address

        own_address(effect.stage, (effect,), (0,))


# The numbers that the compiled models fly: one record per craft.


ACTS = (*COMPILED, "velocity")
"""Whether any effect acts at a stage, and whether one reads the velocity."""
STATEFUL: tuple[Stage, ...] = ("body", "sensor")
LISTED_STATES = {stage: sum(len(effect.states) for effect in at_stage(stage)) for stage in STATEFUL}
SENSOR_STATES = LISTED_STATES["sensor"] + STATE_SLOTS
"""Room for what sensors' effects remember."""
CRAFT = np.dtype(
    [
        # as ``effect.Craft``
        ("mass", "f8"),
        ("gravity", "f8"),
        ("inertia", "f8", (3,)),
        ("thrust", "f8"),
        ("drag", "f8"),
        ("rotor_x", "f8", (4,)),
        ("rotor_y", "f8", (4,)),
        ("a0", "f8", (4,)),
        ("a1", "f8", (4,)),
        ("a2", "f8", (4,)),
        ("winding_ohm", "f8"),
        ("back_emf_mv", "f8", (4,)),
        # 1 where the effect acts, then its parameters
        *(
            (e.name, "f8", (1 + len(e.parameters),))
            for e in EFFECTS.values()
            if e.stage in COMPILED
        ),
        *((f"acts_{stage}", "i8") for stage in ACTS),
        ("own", "i8", (len(COMPILED),)),  # addresses of a user's own effects by stage, 0: none
        ("own_values", "f8", (VALUE_SLOTS,)),
        # states of effects, 0 where none has one; at the body they follow its 17
        ("body_states", "i8"),
        ("sensor_states", "i8"),
        ("body_initial", "f8", (LISTED_STATES["body"] + STATE_SLOTS,)),
        ("body_made", "f8", (LISTED_STATES["body"] + STATE_SLOTS,)),  # the same of a made flight
        ("body_noise", "f8", (LISTED_STATES["body"] + STATE_SLOTS,)),  # standard deviation, or 0
        ("body_inertial", "i8", (LISTED_STATES["body"] + STATE_SLOTS,)),  # 1: x, 2: y, 0: neither
        ("sensor_initial", "f8", (SENSOR_STATES,)),
        ("follows", "i8", (SENSOR_STATES,)),  # gyro 0-2, force 3-5, or -1
        # of an effect that turns reported angles: the angle 0-2, 3 for its other states, else -1
        ("turns", "i8", (SENSOR_STATES,)),
        ("turning", "i8"),  # 1 where there is one
        ("fastest", "f8"),  # 1/s, of the sensor states
    ]
)
"""Units SI but rotor speed in rev/s and motor constants as in ``MotorConstants``."""

Crafts = NDArray[np.void]
"""Records of ``CRAFT``, shape (m,): a batch over parameters."""
Acting = tuple[Effect, dict[str, float]]
"""An effect and the values of all its parameters."""


def first_state(name: str) -> int:
    """Where the states of a listed effect begin among those of its stage."""
    listed = at_stage(EFFECTS[name].stage)
    before = listed[: [effect.name for effect in listed].index(name)]
    return sum(len(effect.states) for effect in before)


def craft_of_vehicle(
    vehicle: Vehicle, effects: Mapping[str, Mapping[str, float]] | None = None
) -> Crafts:
    """A profile as a record, shape (1,), with listed effects by name and parameters."""
    record = np.zeros(1, CRAFT)
    craft = record[0]
    craft["mass"], craft["gravity"] = vehicle.mass_kg, STANDARD_GRAVITY
    craft["inertia"] = vehicle.inertia_kg_m2
    craft["thrust"], craft["drag"] = vehicle.thrust_n, vehicle.drag_n_m
    places = rotor_positions_m(vehicle)
    craft["rotor_x"], craft["rotor_y"] = [x for x, _ in places], [y for _, y in places]
    _put_motors(craft, (vehicle.motor,) * 4)
    craft["winding_ohm"] = vehicle.winding_ohm
    add_effects(craft, _named(effects or {}))
    return record


def _named(effects: Mapping[str, Mapping[str, float]]) -> list[Acting]:
    return [(EFFECTS[name], EFFECTS[name].values(given)) for name, given in effects.items()]


def craft_of_motors(
    motor: MotorConstants | Motors, effects: Mapping[str, Mapping[str, float]]
) -> Crafts:
    """Motors alone as a record, shape (1,), with listed effects by name and parameters."""
    record = np.zeros(1, CRAFT)
    _put_motors(record[0], (motor,) * 4 if isinstance(motor, MotorConstants) else motor)
    record["mass"], record["inertia"], record["winding_ohm"] = 1.0, 1.0, 1.0  # nothing turns
    add_effects(record[0], _named(effects))
    return record


def craft_of_laws(effects: Sequence[Acting]) -> Crafts:
    """Effects alone as a record, shape (1,), in which all of them act like a user's own."""
    record = np.zeros(1, CRAFT)
    record["follows"] = record["turns"] = -1
    by_stage: dict[str, list[Acting]] = {}
    for one in effects:
        by_stage.setdefault(one[0].stage, []).append(one)
    _put_own(record[0], by_stage)
    for stage in STATEFUL:
        _put_states(record[0], stage, by_stage.get(stage, ()))
    return record


def craft_of_model(model: Model) -> Crafts:
    """What was identified, shape (1,): the base model, and its effects within the equations of
    motion. (Delay and attitude filter are in ``dynamics/sensors.py``.)

    A model knows ratios only (c0 = k l / Ixx and so on). The mass and the ratio of Izz to
    Ixx + Iyy are the profile's; everything that can be observed follows from the model.

    Raises BadInputError where the model has no body, or an effect that does not exist.
    """
    vehicle, body = model_vehicle(model), require_body(model)
    record = craft_of_vehicle(vehicle)
    craft = record[0]
    thrust = vehicle.mass_kg * body.thrust_per_mass
    ixx, iyy = (thrust * lever_arm_m(vehicle) / c for c in (body.c0, body.c1))
    izz = vehicle.inertia_kg_m2[2] / sum(vehicle.inertia_kg_m2[:2]) * (ixx + iyy)
    craft["inertia"] = ixx, iyy, izz
    craft["thrust"], craft["drag"] = thrust, body.c2 * izz
    _put_motors(craft, rotor_motors(model))
    add_effects(craft, acting(model))
    return record


def acting(model: Model) -> list[Acting]:
    """The effects of a model that are not absent, and its disturbance.

    Raises BadInputError for one that does not exist, or a value that cannot be flown.
    """
    found = []
    for term in model.effects:
        effect = find_effect(term.name, term.source)
        values = effect.values({name: one.value for name, one in term.parameters.items()})
        if not effect.absent(values):
            found.append((effect, values))
    slow = model.disturbance
    if slow is not None:
        numbers = (*slow.moments, *slow.forces, slow.time_s)
        names = (one.name for one in DISTURBANCE.parameters)
        found.append((DISTURBANCE, DISTURBANCE.values(dict(zip(names, numbers, strict=True)))))
    return found


def add_effects(craft: np.void, effects: list[Acting]) -> None:
    """Let effects act in a record.

    A second one of a name (another weak rotor) acts like a user's own.

    Raises BadInputError where the own ones have too many parameters or states.
    """
    own: dict[str, list[Acting]] = {}
    craft["follows"] = craft["turns"] = -1
    for effect, values in effects:
        if effect.stage not in COMPILED:
            continue
        listed = EFFECTS.get(effect.name) is effect and craft[effect.name][0] == 0.0
        if listed:
            craft[effect.name] = [1.0, *values.values()]
        else:
            own.setdefault(effect.stage, []).append((effect, values))
        craft[f"acts_{effect.stage}"] = 1
        if "velocity" in effect.unmeasured or not listed:
            craft["acts_velocity"] = 1
        if effect.fastest is not None:
            craft["fastest"] = max(craft["fastest"], effect.fastest(values))
    _put_own(craft, own)
    for stage in STATEFUL:
        _put_states(craft, stage, own.get(stage, ()))


def _put_own(craft: np.void, own: Mapping[str, list[Acting]]) -> None:
    numbers: list[float] = []
    for stage, theirs in own.items():
        from groundstation.dynamics.chains import own_address

        first = []
        for _, values in theirs:
            first.append(len(numbers))
            numbers += values.values()
        if len(numbers) > VALUE_SLOTS:
            raise BadInputError(
                f"its own effects have {len(numbers)} parameters, at most {VALUE_SLOTS} can act"
            )
        effects = tuple(effect for effect, _ in theirs)
        craft["own"][COMPILED.index(stage)] = own_address(stage, effects, tuple(first))
    craft["own_values"][: len(numbers)] = numbers


def _put_states(craft: np.void, stage: Stage, own: Sequence[Acting]) -> None:
    """Where the states of a stage begin, and how many there are to integrate."""
    listed = [effect for effect in at_stage(stage) if effect.states]
    every = [(effect, bool(craft[effect.name][0]), _given(craft, effect)) for effect in listed]
    every += [(effect, True, values) for effect, values in own]
    remembered = [
        (effect, state, there, values) for effect, there, values in every for state in effect.states
    ]
    theirs = sum(len(effect.states) for effect, _ in own)
    if theirs > STATE_SLOTS:
        raise BadInputError(f"its own effects have {theirs} states, at most {STATE_SLOTS} can act")
    if own:  # their chain has room for as many states as may be, whether they have any or not
        craft[f"{stage}_states"] = LISTED_STATES[stage] + STATE_SLOTS
    elif any(craft[effect.name][0] for effect in listed):
        craft[f"{stage}_states"] = LISTED_STATES[stage]
    for place, (effect, state, there, values) in enumerate(remembered):
        craft[f"{stage}_initial"][place] = state.initial
        if stage == "body":
            craft["body_made"][place] = state.initial if state.made is None else state.made
        if there and stage == "body":
            craft["body_noise"][place] = values[state.noise] if state.noise else state.moving
            craft["body_inertial"][place] = ("", "x", "y").index(state.inertial)
        # An observer takes the last that follows a channel for what the sensor shows of it.
        if there and state.follows is not None and stage == "sensor":
            craft["follows"][place] = (*GYRO, *FORCE).index(state.follows)
        if there and effect.role is Role.ESTIMATE:
            craft["turns"][place] = (*ANGLES, "").index(state.turns)
            craft["turning"] = 1


def _given(craft: np.void, effect: Effect) -> dict[str, float]:
    """A listed effect's parameters as a record has them."""
    names = (one.name for one in effect.parameters)
    return dict(zip(names, craft[effect.name][1:].tolist(), strict=True))


def _put_motors(craft: np.void, motors: Motors) -> None:
    for name in ("a0", "a1", "a2"):
        craft[name] = [getattr(one, name) for one in motors]
    craft["back_emf_mv"] = [one.a1 / one.a0 for one in motors]
