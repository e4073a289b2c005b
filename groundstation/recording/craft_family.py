"""Which Crazyflie a file is from, as far as its names and ranges tell.

A file that was not made here does not name its craft. What it holds may still exclude the Crazyflie
1.0, whose profile is the default: ``family_of`` says so, and ``fit`` and the others then ask.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np

from groundstation.errors import BadInputError
from groundstation.recording.session import Recording
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch

if TYPE_CHECKING:
    from groundstation.dynamics.model import Model

TODAY = "2.x"
"""A Crazyflie 2.x or Brushless; which of them, no log says."""
UNKNOWN = "unknown"

_TODAYS_GROUPS = frozenset(
    {"stateEstimate", "stateEstimateZ", "kalman", "ctrltarget", "controller", "rpm", "pwm"}
)
"""Groups of log variables that the firmware of 2014 does not have."""
_TODAYS_NAMES = frozenset({"pm.vbatMV", "motor.m1req", "motor.m1_rpm"})
_MOST_G_OF_1 = 8.0 * np.sqrt(3.0) * 1.01
"""The 1.0 measures to 8 g an axis, a 2.x to 24 g."""


def family_of(names: Collection[str], samples: SampleBatch) -> dict[str, str]:
    """The ``vehicle`` metadata of a file that names no craft: its family, and why.

    names: variables or columns as the file spells them.
    """
    by_name = sorted(
        name
        for name in names
        if (name.split(".")[0] in _TODAYS_GROUPS and "." in name) or name in _TODAYS_NAMES
    )
    if by_name:
        return {"family": TODAY, "because": f"only a 2.x logs {by_name[0]}"}
    force = samples.accelerometer[np.isfinite(samples.accelerometer).all(axis=1)]
    most_g = float(np.linalg.norm(force, axis=1).max(initial=0.0)) / STANDARD_GRAVITY
    if most_g > _MOST_G_OF_1:
        return {"family": TODAY, "because": f"{most_g:.0f} g are beyond a 1.0's sensor"}
    return {"family": UNKNOWN, "because": "the file does not say"}


def vehicle_of(
    recordings: Sequence[Recording], given: str | None, model: Model | None = None
) -> str | None:
    """The profile that the user gave, or the one that the recordings name; None where neither does.

    model: what their craft is taken for where nobody names it.

    Raises BadInputError where they name several, or where one may be of another craft than the
    model's, than crazyflie1 without a model.
    """
    if given is not None:
        return given
    said = {one.path.name: one.metadata.get("vehicle", {}).get("profile") for one in recordings}
    labels = {label for label in said.values() if label is not None}
    if len(labels) > 1:
        listed = ", ".join(f"{name} of {label!r}" for name, label in said.items() if label)
        raise BadInputError(
            f"recordings of several vehicles ({listed}); fit one at a time, or, if a label is"
            " wrong, say --vehicle"
        )
    label = labels.pop() if labels else None
    for one in recordings:
        require_family(one, label or (model.vehicle if model is not None else None), model)
    return label


def require_family(recording: Recording, vehicle: str | None, model: Model | None = None) -> None:
    """Raises BadInputError where a recording that names no craft cannot be, or need not be, one of
    ``vehicle`` (None: nobody said which), whose profile ``model`` may hold.

    A profile of the user's own is the user's word on what flew: only a built-in one says whose
    firmware its craft has, and can contradict."""
    from groundstation.dynamics.model import model_vehicle
    from groundstation.dynamics.vehicle import BUILT_IN, load_vehicle

    said = recording.metadata.get("vehicle", {})
    if "family" not in said or "profile" in said:
        return
    family, why = said["family"], said.get("because", "")
    listed = ", ".join(
        name for name, one in BUILT_IN.items() if family == "unknown" or one.firmware == family
    )
    if vehicle is None:
        what = "its craft is not known" if family == "unknown" else f"of a Crazyflie {family}"
        raise BadInputError(
            f"{recording.path}: {what} ({why}); say which with --vehicle {listed}, or a TOML"
            " profile"
        )
    if model is not None and model.vehicle == vehicle:
        flown = model_vehicle(model)
    else:
        flown = load_vehicle(vehicle)
    if flown.name not in BUILT_IN:
        return
    if family != "unknown" and flown.firmware != family:
        raise BadInputError(
            f"{recording.path}: of a Crazyflie {family} ({why}), not of {vehicle!r}; say which"
            f" with --vehicle {listed}, or a TOML profile"
        )


def require_craft_of(recording: Recording, model: Model) -> None:
    """Raises BadInputError where a recording says, or shows, that it is of another vehicle than the
    model's."""
    recorded = recording.metadata.get("vehicle", {}).get("profile", model.vehicle)
    if recorded != model.vehicle:
        raise other_vehicle(recording.path.name, recorded, model)
    require_family(recording, model.vehicle, model)


def other_vehicle(what: str, recorded: str, model: Model) -> BadInputError:
    """What to say where ``what`` is of another vehicle than the model."""
    return BadInputError(
        f"{what}: the vehicle is {recorded!r}, the model is for {model.vehicle!r}; fit a model to"
        f" this vehicle, or, if the recording's label is wrong, say --vehicle {model.vehicle}"
    )
