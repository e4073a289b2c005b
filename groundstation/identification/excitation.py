"""What a recording can tell, known before anything is fitted: Jacobian and expected noise.

The slopes of the predictions by each parameter come from the recorded inputs and the profile's
constants; the noise they stand against is what a black-box predictor leaves, which knows past
outputs and inputs but no physics. Together they say how uncertain each parameter will be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.effects.catalogue import EFFECTS
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.body import UNKNOWN, WELL_KNOWN, require_usable
from groundstation.identification.body_problem import BodyProblem
from groundstation.identification.body_terms import SUPPLY_EFFECTS, BodyTerms, require_known
from groundstation.identification.estimate import inverse
from groundstation.identification.motor import UNKNOWN as MOTOR_UNKNOWN
from groundstation.identification.motor import WELL_KNOWN as MOTOR_WELL_KNOWN
from groundstation.identification.motor import first_constants
from groundstation.identification.motor import require_usable as require_motor_runs
from groundstation.identification.motor_problem import MotorProblem, MotorRun, robust_spread
from groundstation.identification.noise_model import NoiseModel
from groundstation.identification.stretches import Stretch

Array = NDArray[np.float64]

PAST_ROWS, INPUT_ROWS = 30, 20
"""How far the black-box predictor looks back at outputs and at inputs."""
MOST_ROWS = 20_000
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
    problem = BodyProblem(stretches, vehicle, vehicle.thrust_per_mass, acting, tie_roll_pitch)
    noise = expected_noise(stretches, vehicle)
    normal, _ = problem.normal_equations(problem.slopes(problem.first), problem.measured, noise)
    stderr = np.sqrt(np.diag(inverse(normal)))
    expected = np.array([_usual(name, vehicle) for name in problem.names])
    found = Excitation(problem.names, expected, stderr, ())
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
    return Excitation(found.names, expected, stderr, tuple(lines))


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
    normal, _, _ = problem.system(weights, theta)
    stderr = np.sqrt(np.diag(inverse(normal)))[:3]
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


def expected_noise(stretches: Sequence[Stretch], vehicle: Vehicle) -> list[NoiseModel]:
    """Per axis, the noise that no predictor from the past could know.

    Least squares of the measured acceleration on its own past and on the mixer's u', present
    and past; the part of the past outputs is the whitener.
    """
    unit = {"c0": 1.0, "c1": 1.0, "c2": 1.0}
    model = BodyTerms(vehicle, vehicle.thrust_per_mass)
    size = PAST_ROWS + INPUT_ROWS + 1
    normal, gradient = np.zeros((3, size, size)), np.zeros((3, size))
    square, rows = np.zeros(3), 0
    for stretch in stretches:
        if len(stretch) <= 2 * size or rows > MOST_ROWS:
            continue
        measured = np.diff(stretch.run.gyro[stretch.first - 1 : stretch.last], axis=0)
        measured = measured / stretch.run.period_s
        torque = model.acceleration(stretch, unit)
        first = max(PAST_ROWS, INPUT_ROWS)
        at = np.arange(first, min(len(stretch), first + MOST_ROWS))
        for axis in range(3):
            columns = [measured[at - i, axis] for i in range(1, PAST_ROWS + 1)]
            columns += [torque[at - j, axis] for j in range(INPUT_ROWS + 1)]
            matrix, target = np.column_stack(columns), measured[at, axis]
            normal[axis] += matrix.T @ matrix
            gradient[axis] += matrix.T @ target
            square[axis] += float(target @ target)
        rows += len(at)
    found = []
    for axis in range(3):
        weights = inverse(normal[axis]) @ gradient[axis]
        left = max(square[axis] - float(weights @ gradient[axis]), 1e-12 * square[axis])
        whitener = np.concatenate([[1.0], -weights[:PAST_ROWS]])
        found.append(NoiseModel(whitener, left / max(rows - size, 1)))
    return found


def _usual(name: str, vehicle: Vehicle) -> float:
    """The size a parameter would have on an ordinary craft."""
    effect, dot, parameter = name.partition(".")
    if not dot:
        return float(vehicle.body_constants[int(name[1])])
    if effect == "gyro_low_pass":
        return 1 / (2 * np.pi * EFFECTS[effect].parameter("bandwidth_hz").default)
    known = EFFECTS[effect].parameter(parameter)
    size = abs(known.default - known.absent)
    return size if size > 0.0 else 0.1 * known.high


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share < 10 else "many times its size"
