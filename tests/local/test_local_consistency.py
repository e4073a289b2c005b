"""Whether channels fit together, on real flights at hover: `make check-local`.

imrc_brushed/jana01, 04, 05, 06: yaw manoeuvres of a brushed craft at hover; roll and pitch tremble
by 0.2 deg, and in 04 and 05 no thrust is commanded but what holds the height.
"""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from groundstation.comparison.consistency import require_consistent
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError
from groundstation.identification.runs import flights_of
from groundstation.recording.formats import open_recording

DATA = os.environ.get("GROUNDSTATION_LOCAL_DATA")
pytestmark = pytest.mark.skipif(
    DATA is None or not Path(DATA).is_dir(),
    reason="GROUNDSTATION_LOCAL_DATA names no folder with imrc_brushed/",
)
MODEL = vehicle_model(load_vehicle(Path(__file__).parents[2] / "bench" / "real" / "brushed.toml"))


@pytest.fixture(params=["jana01", "jana04", "jana05", "jana06"])
def hovering(request):
    return flights_of(
        open_recording(Path(DATA) / "imrc_brushed" / request.param).samples, request.param
    )


def test_a_flight_at_hover_is_no_bench(hovering):
    require_consistent(hovering, MODEL)


@pytest.mark.parametrize(("axis", "signs"), [("roll", [-1, 1, 1]), ("pitch", [1, -1, 1])])
def test_an_angle_of_the_other_sign_is_told_at_hover(hovering, axis, signs):
    wrong = [replace(run, attitude=run.attitude * signs) for run in hovering]
    with pytest.raises(BadInputError, match=f"likeliest {axis} has the other sign"):
        require_consistent(wrong, MODEL)
