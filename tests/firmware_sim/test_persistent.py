"""Parameters that outlast a power cycle, by the calls of the official client library."""

from __future__ import annotations

import errno
import struct
import threading
from collections.abc import Callable, Iterator
from typing import Any

import cflib.crtp
import pytest
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim.contents import CLEAR, GET_STATE, STORE, contents_of, misc_answer
from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.crtp import Conversation
from support.crafts import ServedCraft, served, switched_off_and_on
from support.waiting import PATIENCE_S, until

GAIN, STOCK = "pid_rate.roll_kp", 250.0
MISC = b"\x2f"
"""Port 2, channel 3, and the two link bits."""


@pytest.fixture(params=[7, 12])
def craft(request) -> Iterator[ServedCraft]:
    settings = {"craft": "crazyflie21", "plant": "reduced", "recharge_s": 0.2}
    with served(protocol=request.param, **settings) as running:
        cflib.crtp.init_drivers()
        yield running


def told(call: Callable[..., None], name: str) -> Any:
    """What a call of cflib's tells its callback."""
    heard = threading.Event()
    said: list[Any] = []

    def hear(_: str, value: Any) -> None:
        said.append(value)
        heard.set()

    call(name, hear)
    assert heard.wait(PATIENCE_S), "no answer"
    return said[0]


def test_a_stored_gain_survives_a_power_cycle_and_a_cleared_one_does_not(craft):
    with SyncCrazyflie(craft.uri, cf=Crazyflie()) as connected:
        param = connected.cf.param
        persistent = {
            f"{group}.{name}"
            for group, elements in param.toc.toc.items()
            for name, element in elements.items()
            if element.is_persistent()
        }
        assert {name.partition(".")[0] for name in persistent} == {"pid_rate", "pid_attitude"}
        param.set_value(GAIN, 200.0)
        until(lambda: craft.craft.get_parameter(GAIN) == 200.0, "it has the gain")
        assert told(param.persistent_get_state, GAIN) == (False, STOCK, None)
        assert told(param.persistent_store, GAIN)
        assert told(param.persistent_get_state, GAIN) == (True, STOCK, 200.0)
        assert told(param.get_default_value, GAIN) == STOCK
        param.set_value("pid_rate.pitch_kp", 210.0)
        until(lambda: craft.craft.get_parameter("pid_rate.pitch_kp") == 210.0, "the other gain")
    switched_off_and_on(craft)
    with SyncCrazyflie(craft.uri, cf=Crazyflie()) as connected:
        param = connected.cf.param
        assert float(param.get_value(GAIN)) == 200.0
        assert float(param.get_value("pid_rate.pitch_kp")) == STOCK  # was never stored
        assert told(param.persistent_clear, GAIN)
        assert not told(param.persistent_clear, GAIN)
        assert craft.craft.get_parameter(GAIN) == 200.0
    switched_off_and_on(craft)
    assert craft.craft.get_parameter(GAIN) == STOCK


def test_the_firmware_of_2014_stores_nothing():
    craft = StandIn(StandInSettings(program="wait"))
    assert not any(kind & 0x10 for _, kind in contents_of(craft).parameters)
    assert Conversation(craft).answer(MISC + struct.pack("<BH", STORE, 0)) == []


def test_firmware_built_to_run_in_software_has_no_memory_to_store_in():
    settings = StandInSettings(craft="crazyflie21", program="wait", software_build=True)
    craft = StandIn(settings)
    parameters = contents_of(craft).parameters
    number = [name for name, _ in parameters].index(GAIN)
    asked = struct.pack("<BH", STORE, number)
    assert misc_answer(craft, parameters, asked) == asked + bytes([errno.ENOENT])
    state = misc_answer(craft, parameters, struct.pack("<BH", GET_STATE, number))
    assert state is not None
    assert state[3:] == struct.pack("<Bf", 0, STOCK)


CRAFTS = {
    protocol: StandIn(StandInSettings(craft="crazyflie21", program="wait", protocol=protocol))
    for protocol in (7, 12)
}


@given(protocol=st.sampled_from(sorted(CRAFTS)), data=st.binary(max_size=30))
def test_whatever_is_asked_the_answer_repeats_the_request_and_stores_finite_gains(protocol, data):
    craft = CRAFTS[protocol]
    (packet, *more) = Conversation(craft).answer(MISC + data) or [MISC + data[:3]]
    assert not more
    assert packet[:4] == MISC + data[:3]
    assert len(packet) <= 31
    assert all(name.startswith("pid_") for name in craft.stored)


@given(number=st.integers(0, 2**16 - 1), command=st.sampled_from((STORE, CLEAR)))
def test_only_parameters_that_say_so_are_stored(number, command):
    craft = CRAFTS[12]
    parameters = contents_of(craft).parameters
    before = dict(craft.stored)
    said = misc_answer(craft, parameters, struct.pack("<BH", command, number))
    assert said is not None
    kept = number < len(parameters) and parameters[number][1] & 0x10
    if not kept:
        assert said[3] == errno.ENOENT
        assert craft.stored == before
    elif command == STORE:
        assert said[3] == 0
        assert parameters[number][0] in craft.stored
    else:
        assert parameters[number][0] not in craft.stored
