import pytest

from firmware_sim.craft import StandIn
from firmware_sim.settings import StandInSettings
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch
from support.waiting import WHOLE_TEST_S, in_real_time


@pytest.fixture(scope="session", autouse=True)
def compiled():
    """Compiles the stand-in and the decoder where no cache has them, outside any test's time."""
    craft = StandIn(StandInSettings())
    packets, arrival_s = craft.advance(2.5)
    decode_all(RawBatch(packets, (arrival_s * 1e9).astype("int64")))


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem):
    """Daemon and craft run in real time: what fails where the machine gave none is run again."""
    with in_real_time(last_s=WHOLE_TEST_S):
        return (yield)
