"""Where the parts of a model come from: fitted, of a vehicle's profile, or given by hand.

A fit of the motor or of ARX polynomials leaves the profile's body in its file. Nobody measured that
body: on the stand-in it is even the truth. ``Model.origin`` says so part by part, and what needs a
fitted body refuses one that is not.
"""

from __future__ import annotations

import msgspec

from groundstation.dynamics.model import BodyConstants, Model, model_vehicle
from groundstation.errors import BadInputError

FITTED, PROFILE, GIVEN = "fitted", "profile", "given"
PARTS = ("motor", "body", "arx")
BODY = ("c0", "c1", "c2", "thrust_per_mass")


def origin_of(model: Model) -> dict[str, str]:
    """Part -> fitted, profile or given, for the parts that the model has.

    What the file does not say follows from the account of its fits; what is in none of them is the
    profile's where it is equal to it to the last digit, else given.
    """
    found = {}
    for part in PARTS:
        if getattr(model, part) is not None:
            found[part] = model.origin.get(part) or _assumed(model, part)
    return found


def with_origin(model: Model) -> Model:
    """The model with its parts' origins in it, as a fit writes them."""
    origin = origin_of(model)
    for part in PARTS:
        if part in model.fit:
            origin[part] = FITTED
    for name in model.fit.get("body", {}).get("not_identified", ()):
        if name in BODY:
            origin[f"body.{name}"] = PROFILE
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
    of = f"those of the profile {model.vehicle!r}, not fitted"
    parts = {"motor": "motor constants", "body": "body constants"}
    found = []
    if not model.origin and model.fit and model.body is not None and "body" not in model.fit:
        equal = " (they equal the profile's)" if _assumed(model, "body") == PROFILE else ""
        found.append(
            "made before files said what was fitted: its body constants are taken as fitted" + equal
        )
    found += [f"{words} are {of}" for part, words in parts.items() if _profiles(model, part)]
    single = [name for name in BODY if model.origin.get(f"body.{name}") == PROFILE]
    if single and not _profiles(model, "body"):
        found.append(f"{', '.join(single)}: {of}")
    return found


def _profiles(model: Model, part: str) -> bool:
    return model.origin.get(part) == PROFILE


def _assumed(model: Model, part: str) -> str:
    if part in model.fit:
        return FITTED
    vehicle = model_vehicle(model)
    c0, c1, c2 = vehicle.body_constants
    of_profile = {
        "motor": vehicle.motor,
        "body": BodyConstants(c0, c1, c2, vehicle.thrust_per_mass),
    }
    return PROFILE if getattr(model, part) == of_profile.get(part) else GIVEN
