"""Which craft a log that names none may be of."""

from pathlib import Path

import msgspec
import pytest

from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError
from groundstation.recording.formats import open_recording
from groundstation.recording.session import require_craft_of

LOG = Path(__file__).parents[2] / "recordings" / "microsd_log16"


@pytest.mark.parametrize("base", ["crazyflie1", "crazyflie21", "brushless"])
def test_a_profile_of_ones_own_is_the_word_on_what_flew(base):
    mine = msgspec.structs.replace(load_vehicle(base), name="mine")
    require_craft_of(open_recording(LOG), vehicle_model(mine))


def test_a_built_in_profile_can_be_contradicted():
    require_craft_of(open_recording(LOG), vehicle_model(load_vehicle("crazyflie21")))
    with pytest.raises(BadInputError, match=r"of a Crazyflie 2\.x .*, not of 'crazyflie1'"):
        require_craft_of(open_recording(LOG), vehicle_model(load_vehicle("crazyflie1")))
