import pytest

from firmware_sim.craft import StandIn
from firmware_sim.settings import StandInSettings
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch


@pytest.fixture(scope="session", autouse=True)
def compiled():
    """Compiles the stand-in and the decoder where no cache has them, outside any test's time."""
    craft = StandIn(StandInSettings())
    packets, arrival_s = craft.advance(2.5)
    decode_all(RawBatch(packets, (arrival_s * 1e9).astype("int64")))
