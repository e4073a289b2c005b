"""The motors of a PX4 quadrotor, from whichever topics a log has, in our order and as duty.

``actuator_motors`` (since 1.13) has the thrust that was asked for, each rotor's place in
``CA_ROTORn_PX`` and ``_PY``; ``THR_MDL_FAC`` f makes it the signal s: f s^2 + (1 - f) s. Before,
``actuator_outputs`` has what an output was told, an instance for each driver; most idle.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.recording.motor_columns import changes
from groundstation.recording.px4_outputs import crowd_of, motors_among, range_of
from groundstation.recording.series import Series
from groundstation.telemetry.arrays import Array

Parameters = Mapping[str, float]

NAME = "quadrotor_motors"
"""Of the series that is made, with columns m1 to m4: fractions of full duty."""
ORDER = (0, 3, 1, 2)
"""Ours (front right, rear right, rear left, front left) in the order of PX4's quadrotor x."""
BETAFLIGHT_ORDER = (1, 0, 2, 3)
"""The same where MOT_ORDERING is 1: rear right, front right, rear left, front left."""
QUADRANTS = ((1, 1), (-1, 1), (-1, -1), (1, -1))
"""Signs of forward and right of our rotors' places."""
SPINS = (1, -1, 1, -1)
"""Signs of CA_ROTORn_KM of our rotors: 1 and 3 turn counter-clockwise."""
MAV_TYPES = {
    **{1: "a fixed wing", 3: "a coaxial helicopter", 4: "a helicopter", 10: "a rover"},
    **{11: "a boat", 12: "a submarine", 13: "a hexarotor", 14: "an octorotor", 15: "a tricopter"},
    **dict.fromkeys((19, 20, 21, 22, 23, 24, 25), "a VTOL"),
}
"""Crafts by MAVLink's MAV_TYPE that are no quadrotor, which is 2."""
ASKED = (
    "the motors' duty is not known: actuator_motors is the thrust that was asked for, and the log"
    " has no THR_MDL_FAC, by which it becomes duty"
)


@dataclass(frozen=True, slots=True)
class Motors:
    """series: with columns m1 to m4, None where there are none. notes: what was settled. open: what
    was not, or why there are none; empty where all is known."""

    series: Series | None
    notes: tuple[str, ...] = ()
    open: str = ""


def motors_of(series: Sequence[Series], parameters: Parameters) -> Motors:
    """The motors of a log. parameters: of the craft, as far as the log has them."""
    if reason := _another_craft(parameters):
        return Motors(None, open=reason)
    asked = [one for one in _instances(series, "actuator_motors") if "control[3]" in one.columns]
    outputs = _instances(series, "actuator_outputs")
    told = _moved(outputs, "output")
    if asked:
        moved = _moved(asked, "control")
        if max(told, default=0) > 0 and (max(moved) <= 0 or "THR_MDL_FAC" not in parameters):
            motors = _of_outputs(outputs, parameters)
            if max(moved) <= 0 or (motors.series is not None and not motors.open):
                still = () if max(moved) > 0 else ("actuator_motors never moves",)
                return Motors(motors.series, (*still, *motors.notes), motors.open)
        return _of_thrust(asked, moved, parameters)
    return _of_outputs(outputs, parameters) if outputs else Motors(None)


def _instances(series: Sequence[Series], topic: str) -> list[Series]:
    return [one for one in series if re.fullmatch(rf"{topic}(\.\d+)?", one.name)]


def _moved(instances: Sequence[Series], field: str) -> list[int]:
    """How often the least busy of four columns changes, of each instance; -1 of one with fewer."""
    tables = [_numbered(one, field) for one in instances]
    return [int(np.sort(changes(one))[-4]) if one.shape[1] >= 4 else -1 for one in tables]


def _chosen(instances: Sequence[Series], moved: Sequence[int], what: str) -> str:
    """A note on the instance that moves most often, empty where it is the only one."""
    best = int(np.argmax(moved))
    if len(instances) == 1:
        return ""
    idle = ", ".join(one.name for one, count in zip(instances, moved, strict=True) if count <= 0)
    least = f"; not {idle}" if idle else " most often"
    return f"the motors are {instances[best].name}, whose {what} move{least}"


def _another_craft(parameters: Parameters) -> str:
    kind = parameters.get("MAV_TYPE", 2.0)
    if kind != 2.0:
        also = f", {MAV_TYPES[int(kind)]}" if kind in MAV_TYPES else ""
        return f"not of a quadrotor (MAV_TYPE {kind:g}{also}): its motors are left out"
    rotors = parameters.get("CA_ROTOR_COUNT", 4.0)
    if rotors != 4.0:
        return f"not of a quadrotor (CA_ROTOR_COUNT {rotors:g}): its motors are left out"
    return ""


