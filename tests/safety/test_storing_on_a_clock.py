"""What a craft keeps while it is switched off: stored and cleared under a lease and on the ground
alone, and no longer to be put back."""

import asyncio

import pytest

from firmware_sim.contents import CLEAR, STORE
from groundstation.errors import BadInputError, LinkError, NotAuthorisedError, TakenError
from groundstation.service.parameters import Changes
from support.worlds import GAINS, HOVER, Tuning

ROLL, PITCH, YAW = GAINS
WRITES = (STORE, CLEAR)


class Storing(Tuning):
    def store(self, token, *names):
        return self.looked(self.commander.stored.store(token, names))

    def clear(self, token, *names):
        return self.looked(self.commander.stored.clear(token, names))

    def switched_off_and_on(self):
        self.one.lose()
        self.one.switch_on()
        self.wait(4.0)

    def written(self):
        """Requests that changed what is stored."""
        return [one for one in self.one.asked if one[0] in WRITES]


@pytest.fixture
def storing(tmp_path):
    made = Storing("crazyflie21", tmp_path / "state" / "changed.json")
    yield made
    made.close()


def test_stored_gains_survive_a_power_cycle_and_cleared_ones_do_not(storing):
    stock = storing.gains()
    token = storing.lease("pid fly")
    storing.write(token, **{ROLL: 180.0, PITCH: 190.0})
    kept = storing.store(token)
    assert kept[ROLL].stored == 180.0
    assert kept[ROLL].default == stock[ROLL]
    assert kept[YAW].stored is None  # a power cycle does not change it
    storing.commander.release(token)
    storing.switched_off_and_on()
    assert storing.gains() == {**stock, ROLL: 180.0, PITCH: 190.0}
    assert storing.commander.stored.told(storing.one) == {ROLL: 180.0, PITCH: 190.0}
    token = storing.lease("pid fly")
    storing.clear(token)
    assert storing.gains()[ROLL] == 180.0  # until it is switched off
    storing.commander.release(token)
    storing.switched_off_and_on()
    assert storing.gains() == stock
    assert storing.commander.stored.told(storing.one) == {}
    assert any("pid fly has stored pid_rate.roll_kp 180" in text for text in storing.told)


def test_gains_that_were_set_back_to_stock_replace_stored_ones(storing):
    stock = storing.gains()
    token = storing.lease()
    storing.write(token, **{ROLL: 180.0})
    storing.store(token)
    storing.write(token, **{ROLL: stock[ROLL]})
    storing.store(token)
    storing.commander.release(token)
    storing.switched_off_and_on()
    assert storing.gains() == stock


def test_what_was_stored_is_not_put_back_where_the_client_then_vanishes(storing):
    token = storing.lease("learn")
    storing.write(token, **{ROLL: 180.0, PITCH: 190.0})
    storing.store(token, ROLL)
    assert Changes(storing.path).of("udp://one:1").keys() == {PITCH}
    storing.wait(storing.commander.limits.lease_s + 4.0)
    assert storing.gains()[ROLL] == 180.0
    assert storing.gains()[PITCH] != 190.0


@pytest.mark.parametrize("what", ["store", "clear"])
def test_nothing_is_stored_or_cleared_while_motors_turn(storing, what):
    token = storing.lease()
    storing.write(token, **{ROLL: 180.0})
    if what == "clear":
        storing.store(token, ROLL)
    before = storing.written()
    work = getattr(storing.commander.stored, what)
    storing.steer(token, 0.3, thrust=0)
    storing.commander.setpoint(token, 0.0, 0.0, 0.0, HOVER, made_s=storing.world.now_s)
    with pytest.raises(TakenError, match="land first"):  # not seen to turn yet
        storing.run(work(token, [ROLL]))
    storing.steer(token, 0.5)
    with pytest.raises(TakenError, match="land first"):
        storing.run(work(token, [ROLL]))
    storing.steer(token, 0.1, thrust=0)
    while storing.one.turns:  # asked to stop, and not seen to have
        with pytest.raises(TakenError, match="land first"):
            storing.run(work(token, [ROLL]))
        storing.steer(token, 0.05, thrust=0)
    assert storing.written() == before


def test_no_motor_begins_while_something_is_stored(storing):
    token = storing.lease()
    storing.write(token, **{ROLL: 180.0, PITCH: 190.0, YAW: 100.0})
    storing.steer(token, 0.3, thrust=0)

    async def thrust():
        work = asyncio.ensure_future(storing.commander.stored.store(token, []))
        refused = 0
        while not work.done():
            await asyncio.sleep(0.02)
            if not work.done():
                with pytest.raises(TakenError, match="being stored"):
                    storing.commander.setpoint(token, 0.0, 0.0, 0.0, HOVER)
                refused += 1
        return refused, work.result()

    refused, kept = storing.run(thrust())
    assert refused > 2
    assert kept[YAW].stored == 100.0
    assert not any(turned for _, turned in storing.one.asked)


def test_a_stop_ends_what_is_being_stored_and_it_is_said_what_was(storing):
    token = storing.lease()
    storing.write(token, **{ROLL: 180.0, PITCH: 190.0, YAW: 100.0})

    async def stop():
        work = asyncio.ensure_future(storing.commander.stored.store(token, []))
        while not storing.one.stored:
            await asyncio.sleep(0.01)
        stopping = asyncio.ensure_future(storing.commander.operator.stop())
        with pytest.raises(NotAuthorisedError, match=r"operator.*Already stored: pid_rate"):
            await work
        storing.commander.look(storing.world.now_s)
        stopping.cancel()

    storing.run(stop())
    assert storing.one.stored.keys() == {ROLL}


def test_without_the_lease_nothing_is_stored_or_cleared(storing):
    storing.wait(1.0)
    for work in (storing.commander.stored.store, storing.commander.stored.clear):
        with pytest.raises(NotAuthorisedError):
            storing.run(work("nobody's", [ROLL]))
    assert storing.written() == []


def test_a_craft_that_does_not_answer_or_cannot_store_says_so(storing):
    token = storing.lease()
    storing.write(token, **{ROLL: 180.0})
    with pytest.raises(BadInputError, match="cannot be stored"):
        storing.store(token, "stabilizer.controller")
    storing.one.refuses = True
    with pytest.raises(LinkError, match="no answer about the stored value of pid_rate"):
        storing.store(token, ROLL)
    storing.one.storage = None
    with pytest.raises(BadInputError, match="stores no parameters"):
        storing.store(token)
    with pytest.raises(BadInputError, match="stores no parameters"):
        storing.run(storing.commander.stored.states())


def test_where_the_telemetry_says_nothing_of_the_motors_nothing_is_stored(storing):
    token = storing.lease()
    storing.write(token, **{ROLL: 180.0})
    storing.one.deaf = True
    storing.wait(1.5)
    with pytest.raises(TakenError, match="nothing says that they stand"):
        storing.store(token, ROLL)
