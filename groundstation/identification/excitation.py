"""What a recording can tell, known before anything is fitted: Jacobian and expected noise.

The slopes of the predictions by each parameter come from the recorded inputs and the profile's
constants; the noise they stand against is what all of them together leave to first order. Together
they say how uncertain each parameter will be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.registry import DELAY, EFFECTS
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.body.certainty import between_rows
from groundstation.identification.body.fit import fit_thrust
from groundstation.identification.body.judgement import UNKNOWN, WELL_KNOWN, require_usable
from groundstation.identification.body.setup import (
    CONSTANTS,
    PACE,
    SPIN_UP,
    SUPPLY_EFFECTS,
    Setup,
    reported_name,
    require_known,
    set_up,
)
from groundstation.identification.estimate import inverse
from groundstation.identification.likelihood.free_spectra import reweighted, smoothed
from groundstation.identification.likelihood.parameters import KEYS
from groundstation.identification.motor.fit import UNKNOWN as MOTOR_UNKNOWN
from groundstation.identification.motor.fit import WELL_KNOWN as MOTOR_WELL_KNOWN
from groundstation.identification.motor.fit import first_constants
from groundstation.identification.motor.fit import require_usable as require_motor_runs
from groundstation.identification.motor.problem import MotorProblem, MotorRun, robust_spread
from groundstation.identification.stretches import Stretch

Array = NDArray[np.float64]

MOVES = {
    "c0": ("roll", "fly roll doublets of 10 degrees and more, several a second"),
    "c1": ("pitch", "fly pitch doublets of 10 degrees and more, several a second"),
    "c2": ("yaw", "fly yaw steps of 60 degrees both ways, several in ten seconds"),
}


@dataclass(frozen=True, slots=True)
class Excitation:
    """What a fit may expect.

    names, expected, stderr: (p,) parameters, their expected size (the profile's constants, an
    effect's usual size) and predicted standard errors. lines: what will be uncertain, and what
    to do about it.
    """

    names: tuple[str, ...]
    expected: Array
    stderr: Array
    lines: tuple[str, ...]

    @property
    def share(self) -> Array:
        """Predicted standard error over expected size, (p,)."""
        return self.stderr / np.maximum(np.abs(self.expected), 1e-300)

    def as_dict(self) -> dict[str, Any]:
        """For the model file."""
        return {"names": list(self.names), "expected_stderr_percent": (100 * self.share).tolist()}


def body_excitation(
    stretches: Sequence[Stretch],
    vehicle: Vehicle,
    effects: Sequence[str] = (),
    tie_roll_pitch: bool = False,
) -> Excitation:
    """How well stretches can tell the body's constants and the effects fitted along.

    Raises BadInputError where a constant is beyond hope, saying what to fly.
    """
    require_known(effects)
    require_usable(stretches, vehicle)
    acting = tuple(name for name in effects if name not in SUPPLY_EFFECTS)
    setup = set_up(stretches, vehicle, vehicle.thrust_per_mass, acting, tie_roll_pitch)
    told = [i for i, key in enumerate(setup.keys) if key not in setup.nuisances]
    stderr = _expected_stderr(setup)[told]
    keys = {one.key: one for way in setup.variants for one in way}
    told_names: list[str] = []
    worth: list[float] = []
    for key in (setup.keys[i] for i in told):
        told_names.append(reported_name(keys[key]) if key in keys else key)
        worth.append(keys[key].worth if key in keys else vehicle.body_constants[int(key[1])])
    found = Excitation(tuple(told_names), np.array(worth), stderr, ())
    lines: list[str] = []
    hopeless: list[str] = []
    for name, share in zip(found.names, found.share, strict=True):
        effect, dot, _parameter = name.partition(".")
        if dot and share > UNKNOWN:
            lines.append(
                f"{effect} hardly shows here: {name} will be uncertain by {_percent(share)} of"
                f" its usual size; fly {EFFECTS[effect].excited_by}"
            )
        elif not dot and share > WELL_KNOWN:
            axis, manoeuvre = MOVES[name]
            text = (
                f"{axis} is hardly excited: {name} will be uncertain by {_percent(share)};"
                f" {manoeuvre}"
            )
            (hopeless if share > UNKNOWN else lines).append(text)
    if hopeless:
        names = ", ".join(sorted({stretch.run.name for stretch in stretches}))
        raise BadInputError(f"{names}: {'; '.join(hopeless)}")
    return Excitation(found.names, found.expected, stderr, tuple(lines))


def flight_excitation(stretches: Sequence[Stretch], vehicle: Vehicle) -> dict[str, float]:
    """What a flight can tell of each constant, however little: the expected standard error of c0,
    c1, c2, thrust_per_mass and motor_pace over its size.

    motor_pace: by which all of a0, a1, a2 may be multiplied (``motor_pace`` of the body fit); not
    there where rotor speeds are measured, nor thrust_per_mass without an accelerometer.

    Raises BadInputError for stretches without torque or motion.
    """
    require_usable(stretches, vehicle)
    setup = set_up(stretches, vehicle, vehicle.thrust_per_mass, ())
    # Without what every craft has, its residual would pass for noise just where an axis is excited.
    usual = {key: KEYS[key].worth for key in (DELAY, SPIN_UP) if key in setup.nuisances}
    setup = replace(setup, start={**setup.start, **usual})
    beside = between_rows(setup)
    found = {
        name: float(np.hypot(stderr / abs(size), beside.get(name, 0.0)))
        for name, stderr, size in zip(
            CONSTANTS, _expected_stderr(setup), vehicle.body_constants, strict=False
        )
    }
    if any(flight.has_accelerometer for flight in setup.problem.flights):
        thrust, stderr = fit_thrust(setup, setup.start)
        found["thrust_per_mass"] = stderr / abs(thrust)
    if stretches[0].motor is not None:
        paced = setup.for_pace()
        found["motor_pace"] = float(_expected_stderr(paced)[paced.keys.index(PACE)])
    return found


def _expected_stderr(setup: Setup) -> Array:
    """Standard errors (p,) of a setup's keys: the Jacobian where the fit starts, beside the noise
    that all of them together leave to first order."""
    limits = setup.limits()
    linear = setup.linearise(setup.start)
    first = smoothed(linear.spectra, [s.residual for s in linear.spectra])
    _, normal, _ = reweighted(linear, first, -limits.step, limits.step)
    return np.asarray(np.sqrt(np.diag(inverse(normal))))


def motor_excitation(runs: Sequence[MotorRun]) -> Excitation:
    """How well runs can tell a0, a1, a2.

    Raises BadInputError where one of them is beyond hope.
    """
    require_motor_runs(runs)
    problem = MotorProblem(runs)
    theta = problem.theta(first_constants(runs))
    readings = [run.rev_s[np.isfinite(run.rev_s)] for run in runs]
    # Second differences hold noise, not motion: their variance is six times one reading's.
    spread = robust_spread(np.concatenate([np.diff(one, 2) for one in readings])) / np.sqrt(6)
    weights = [np.isfinite(run.rev_s) / spread**2 for run in runs]
    jacobian = problem.jacobian(weights, theta)
    stderr = np.sqrt(np.diag(inverse(jacobian.T @ jacobian)))[:3]
    names = ("a0", "a1", "a2")
    found = Excitation(names, theta[:3], stderr, ())
    lines = [
        f"{name} is hardly excited: it will be uncertain by {_percent(share)} or more; vary the"
        " thrust over a wider range, from 30 to 90 % duty"
        for name, share in zip(names, found.share, strict=True)
        if share > MOTOR_WELL_KNOWN
    ]
    if found.share[:2].max() > MOTOR_UNKNOWN:
        raise BadInputError(f"{', '.join(run.name for run in runs)}: {'; '.join(lines)}")
    return Excitation(names, theta[:3], stderr, tuple(lines))


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share < 10 else "many times its size"
