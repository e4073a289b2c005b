"""Recordings that a model cannot be held against, refused in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.discrepancy.gap import AheadErrors
from groundstation.dynamics.model import Model, model_vehicle
from groundstation.errors import BadInputError
from groundstation.identification.runs import Run

Array = NDArray[np.float64]

LEAST_FLIGHT_S = 3.0
WINDOW_S = 0.05
"""Over which a torque's answer is judged: longer than any delay of a sensor that still flies."""
CROSSED = 0.4
"""Answer of roll to pitch torque, and the reverse of pitch to roll torque, from which the rotors
sit elsewhere: by 45 degrees it is the axes' own answer. A craft whose own answers are small
(blade flapping pushes back within 50 ms) is no reason to refuse."""
OWN = (-CROSSED, 5.0)
"""Least and greatest answer to an axis's own torque. A gain that is far too small in a model may
come from a fit to flights with a lasting torque, which a smaller gain explains: beyond the upper
limit the profile's gain decides."""
THRUST = (0.5, 2.0)
"""What another craft's answer and thrust are beyond: no effect in the list goes so far."""


def require_channels(runs: Sequence[Run]) -> None:
    """Raises BadInputError where a channel that nothing works without is missing throughout."""
    needed = {
        "gyro": "the gyro",
        "duty": "the motors' PWM",
        "supply_v": "the battery voltage",
    }
    for run in runs:
        for name, what in needed.items():
            if not np.isfinite(getattr(run, name)).any(axis=0).all():
                raise BadInputError(
                    f"{run.name}: {what} is not in the recording; where a model and a flight"
                    " disagree cannot be told without it: record it"
                )


def require_body(model: Model) -> None:
    """Raises BadInputError for a model that cannot fly."""
    if model.body is None:
        raise BadInputError(
            f"model for {model.vehicle}: it has no body constants, only ARX polynomials;"
            " fit a body ('groundstation fit body')"
        )


def require_flight(errors: Sequence[AheadErrors]) -> None:
    """Raises BadInputError where hardly anything flies."""
    flown = sum(float(one.motion.flown.sum()) * one.run.period_s for one in errors)
    if flown < LEAST_FLIGHT_S:
        names = ", ".join(sorted({one.run.name for one in errors}))
        raise BadInputError(
            f"{names}: {flown:.1f} s in the air, at least {LEAST_FLIGHT_S:.0f} s are needed;"
            " record a flight"
        )


def require_vehicle(errors: Sequence[AheadErrors], model: Model) -> None:
    """Raises BadInputError where the craft that flew cannot be the model's.

    Its thrust would not carry it, or its rates answer to other axes' torques.
    """
    vehicle = model_vehicle(model)
    for one in errors:
        flown = one.motion.flown
        if flown.sum() * one.run.period_s < LEAST_FLIGHT_S:
            continue
        ratio = np.median(one.run.accelerometer[flown, 2]) / np.median(one.motion.thrust[flown])
        if np.isfinite(ratio) and not THRUST[0] < ratio < THRUST[1]:
            raise _other(one, model, f"its thrust is {ratio:.2f} of what the model says")
        gains = _answers(one)
        own = np.diag(gains)
        crossed = min(abs(gains[0, 1]), abs(gains[1, 0]))
        if crossed > CROSSED and gains[0, 1] * gains[1, 0] < 0:
            what = (
                "roll answers to pitch torque and pitch to roll torque (configuration"
                f" '{vehicle.configuration}' of the model: is the craft's another?)"
            )
            raise _other(one, model, what)
        known = own * np.minimum(1.0, _gains_of(model) / np.array(vehicle.body_constants))
        if not (OWN[0] < own.min() and known.max() < OWN[1]):
            listed = ", ".join(f"{value:.2f}" for value in own)
            raise _other(one, model, f"roll, pitch, yaw answer {listed} times as strongly")


def _gains_of(model: Model) -> Array:
    """c0, c1, c2 of the model, (3,)."""
    assert model.body is not None
    return np.array([model.body.c0, model.body.c1, model.body.c2])


def _answers(one: AheadErrors) -> Array:
    """Change of each rate over 50 ms per change that the model's torques make, (3, 3)."""
    period, flown = one.run.period_s, one.motion.flown
    rows = max(1, round(WINDOW_S / period))
    turned = np.cumsum(one.motion.torque, axis=0) * period
    both = flown[rows:] & flown[:-rows]
    said = (turned[rows:] - turned[:-rows])[both]
    done = (one.run.gyro[rows:] - one.run.gyro[:-rows])[both]
    said, done = said - said.mean(axis=0), done - done.mean(axis=0)
    return np.asarray(np.linalg.lstsq(said, done, rcond=None)[0].T)


def _other(one: AheadErrors, model: Model, why: str) -> BadInputError:
    return BadInputError(
        f"{one.run.name}: not flown by a {model.vehicle!r} as the model knows it: {why};"
        " fit a model to this vehicle"
    )
