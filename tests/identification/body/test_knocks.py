"""A knock that no fit uses is named, with its size and when it came."""

from pathlib import Path

from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.body.workflow import knocks
from groundstation.identification.division import stretches_of
from groundstation.identification.runs import runs_of
from groundstation.recording.formats import open_recording

RECORDINGS = Path(__file__).parents[3] / "recordings"


def of(name):
    runs = runs_of(open_recording(RECORDINGS / f"nanobench_{name}.mcap").samples, name)
    return stretches_of(runs, BUILT_IN["crazyflie21"].motor)


def test_the_landing_of_a_real_flight_is_named_and_not_fitted():
    assert knocks(of("figure8")) == [
        "figure8: a knock of 7.2 g at 23.0 s, a landing or a collision, is not fitted"
    ]


def test_a_soft_landing_is_no_knock():
    assert knocks(of("trefoil")) == []
