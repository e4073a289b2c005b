"""What a craft is asked for by its operator, over cflib and UDP, and what it says then."""

import pytest

from firmware_sim.supervisor import CRASHED, FLYING
from groundstation.errors import BadInputError, LinkError
from groundstation.links.crazyflie import CrazyflieLink
from groundstation.service.lease import ask_to_arm, ask_to_recover, send_level
from support.crafts import served
from support.waiting import eventually

ON_ITS_BACK, UPRIGHT = (0.0, 1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)


def lying(craft, quaternion):
    """Hold the craft so, as a wall or a hand does."""

    def hold():
        craft.craft._state[0]["y"][6:10] = quaternion

    craft.each_step = hold


async def crash(craft, link):
    await ask_to_arm(link, True)

    def state():
        return craft.craft.state().supervisor

    def climbs():
        link.setpoint(0.0, 0.0, 0.0, 40000)
        return state() == FLYING

    await eventually(climbs)
    lying(craft, ON_ITS_BACK)

    def steered():
        link.setpoint(0.0, 0.0, 0.0, 40000)
        return state() == CRASHED

    await eventually(steered)
    await eventually(lambda: link.supervisor.crashed)


@pytest.mark.parametrize(
    ("kind", "protocol", "afterwards"),
    [("crazyflie21", 10, ""), ("crazyflie21", 12, ""), ("brushless", 12, "not armed")],
)
async def test_a_crashed_craft_recovers_when_it_stands_upright_again(kind, protocol, afterwards):
    with served(craft=kind, protocol=protocol) as craft:
        link = CrazyflieLink(craft.uri)
        kinds = []
        link.on_entry = lambda entry: kinds.append(entry["kind"])
        await link.open()
        with pytest.raises(BadInputError, match="does not say that it has crashed"):
            await ask_to_recover(link)
        await crash(craft, link)
        assert "groundstation motors recover" in link.supervisor.hindrance
        with pytest.raises(LinkError, match="set it upright"):
            await ask_to_recover(link)
        assert "recover" not in kinds
        lying(craft, UPRIGHT)
        await eventually(lambda: not link.supervisor.tumbled)
        await ask_to_recover(link)
        await eventually(lambda: "has crashed" not in link.supervisor.hindrance)
        await eventually(lambda: afterwards in link.supervisor.hindrance)
        assert bool(link.supervisor.hindrance) == bool(afterwards)
        assert kinds.count("recover") == 1
        await link.close()


async def test_a_craft_that_says_what_is_wrong_with_it_is_not_even_asked_to_arm():
    with served(craft="brushless", protocol=12) as craft:
        link = CrazyflieLink(craft.uri)
        kinds = []
        link.on_entry = lambda entry: kinds.append(entry["kind"])
        await link.open()
        lying(craft, ON_ITS_BACK)
        await eventually(lambda: link.supervisor.tumbled)
        with pytest.raises(LinkError, match="refuses to arm its motors: the craft lies on its"):
            await ask_to_arm(link, True)
        assert kinds == []
        await link.close()


async def test_firmware_of_2014_has_nothing_to_recover_from():
    with served() as craft:
        link = CrazyflieLink(craft.uri)
        await link.open()
        with pytest.raises(BadInputError, match="does not say that it has crashed"):
            await ask_to_recover(link)
        await link.close()


async def test_the_failsafe_goes_on_where_the_craft_does_not_know_its_height_any_more():
    """Nothing may keep him from stopping the motors then."""

    with served(craft="crazyflie21") as craft:
        link = CrazyflieLink(craft.uri)
        entries = []
        link.on_entry = entries.append
        await link.open()
        with pytest.raises(BadInputError, match="holds no height"):
            link.setpoint(0.0, 0.0, 0.0, 0, height_m=0.4)
        send_level(link, 0, "dead man", 0.4)
        assert entries == []
        send_level(link, 0, "dead man")
        assert [entry["client"] for entry in entries] == ["dead man"]
        await link.close()
