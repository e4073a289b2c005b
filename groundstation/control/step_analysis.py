"""What the steps of a flight say of its gains."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from groundstation.control.firmware_loop import Plant, plant_of_model, run_cascade
from groundstation.control.metrics import StepMetrics, step_metrics
from groundstation.control.programme import BEGINS, LANDS, MANOEUVRE
from groundstation.dynamics.model import Model, model_vehicle
from groundstation.dynamics.vehicle import MIXERS, Configuration, load_vehicle
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S
from groundstation.telemetry.samples import SampleBatch

if TYPE_CHECKING:
    from groundstation.recording.session import Recording

# A flown programme as step responses, measured and predicted, with the same metrics.
#
# The setpoints of a recording carry the time at which the host sent them. When each took effect is
# found in the motors: the row in which the controller's output on that axis jumps. The prediction
# flies the model through the same setpoints, at the battery voltage and mean thrust of the flight;
# the measured motion has no part in it. Both are then cut and averaged alike.


EARLIEST_S, LATEST_S = -0.45, 0.12
"""Where an edge is looked for, from the moment its setpoint was sent, and not beyond half the way
to its neighbours. Before it, because the time of a simulated craft stands still while its host is
busy: up to as much as the telemetry may be late."""
APART_S = 0.006
CLEAR, AROUND_S = 8.0, 1.0
"""An edge further than that from the others' usual delay takes it instead, unless the jump in the
motors stands out by so many standard deviations of those around it: rows may be fewer later on."""
LEAST_WINDOW_S = 0.15
BRIDGED_S = 0.1
"""Without telemetry where fewer rows are asked for: a tenth of what an edge is judged by."""
ENVELOPE = 20
"""Parts of a flight in each of which the promptest packet ties host to device time."""
CLOSE_RATIO, CLOSE_POINTS, CLOSE_S = 0.15, 3.0, 0.020
"""When measured and predicted agree: within 15 %, or 3 points of overshoot, or 20 ms."""


@dataclass(frozen=True, slots=True)
class Edge:
    """A change of one axis's setpoint: at device time ``time_s``, from and to (rad, rad/s).
    until_s: the next change of any axis."""

    axis: int
    time_s: float
    before: float
    after: float
    until_s: float


@dataclass(frozen=True, slots=True)
class FlownAxis:
    """One axis of a flight: averages (k,) over its edges, as shares of the step, and metrics."""

    axis: str
    edges: int
    step: float
    measured: StepMetrics
    response: Array
    predicted: StepMetrics | None = None
    predicted_response: Array | None = None

    @property
    def apart(self) -> list[str]:
        """Where measured and predicted do not agree, in words; empty where they do."""
        if self.predicted is None:
            return []
        found = []
        one, other = self.measured, self.predicted
        if abs(one.rms - other.rms) > CLOSE_RATIO * abs(other.rms):
            found.append(f"RMS {one.rms / self.step:.3f} against {other.rms / self.step:.3f}")
        gap = abs(one.overshoot_pct - other.overshoot_pct)
        if gap > max(CLOSE_POINTS, CLOSE_RATIO * other.overshoot_pct):
            found.append(f"overshoot {one.overshoot_pct:.1f} against {other.overshoot_pct:.1f} %")
        if (one.settling_s is None) != (other.settling_s is None):
            found.append(f"settling {one.settling_s} against {other.settling_s} s")
        elif one.settling_s is not None and other.settling_s is not None:
            gap = abs(one.settling_s - other.settling_s)
            if gap > max(CLOSE_S, CLOSE_RATIO * other.settling_s):
                found.append(f"settling {one.settling_s:.3f} against {other.settling_s:.3f} s")
        return found

    def as_dict(self) -> dict[str, Any]:
        """For ``pid fly --json``."""
        return {
            "edges": self.edges,
            "step": self.step,
            "measured": self.measured.as_dict(),
            "predicted": None if self.predicted is None else self.predicted.as_dict(),
            "apart": self.apart,
        }


@dataclass(frozen=True, slots=True)
class Flown:
    """axes that were moved. delay_s: from sending a setpoint to its effect, median; spread_s:
    the middle half of it. found: edges whose effect was seen in the motors, of
    edges that show there."""

    axes: tuple[FlownAxis, ...]
    delay_s: float
    spread_s: float
    found: int
    edges: int


def setpoint_table(
    commands: Sequence[Mapping[str, Any]],
    client: str,
    trim_deg: tuple[float, float] = (0.0, 0.0),
) -> tuple[NDArray[np.int64], Array]:
    """Host times (k,) in ns and setpoints (k, 3) in rad and rad/s that a client sent while the
    motors ran, from a recording's commands: level where the craft was asked to hold its place.

    trim_deg: roll and pitch that were added to every other one, and are taken off.
    """
    rows = [
        entry
        for entry in commands
        if (entry.get("kind"), entry.get("client")) == ("setpoint", client)
        and (entry.get("thrust", 0) > 0 or "height_m" in entry)
    ]
    times = np.array([entry["time_ns"] for entry in rows], np.int64)
    table = [[entry[name] for name in ("roll_deg", "pitch_deg", "yaw_dps")] for entry in rows]
    values = np.array(table, np.float64).reshape(-1, 3)
    holds = np.array(["vx_m_s" in entry for entry in rows], bool)
    values[~holds, :2] -= trim_deg
    return times, np.radians(values)


def analyse(
    samples: SampleBatch,
    times_ns: NDArray[np.int64],
    setpoints: Array,
    configuration: Configuration = "plus",
    plant: Plant | None = None,
    gains: Mapping[str, float] | None = None,
    holds_heading: bool = False,
) -> Flown:
    """Metrics of a flown programme, beside the prediction where a plant and its gains are given.

    samples: of one segment, or of several where the craft was asked for fewer rows and its clock
    went on. times_ns, setpoints: as ``setpoint_table`` gives them. holds_heading: a yaw setpoint
    turns the heading that the firmware holds, as today's does: no edge of it shows in the motors.

    Raises BadInputError where there is no telemetry of the setpoints, or no edge among them.
    """
    grid, measured, duty, supply = _on_grid(samples)
    sent = _device_times(samples, times_ns)
    edges, delay, spread, found, visible = _effective(
        grid, duty, sent, setpoints, MIXERS[configuration][: 2 if holds_heading else 3]
    )
    if not edges:
        raise BadInputError("the setpoints of this flight never change: nothing to measure")
    flights = [measured]
    if plant is not None:
        flights.append(_predict(grid, duty, supply, edges, plant, gains or {}))
    axes = []
    for index, axis in enumerate(AXES):
        if own := [edge for edge in edges if edge.axis == index]:
            both: list[Any] = []  # measured, and predicted
            for flight in flights:
                response, step = _average(grid, flight[:, index], own)
                both += [step_metrics(response * step, SAMPLE_PERIOD_S, step), response]
            axes.append(FlownAxis(axis, len(own), step, *both))
    return Flown(tuple(axes), delay, spread, found, visible)


def _on_grid(samples: SampleBatch) -> tuple[Array, Array, Array, Array]:
    """Device times every 2 ms, and on them: what is controlled (roll, pitch, yaw rate), duty,
    supply in mV."""
    time = samples.time_s
    if len(time) < 100:
        raise BadInputError(f"the flight's telemetry is too short: {len(time)} rows")
    apart = np.diff(time)[np.diff(samples.segment) != 0]
    if (apart <= 0.0).any():
        raise BadInputError("the craft restarted in the flight")
    if (apart > BRIDGED_S).any():
        raise BadInputError(f"telemetry fails for {apart.max():.1f} s in the flight")
    grid = np.arange(time[0], time[-1], SAMPLE_PERIOD_S)
    controlled = np.column_stack([samples.attitude[:, :2], samples.gyro[:, 2]])

    def on(values: Any) -> Array:
        table = np.asarray(values, np.float64).reshape(len(time), -1)
        return np.column_stack([np.interp(grid, time, column) for column in table.T])

    return grid, on(controlled), on(samples.duty), 1000.0 * on(samples.battery_v)[:, 0]


def _device_times(samples: SampleBatch, times_ns: NDArray[np.int64]) -> Array:
    """Host times as device times: packets are late by chance, never early, so the promptest of
    each part of the flight tie the clocks together."""
    device = samples.time_s
    start = int(samples.host_time_ns[0])
    host = (samples.host_time_ns - start) * 1e-9
    parts = np.array_split(np.arange(len(device)), ENVELOPE)
    prompt = np.array([part[np.argmin((host - device)[part])] for part in parts if len(part)])
    # a straight line below all of them: the crystals' rates differ, nothing else may
    slope, offset = np.polyfit(device[prompt], (host - device)[prompt], 1)
    offset += np.min((host - device)[prompt] - slope * device[prompt] - offset)
    sent = (times_ns - start) * 1e-9
    return (sent - offset) / (1 + slope)


def _effective(
    grid: Array, duty: Array, sent: Array, setpoints: Array, shown: Array
) -> tuple[list[Edge], float, float, int, int]:
    """Edges at the device times of their effect, the usual delay, its spread, how many were seen
    and how many could be.

    shown: rows of the mixer (a, 4) of the axes whose edges show in the motors; another's take the
    usual delay. A row's motors were computed one row earlier: there the setpoint acts.
    """
    output = duty @ shown.T
    jumps = np.diff(output, axis=0, prepend=output[:1])
    rows, axes = np.nonzero(np.diff(setpoints, axis=0))
    changes = list(zip((rows + 1).tolist(), axes.tolist(), strict=True))  # (row of setpoints, axis)
    around = round(AROUND_S / SAMPLE_PERIOD_S)
    moments = sent[rows + 1]
    room = 0.5 * np.diff(moments, prepend=-np.inf, append=np.inf)
    visible, delays, clear = 0, [], []
    for (row, axis), before, after in zip(changes, room[:-1], room[1:], strict=True):
        delays.append(math.nan)
        clear.append(False)
        if axis >= len(shown):
            continue
        sign = np.sign(setpoints[row, axis] - setpoints[row - 1, axis])
        low = np.searchsorted(grid, sent[row] + max(EARLIEST_S, -before))
        high = np.searchsorted(grid, sent[row] + min(LATEST_S, after))
        if high - low < 5:
            raise BadInputError("telemetry does not cover the whole programme")
        strongest = low + int(np.argmax(sign * jumps[low:high, axis]))
        visible += 1
        jump = sign * jumps[strongest, axis]
        if jump > 0.0:  # motors that stand still answer nothing
            delays[-1] = grid[strongest - 1] - sent[row]
        usual_jump = np.median(np.abs(jumps[max(low - around, 0) : high + around, axis]))
        clear[-1] = bool(jump > CLEAR * (1.4826 * usual_jump + 1e-9))
    if not delays:
        return [], 0.0, 0.0, 0, 0
    usual, spread = 0.0, 0.0
    if seen := [delay for delay in delays if math.isfinite(delay)]:
        usual = float(np.median(seen))
        spread = float(np.subtract(*np.percentile(seen, [75, 25])))
    near = np.array(clear) | (np.abs(np.array(delays) - usual) <= APART_S)
    starts = moments + np.where(near, delays, usual)
    ends = [*starts[1:], grid[-1]]
    edges = [
        Edge(axis, float(start), setpoints[row - 1, axis], setpoints[row, axis], float(end))
        for (row, axis), start, end in zip(changes, starts, ends, strict=True)
    ]
    return edges, usual, spread, int(near.sum()), visible


def _predict(
    grid: Array,
    duty: Array,
    supply: Array,
    edges: Sequence[Edge],
    plant: Plant,
    gains: Mapping[str, float],
) -> Array:
    """What the model does with the flight's setpoints: roll, pitch (rad), yaw rate (rad/s), one
    row for each of ``grid``; level until a second before the first edge."""
    begin = max(0, int(np.searchsorted(grid, edges[0].time_s - 1.0)))
    setpoints = np.zeros((len(grid) - begin, 3))
    for edge in edges:
        row = int(np.searchsorted(grid, edge.time_s - 0.25 * SAMPLE_PERIOD_S)) - begin
        setpoints[max(row, 0) :, edge.axis] = edge.after
    thrust = plant.firmware.thrust(duty, supply[:, None]).mean(axis=1)
    # after the landing the motors stand still, which no model of flight explains
    thrust = np.maximum(thrust, 0.5 * np.median(thrust))
    response = run_cascade(plant, gains, setpoints, thrust[begin:], supply[begin:])
    flown = np.zeros((len(grid), 3))
    flown[begin:, :2] = response.angles[:, :2]
    flown[begin:, 2] = response.gyro[:, 2]
    return flown


def _average(grid: Array, values: Array, edges: Sequence[Edge]) -> tuple[Array, float]:
    """The response to a unit step, averaged over edges by the squares of their sizes (least
    squares), and the size of the smallest step."""
    usable = [edge for edge in edges if edge.after != 0.0]
    lengths = np.array([edge.until_s - edge.time_s for edge in usable])
    # a craft that was brought back in the midst of one leaves pieces
    whole = np.flatnonzero(lengths >= 0.5 * np.median(lengths))
    usable, length = [usable[place] for place in whole], float(lengths[whole].min())
    rows = int(length / SAMPLE_PERIOD_S + 1e-6)
    if rows * SAMPLE_PERIOD_S < LEAST_WINDOW_S:
        raise BadInputError("the setpoints change too fast for step responses; hold them longer")
    total, weight = np.zeros(rows), 0.0
    for edge in usable:
        size = edge.after - edge.before
        at = edge.time_s + np.arange(rows) * SAMPLE_PERIOD_S
        response = (np.interp(at, grid, values) - edge.before) / size
        total += size * size * response
        weight += size * size
    return total / weight, min(abs(edge.after - edge.before) for edge in usable)


# A recording of ``pid fly`` judged.


MARGIN_NS = 200_000_000


def analyse_recording(
    recording: Recording,
    model: Model | None,
    gains: Mapping[str, float],
    client: str,
    release: str | None = None,
) -> Flown:
    """Step metrics of the programme that ``client`` flew, from its recording alone.

    model: for the prediction, None for none. gains: those that were flown. release: of the
    firmware, None: the vehicle's.

    Raises BadInputError where the file holds no such programme.
    """
    marks = {
        str(event.get("text")): event for event in recording.events if event.get("kind") == "mark"
    }
    if BEGINS not in marks or LANDS not in marks:
        raise BadInputError(f"{recording.path}: holds no whole programme of 'pid fly'")
    begin, end = (int(marks[name]["time_ns"]) for name in (BEGINS, LANDS))
    details = marks.get(MANOEUVRE, {}).get("details") or {}
    roll_deg, pitch_deg = details.get("trim_deg", (0.0, 0.0))
    times, setpoints = setpoint_table(recording.commands, client, (roll_deg, pitch_deg))
    inside = (times >= begin - MARGIN_NS) & (times <= end)
    samples = recording.samples
    host = samples.host_time_ns
    flying = np.flatnonzero((host >= begin - MARGIN_NS) & (host <= end + MARGIN_NS))
    recorded = recording.metadata.get("vehicle", {}).get("profile", "crazyflie1")
    vehicle = load_vehicle(recorded) if model is None else model_vehicle(model)
    plant = None if model is None else plant_of_model(model, release=release)
    flown = samples[flying]
    flown.attitude[:, :2] -= np.radians([roll_deg, pitch_deg])
    return analyse(
        flown,
        times[inside],
        setpoints[inside],
        vehicle.configuration,
        plant,
        gains,
        holds_heading=(release or vehicle.firmware) == "2.x",
    )