def _of_thrust(asked: Sequence[Series], moved: Sequence[int], parameters: Parameters) -> Motors:
    best = asked[int(np.argmax(moved))]
    columns = _numbered(best, "control")
    count = changes(columns)
    if reason := crowd_of(count, range(4), range(4, len(count)), "control"):
        return Motors(None, open=reason)
    factor = parameters.get("THR_MDL_FAC", 0.0)
    thrust = np.nan_to_num(columns[:, :4], nan=0.0).clip(0.0, 1.0)  # NaN: disarmed
    note = _chosen(asked, moved, "controls")
    duty, notes = thrust, [note] if note else []
    if 0.0 < factor <= 1.0:
        root = np.sqrt((1.0 - factor) ** 2 + 4.0 * factor * thrust)
        duty = (root - (1.0 - factor)) / (2.0 * factor)
        notes.append(f"the motors' duty is their thrust command through THR_MDL_FAC {factor:g}")
    motors = _ordered(best, duty, parameters, notes)
    if "THR_MDL_FAC" in parameters or motors.series is None:
        return motors
    return Motors(motors.series, motors.notes, "; ".join(filter(None, [ASKED, motors.open])))


def _of_outputs(outputs: Sequence[Series], parameters: Parameters) -> Motors:
    """Those of the instance of which four move most often."""
    moved = _moved(outputs, "output")
    best = int(np.argmax(moved))
    if moved[best] < 0:
        return Motors(None, open="no instance of actuator_outputs has four outputs: no motors")
    values = _numbered(outputs[best], "output")
    found = motors_among(values, parameters)
    if found.crowd:
        return Motors(None, open=found.crowd)
    note = _chosen(outputs, moved, "outputs")
    notes = [note] if note else []
    given = values[:, found.places]
    meant = range_of(given, parameters, found)
    if meant is None:
        most = float(np.nanmax(given))
        return Motors(None, open=f"outputs up to {most:.4g}, which no driver has: no motors")
    if found.places != [0, 1, 2, 3] and not found.prefix:
        listed = ", ".join(str(k) for k in found.places)
        notes.append(f"the motors are outputs {listed}, the four that move")
    notes.append(f"the motors' outputs are {meant.what}")
    duty = np.clip((given - meant.low) / (meant.high - meant.low), 0.0, None)
    duty[given <= 0.0] = 0.0
    motors = _ordered(outputs[best], duty, parameters, notes)
    open_ = "; ".join(filter(None, [meant.open, motors.open]))
    return motors if motors.series is None else Motors(motors.series, motors.notes, open_)


def _ordered(source: Series, duty: Array, parameters: Parameters, notes: Sequence[str]) -> Motors:
    """In our order: by the rotors' places, where the parameters have them."""
    order: Sequence[int] = ORDER if parameters.get("MOT_ORDERING", 0.0) != 1.0 else BETAFLIGHT_ORDER
    open_ = ""
    places = [
        (parameters.get(f"CA_ROTOR{k}_PX"), parameters.get(f"CA_ROTOR{k}_PY")) for k in range(4)
    ]
    if all(x is not None and y is not None for x, y in places):
        signs = [(int(np.sign(x or 0.0)), int(np.sign(y or 0.0))) for x, y in places]
        if set(signs) != set(QUADRANTS):
            return Motors(None, open="not of a quadrotor x (CA_ROTORn_PX, _PY): motors left out")
        order = [signs.index(quadrant) for quadrant in QUADRANTS]
        spins = [parameters.get(f"CA_ROTOR{k}_KM", 0.0) for k in order]
        if all(spin * usual < 0.0 for spin, usual in zip(spins, SPINS, strict=True)):
            open_ = "its rotors turn the other way round (CA_ROTORn_KM): c2 comes out negative"
    columns = {f"m{number}": duty[:, place] for number, place in enumerate(order, start=1)}
    return Motors(Series(NAME, source.time_ns, columns), tuple(notes), open_)


def _numbered(series: Series, field: str) -> Array:
    """Columns ``field[0]``, ``field[1]``, ... (n, k)."""
    columns: list[Array] = []
    while (name := f"{field}[{len(columns)}]") in series.columns:
        columns.append(np.asarray(series.columns[name], np.float64))
    return np.column_stack(columns) if columns else np.empty((len(series.time_ns), 0))
