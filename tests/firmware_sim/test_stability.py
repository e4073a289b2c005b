"""Every craft flies from take-off to landing at its default gains, whatever the seed."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_sim.craft import StandIn, StandInSettings

PROGRAMME = """
name = "there and back"
[[segment]]
kind = "rest"
seconds = 3
[[segment]]
kind = "fly"
seconds = 9
[[segment.excite]]
axis = "roll"
shape = "doublet"
amplitude = 9
period_s = 1.5
start_s = 3
end_s = 6
[[segment.excite]]
axis = "pitch"
shape = "doublet"
amplitude = 9
period_s = 1.5
start_s = 5
end_s = 8
[[segment]]
kind = "fly"
seconds = 5
height_m = 0
[[segment]]
kind = "rest"
seconds = 1
"""


@pytest.fixture(scope="module")
def programme(tmp_path_factory):
    path = tmp_path_factory.mktemp("programme") / "there_and_back.toml"
    path.write_text(PROGRAMME)
    return str(path)


@pytest.mark.parametrize("plant", ["faithful", "reduced"])
@pytest.mark.parametrize("craft", ["crazyflie1", "crazyflie21", "thesis"])
def test_fifty_flights_go_up_stay_upright_and_come_down(programme, craft, plant):
    for seed in range(50):
        stand_in = StandIn(
            StandInSettings(
                craft=craft, plant=plant, seed=seed, program=programme, truth=True, copies=1
            )
        )
        stand_in.advance(18.0)
        truth = stand_in.truth()
        _, x, y, _ = truth["quaternion"].T
        tilt_deg = np.degrees(np.arccos(1 - 2 * (x * x + y * y)))
        height = truth["position_m"][:, 2]
        assert height.max() == pytest.approx(0.85, abs=0.15), seed
        assert height[-1] < 0.001, seed
        assert tilt_deg.max() < 25, seed
        assert np.abs(truth["position_m"][:, :2]).max() < 2.0, seed
        flying = (truth["time_s"] > 4.0) & (truth["time_s"] < 5.8)
        assert np.abs(truth["rate_rad_s"][flying]).max() < 1.5, seed
        descent = truth["velocity_m_s"][truth["time_s"] > 12, 2].min()
        assert descent > -0.9, seed
