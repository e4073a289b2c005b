"""A programme with its gains on the software craft with an identified model, before a real craft
flies it: its trims, its drift and its thrust curve are the craft's."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from groundstation import BadInputError, GroundStationError, load_model
from groundstation.cli.height_flight import Flyable
from groundstation.cli.learn_flights import CLIENT, FastPlace
from groundstation.control.step_analysis import analyse_recording
from groundstation.links.command import PLACE
from groundstation.recording.formats import open_for_analysis

if TYPE_CHECKING:
    from groundstation.control.step_analysis import Flown
    from groundstation.recording.session import Recording

SEED = 1
"""Of the noise that it flies in."""


def rehearse(
    programme: Flyable,
    gains: Mapping[str, float],
    model: str,
    height_m: float,
    reach_m: float,
    measures: bool,
) -> tuple[dict[str, Any], Flown | None]:
    """What became of it: seconds, how far it went, how fast, how it leaned; and its steps.

    gains: over the stock ones. measures: whether its steps are measured as well. Raises
    GroundStationError where it did not stay in its room, or did not fly at all.
    """
    loaded = load_model(model)
    place = FastPlace(loaded.vehicle, height_m, reach_m, model)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rehearsal.mcap"
        flown = place.fly(programme, file, seed=SEED, gains=gains)
        if flown.aborted:
            raise GroundStationError(
                f"rehearsed in software: the model does not fly this to its end: {flown.aborted};"
                " no craft was touched"
            )
        recording = open_for_analysis(file)
        steps = None
        if measures:
            with contextlib.suppress(BadInputError):  # where it was brought back in its steps
                steps = analyse_recording(recording, loaded, flown.gains, CLIENT)
    return {"seconds": flown.seconds, **_room_of(recording)}, steps


def _room_of(recording: Recording) -> dict[str, float]:
    table = next(iter(recording.tables.values()))
    x, y, _, vx, vy, _ = (np.asarray(table.columns[name], np.float64) for name in PLACE)
    return {
        "farthest_m": float(np.hypot(x, y).max()),
        "top_m_s": float(np.hypot(vx, vy).max()),
        "lean_deg": float(np.degrees(np.abs(recording.samples.attitude[:, :2]).max())),
    }
