"""Joystick and battery over time as inputs of the whole loop (thesis 8.2.1, 8.2.3).

The thesis's joystick block is constants; here it is a CSV file, or what was sent and measured in a
recorded flight.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from groundstation.control.pid import AXES, PidGains
from groundstation.control.step_analysis import is_flown
from groundstation.control.thesis_loop import SUPPLY_MV, WholeResponse, body_of, run_whole
from groundstation.dynamics.mixer import PWM_FULL
from groundstation.dynamics.model import Model
from groundstation.dynamics.reference import LONGEST_S, STEEPEST_RAD, read_rows
from groundstation.errors import BadInputError
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

if TYPE_CHECKING:
    from groundstation.recording.session import Recording

Array = NDArray[np.float64]
LEAST_V, MOST_V = 2.5, 20.0
FURTHEST_DEG = 160.0
LOST_RAD = np.radians(85.0)


@dataclass(frozen=True, slots=True)
class Joystick:
    """Rows 2 ms apart. attitude: (k, 3) rad roll, pitch (nose down), yaw. thrust: (k,) PWM counts,
    None for what carries the craft at each battery voltage. supply_mv: (k,)."""

    name: str
    attitude: Array
    thrust: Array | None
    supply_mv: Array


@dataclass(frozen=True, slots=True)
class Followed:
    """What the whole loop made of a joystick."""

    inputs: Joystick
    response: WholeResponse

    def as_dict(self) -> dict[str, Any]:
        """For ``pid evaluate --inputs --json``."""
        pwm = self.response.pwm
        error = np.degrees(self.inputs.attitude - self.response.angles)
        return {
            "inputs": self.inputs.name,
            "seconds": len(pwm) * SAMPLE_PERIOD_S,
            "battery_v": [float(v) / 1e3 for v in np.quantile(self.inputs.supply_mv, (0.0, 1.0))],
            "at_stops_pct": 100.0 * float(((pwm <= 0) | (pwm >= PWM_FULL)).any(axis=1).mean()),
            "axes": {
                axis: {
                    "rms_deg": float(np.sqrt(np.mean(error[:, index] ** 2))),
                    "largest_deg": float(np.abs(error[:, index]).max()),
                }
                for index, axis in enumerate(AXES)
            },
        }


def follow(
    model: Model, gains: Mapping[str, PidGains], inputs: Joystick, delay: int | None = None
) -> Followed:
    """Fly a joystick on the whole loop; axes without gains are left alone.

    Raises BadInputError where the craft is lost: it lies on its side, or no number is left.
    """
    three = [gains.get(axis, PidGains(0.0)) for axis in AXES]
    response = run_whole(
        model, three, inputs.attitude, body_of(model), delay=delay, thrust=inputs.thrust,
        supply_mv=inputs.supply_mv,
    )  # fmt: skip
    lost = ~(np.abs(response.angles[:, :2]) < LOST_RAD).all(axis=1)
    if lost.any():
        raise BadInputError(
            f"inputs {inputs.name}: the craft is lost after"
            f" {float(np.argmax(lost)) * SAMPLE_PERIOD_S:.2f} s with these gains"
        )
    return Followed(inputs, response)


def load_joystick(path: Path) -> Joystick:
    """A CSV file: ``time_s``, ``roll_deg``, ``pitch_deg``, ``yaw_deg``, and if wanted ``thrust``
    (0 to 1) and ``battery_v``, linear between its rows.

    Raises BadInputError naming what is wrong.
    """
    table, names = read_rows(path, ("thrust", "battery_v"))
    time = table[:, 0] - table[0, 0]
    grid = np.arange(0.0, time[-1], SAMPLE_PERIOD_S)
    given = {n: np.interp(grid, time, table[:, at]) for at, n in enumerate(names)}
    attitude = np.radians(np.column_stack([given[f"{axis}_deg"] for axis in AXES]))
    thrust = given.get("thrust")
    if thrust is not None and not ((thrust >= 0.0) & (thrust <= 1.0)).all():
        raise BadInputError(f"inputs {path}: thrust is a share of full, 0..1")
    supply = given.get("battery_v", np.full(len(grid), SUPPLY_MV / 1e3))
    counts = None if thrust is None else PWM_FULL * thrust
    return _checked(Joystick(path.name, attitude, counts, 1e3 * supply), str(path))


def joystick_of_recording(recording: Recording) -> Joystick:
    """Setpoints that were sent in a recorded flight, and the battery that was reported.

    From the first thrust to the last; yaw's rate is summed up to an angle, and angles are held from
    one setpoint to the next. Thrust is what carries the craft, for that which was sent was for
    another one. Raises BadInputError where nothing was commanded.
    """
    where = Path(recording.path).name
    sent = [
        (e["time_ns"], e["roll_deg"], e["pitch_deg"], e["yaw_dps"], is_flown(e))
        for e in recording.commands
        if e.get("kind") == "setpoint"
    ]
    flown = [at for at, row in enumerate(sent) if row[4]]
    if len(flown) < 2:
        raise BadInputError(
            f"inputs {where}: no setpoints that fly; give a flight of 'pid fly', or a CSV file"
            " with time_s, roll_deg, pitch_deg, yaw_deg"
        )
    table = np.array(sent[flown[0] : flown[-1] + 1], np.float64)
    time = (table[:, 0] - table[0, 0]) * 1e-9
    grid = np.arange(0.0, min(time[-1], LONGEST_S), SAMPLE_PERIOD_S)
    held = np.radians(table[np.searchsorted(time, grid, side="right") - 1, 1:4])
    yaw = np.cumsum(held[:, 2]) * SAMPLE_PERIOD_S
    samples = recording.samples
    known = np.isfinite(samples.battery_v)
    if not known.any():
        raise BadInputError(f"inputs {where}: the recording has no battery voltage")
    reported = (samples.host_time_ns[known] - table[0, 0]) * 1e-9
    battery = np.interp(grid, reported, samples.battery_v[known])
    attitude = np.column_stack([held[:, :2], yaw])
    return _checked(Joystick(where, attitude, None, 1e3 * battery), where)


def _checked(inputs: Joystick, where: str) -> Joystick:
    steepest = float(np.abs(inputs.attitude[:, :2]).max())
    if steepest > STEEPEST_RAD:
        raise BadInputError(
            f"inputs {where}: a tilt of {np.degrees(steepest):.0f} deg; at most"
            f" {np.degrees(STEEPEST_RAD):.0f} can be flown"
        )
    furthest = float(np.degrees(np.abs(inputs.attitude[:, 2]).max()))
    if furthest > FURTHEST_DEG:
        raise BadInputError(
            f"inputs {where}: yaw goes to {furthest:.0f} deg, {FURTHEST_DEG:g} is the most to"
            " either side: the loop's angle begins anew there"
        )
    volts = inputs.supply_mv / 1e3
    if not ((volts >= LEAST_V) & (volts <= MOST_V)).all():
        raise BadInputError(f"inputs {where}: battery_v must be {LEAST_V:g}..{MOST_V:g} V")
    return inputs
