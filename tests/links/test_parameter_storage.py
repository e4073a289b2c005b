"""What is asked about stored parameters, and what answers: ours beside the software craft's."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim import contents
from firmware_sim.craft import StandIn, StandInSettings
from groundstation.errors import LinkError
from groundstation.links.command import GET_STATE, ParameterStorage, StoredValue, request, state_in

GAIN, STOCK = "pid_rate.roll_kp", 250.0
LISTED = ((GAIN, contents.PARAM_FLOAT | contents.EXTENDED),)
CRAFT = StandIn(StandInSettings(craft="crazyflie21", plant="reduced", program="wait"))
GAINS = st.floats(0.0, 1000.0, width=32)


@given(stored=GAINS)
def test_a_state_is_read_as_the_firmware_says_it(stored: float) -> None:
    asked = request(GET_STATE, 0)
    CRAFT.stored[GAIN] = stored
    answer = contents.misc_answer(CRAFT, LISTED, asked)
    assert answer is not None
    assert answer.startswith(asked)
    assert state_in(answer[len(asked) :], "<f") == StoredValue(STOCK, stored)
    del CRAFT.stored[GAIN]
    answer = contents.misc_answer(CRAFT, LISTED, asked)
    assert answer is not None
    assert state_in(answer[len(asked) :], "<f") == StoredValue(STOCK, None)


@given(answer=st.binary(max_size=27), form=st.sampled_from(("<f", "<B", "<L", "<h")))
def test_an_answer_that_is_none_is_no_state(answer: bytes, form: str) -> None:
    state = state_in(answer, form)
    assert (state is None) or answer[0] in (0, 1)


def storage_that(answers: bytes | None) -> ParameterStorage:
    async def ask(data: bytes, patience_s: float) -> bytes | None:
        return answers

    return ParameterStorage("udp://craft:1", {GAIN: (0, "<f")}, ask)


@pytest.mark.parametrize(
    ("answers", "told"),
    [
        (None, "no answer about the stored value of pid_rate"),
        (b"\x02", "refused to store pid_rate"),
        (b"\x00", "does not say what it has stored"),
        (b"\x00" + bytes(4), "is stored as None, not as 60"),
    ],
)
def test_a_gain_counts_as_stored_only_where_it_is_read_back(answers: bytes, told: str) -> None:
    storage = storage_that(answers)
    with pytest.raises(LinkError, match=told):
        asyncio.run(storage.store(GAIN, 60.0))
    assert not any(one.stored for one in storage.states.values())
