"""Results of the Python API show themselves: a line, HTML, a table, pictures."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from groundstation.discrepancy.engine import Discrepancy
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.errors import BadInputError
from groundstation.identification.motor.workflow import identify_motor
from groundstation.identification.report import simulate_run
from groundstation.identification.runs import runs_of
from support.findings import findings, proof
from support.flights import recorded

VEHICLE = BUILT_IN["crazyflie1"]
MODEL = vehicle_model(VEHICLE)


@pytest.fixture(scope="module")
def results():
    """One of each kind, by the beginning of its line."""
    one = findings()
    proven = proof(one)
    flight = runs_of(recorded(8.0, plant="reduced", seed=83)[0], "flight")[0]
    bench = runs_of(
        recorded(16.0, plant="reduced", seed=82, program="motor_bench", supply_v=3.7)[0], "bench"
    )
    return {
        "Comparison(": proven.before,
        "Discrepancy(velocity_moment; gap ": Discrepancy(one, proven),
        "Replayed(flight: ": simulate_run(MODEL, flight),
        "Identified(motor of crazyflie1: a0 0.86": identify_motor(bench, [], MODEL, VEHICLE),
    }


def test_each_is_a_line_of_its_own(results):
    for begins, one in results.items():
        assert repr(one).startswith(begins)
        assert len(repr(one)) < 200
        assert "\n" not in repr(one)


def test_each_has_html_for_a_notebook_that_runs_nothing(results):
    for one in results.values():
        html = one._repr_html_()
        assert html.startswith("<div>")
        assert "<table>" in html
        assert "<script" not in html


def test_each_draws_the_pictures_of_its_report_by_name(results):
    for one in results.values():
        assert one.pictures
        for name in one.pictures:
            drawn = one.plot(name)
            assert isinstance(drawn, Figure)
            assert any(axes.has_data() for axes in drawn.axes)
        with pytest.raises(BadInputError, match=f"there are {one.pictures[0]}"):
            one.plot("nonsense")


def test_each_is_a_table(results):
    for one in results.values():
        assert len(one.to_frame()) > 0
    table = results["Identified(motor of crazyflie1: a0 0.86"].to_frame()
    found = dict(zip(table["name"].tolist(), table["value"].tolist(), strict=True))
    np.testing.assert_allclose(found["a0"], 0.862446, rtol=0.01)


def test_warnings_are_a_field(results):
    assert results["Discrepancy(velocity_moment; gap "].warnings == ("motor assumed known by 2 %",)
    assert isinstance(results["Identified(motor of crazyflie1: a0 0.86"].warnings, tuple)
