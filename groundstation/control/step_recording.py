"""A recording of ``pid fly`` judged."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from groundstation.control.plant import plant_of_model
from groundstation.control.programme import BEGINS, LANDS, MANOEUVRE
from groundstation.control.step_analysis import Flown, analyse, setpoint_table
from groundstation.dynamics.model import Model, model_vehicle
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError

if TYPE_CHECKING:
    from groundstation.recording.session import Recording

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
