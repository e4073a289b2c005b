"""Constants by what the craft did: told apart where they differ, and only there (7.3.5)."""

import numpy as np
import pytest
from stand_in_flights import recorded

from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.errors import BadInputError
from groundstation.identification.body.groups import fit_groups
from groundstation.identification.body.workflow import identify_body
from groundstation.identification.recordings import flights_of
from groundstation.identification.stretches import stretches_of

VEHICLE = BUILT_IN["crazyflie1"]
MODEL = vehicle_model(VEHICLE)
UP_AND_DOWN = """
name = "up and down"
[[segment]]
kind = "rest"
seconds = 3.5
[[segment]]
kind = "fly"
seconds = 44
height_m = 1.2
{excite}
""".format(
    excite="\n".join(
        f'[[segment.excite]]\naxis = "{axis}"\nshape = "{shape}"\namplitude = {size}\n'
        f"period_s = {period}\nstart_s = {start}"
        for axis, shape, size, period, start in (
            ("roll", "doublet", 12, 0.9, 3.0),
            ("pitch", "doublet", 12, 1.1, 3.0),
            ("yaw", "random", 150, 1.0, 3.0),
            ("height", "sine", 0.4, 2.0, 24.0),
        )
    )
)


def flown(name, seed, **settings):
    samples, _ = recorded(46.0, seed=seed, plant="reduced", **settings)
    return flights_of(samples, name)


@pytest.fixture(scope="module")
def up_and_down(tmp_path_factory):
    path = tmp_path_factory.mktemp("programme") / "up.toml"
    path.write_text(UP_AND_DOWN)
    return flown("up and down", 3, program=str(path))


def groups_of(runs, by):
    return fit_groups(stretches_of(runs, MODEL.motor), by, VEHICLE)


def test_a_load_between_two_flights_is_told_as_less_thrust_per_mass():
    light = flown("light", 1)
    loaded = flown("loaded", 2, effects={"mass_change": {"percent": 6.0}})
    found = groups_of([*light, *loaded], "recording")
    assert [one.name for one in found.groups] == ["light", "loaded"]
    assert "thrust_per_mass" in found.differ
    before, after = (one.estimates["thrust_per_mass"] for one in found.groups)
    assert before / after == pytest.approx(1.06, rel=0.01)
    assert found.lines[0].startswith(
        "thrust_per_mass differs by recording beyond its errors: light"
    )


def test_flights_of_one_craft_are_the_same_within_their_errors():
    found = groups_of([*flown("one", 1), *flown("other", 4)], "recording")
    assert found.differ == ()
    assert len(found.chance) == 4
    assert found.lines == ["by recording the same within their errors: c0, c1, c2, thrust_per_mass"]


def test_steady_and_changing_altitude_are_fitted_apart(up_and_down):
    found = groups_of(up_and_down, "altitude")
    names = [one.name for one in found.groups]
    assert names == ["low", "steady altitude", "changing altitude"]
    low, steady, changing = found.groups
    assert "at least 4 s are needed" in low.reason
    for one in (steady, changing):
        assert one.seconds > 8.0
        for i, name in enumerate(("c0", "c1", "c2")):
            assert one.estimates[name] == pytest.approx(VEHICLE.body_constants[i], rel=0.05)
    assert found.differ == ()


def test_the_account_of_a_fit_has_the_groups_beside_it(up_and_down):
    account = identify_body(up_and_down, [], MODEL, VEHICLE, by="altitude").account
    groups = account["groups"]
    assert groups["by"] == "altitude"
    rows = {one["name"]: one["seconds"] for one in groups["groups"]}
    assert sum(rows.values()) * 500 > 0.9 * account["samples"]
    alone = groups["groups"][1]["estimates"]
    assert np.shape(alone["covariance"]) == (4, 4)


def test_a_grouping_that_is_none_is_refused(up_and_down):
    with pytest.raises(BadInputError, match="--by height: there are altitude, motion, recording"):
        identify_body(up_and_down, [], MODEL, VEHICLE, by="height")
