"""Commands through the official client library to a stand-in over UDP."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from firmware_sim.craft import CraftState
from firmware_sim.supervisor import LOCKED
from groundstation.errors import BadInputError, LinkError
from groundstation.links import crazyflie
from groundstation.links.command import CommandState, Place, Supervisor
from groundstation.links.crazyflie import CrazyflieLink
from groundstation.links.factory import make_command_link
from groundstation.telemetry.samples import LogTable
from support.crafts import ServedCraft, served
from support.crafts import flown_link as flown
from support.programs import free_port
from support.waiting import PATIENCE_S, eventually, until

Scenario = Callable[[CrazyflieLink, list[dict[str, Any]]], Awaitable[None]]


def on_a_stand_in(scenario: Scenario) -> Callable[[], Awaitable[None]]:
    """A test of a link to a stand-in of 2014, and of what it records."""

    async def play() -> None:
        async with flown({"program": "wait"}) as uri:
            link = CrazyflieLink(uri)
            entries: list[dict[str, Any]] = []
            link.on_entry = entries.append
            await link.open()
            try:
                await scenario(link, entries)
            finally:
                await link.close()

    return play


@on_a_stand_in
async def test_every_gain_is_known_after_connecting(
    link: CrazyflieLink, entries: list[dict[str, Any]]
) -> None:
    assert link.state is CommandState.CONNECTED
    parameters = link.parameters()
    assert parameters["pid_rate.roll_kp"] == 70
    assert parameters["pid_attitude.pitch_kp"] == 3.5


@on_a_stand_in
async def test_a_written_gain_is_confirmed_by_the_craft_and_recorded_both_ways(
    link: CrazyflieLink, entries: list[dict[str, Any]]
) -> None:
    assert await link.write_parameter("pid_rate.roll_kp", 55.5) == 55.5
    assert link.parameters()["pid_rate.roll_kp"] == 55.5
    assert [(e["direction"], e["kind"], e["value"]) for e in entries] == [
        ("out", "parameter", 55.5),
        ("in", "parameter", 55.5),
    ]


@pytest.mark.parametrize(
    ("roll", "pitch", "yaw", "thrust"),
    [(math.nan, 0, 0, 0), (0, math.inf, 0, 0), (0, 0, 1e4, 0), (60, 0, 0, 0), (0, 0, 0, 70000)],
)
def test_a_setpoint_that_is_not_sane_is_refused_before_it_is_sent(
    roll: float, pitch: float, yaw: float, thrust: int
) -> None:
    link = CrazyflieLink("udp://127.0.0.1:1")
    entries: list[dict[str, Any]] = []
    link.on_entry = entries.append
    with pytest.raises(BadInputError, match="setpoint"):
        link.setpoint(roll, pitch, yaw, thrust)
    assert entries == []


@on_a_stand_in
async def test_a_setpoint_is_recorded_as_sent(
    link: CrazyflieLink, entries: list[dict[str, Any]]
) -> None:
    link.setpoint(1.5, -2.0, 10.0, 30000)
    assert entries[0]["kind"] == "setpoint"
    assert entries[0]["thrust"] == 30000
    assert entries[0]["pitch_deg"] == -2.0


@on_a_stand_in
async def test_unknown_parameters_and_values_that_no_craft_should_get_are_refused(
    link: CrazyflieLink, entries: list[dict[str, Any]]
) -> None:
    with pytest.raises(BadInputError, match="no parameter"):
        await link.write_parameter("pid_rate.nonsense", 1.0)
    with pytest.raises(BadInputError, match="turns motors"):
        await link.write_parameter("motorPowerSet.enable", 1.0)
    with pytest.raises(BadInputError, match="finite"):
        await link.write_parameter("pid_rate.roll_kp", math.nan)
    for value in (-1.0, 1000.5):
        with pytest.raises(BadInputError, match=r"outside 0\.\.1000"):
            await link.write_parameter("pid_rate.roll_kp", value)
    assert entries == []


async def test_two_connections_in_a_row_work() -> None:
    async with flown({"program": "wait"}) as uri:
        for _ in range(2):
            link = make_command_link(uri)
            await link.open()
            assert "pid_rate.yaw_ki" in link.parameters()
            await link.close()
            await link.close()
            assert link.state is CommandState.CLOSED


def test_a_craft_that_does_not_answer_gives_one_clear_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("groundstation.links.crazyflie_connection.FIRST_S", 0.5)
    link = CrazyflieLink(f"udp://127.0.0.1:{free_port()}")
    with pytest.raises(LinkError, match=r"no craft answered within 0\.5 s|refused"):
        asyncio.run(link.open())
    assert link.state is CommandState.CLOSED


@pytest.mark.parametrize(
    "uri",
    [
        *("http://x", "udp:", "nonsense", "udp://127.0.0.1", "udp://127.0.0.1:99999", "usb://x"),
        *("radio://0", "radio://0/126/2M", "radio://0/80/3M", "radio://0/80/2m"),
        "radio://0/80/2M/E7E7E7E7EX",
    ],
)
def test_what_can_be_no_address_is_refused_before_anything_is_tried(uri: str) -> None:
    with pytest.raises(BadInputError, match="is no address of a craft: give udp"):
        make_command_link(uri)


@pytest.mark.parametrize(
    "uri", ["radio://0/80", "radio://0/80/250K/e7e7e7e701", "radio://5CC6CC66B8/2/1M", "usb://1"]
)
def test_every_form_of_address_that_the_library_knows_is_taken(uri: str) -> None:
    assert make_command_link(uri).uri == uri


@pytest.mark.parametrize(
    ("protocol", "knows"), [(7, "height_deck"), (10, "height_deck"), (12, "positioned")]
)
def test_a_craft_that_knows_its_height_holds_it_and_leans_and_turns_in_the_signs_of_the_telemetry(
    protocol: int, knows: str
) -> None:
    entries: list[dict[str, Any]] = []

    async def fly(craft: ServedCraft) -> tuple[CraftState, CraftState]:
        link = CrazyflieLink(craft.uri)
        link.on_entry = entries.append
        await link.open()
        async with asyncio.timeout(PATIENCE_S):
            while not (link.holds_height and link.supervisor.height_m is not None):
                await asyncio.sleep(0.02)
        assert abs(link.supervisor.height_m or 0.0) < 0.05
        for k in range(300):
            link.setpoint(0, 0, 0, 0, height_m=min(0.004 * k, 0.5))
            await asyncio.sleep(0.01)
        before = craft.craft.state()
        for _ in range(60):
            link.setpoint(0, 8.0, 40.0, 0, height_m=0.5)
            await asyncio.sleep(0.01)
        after = craft.craft.state()
        with pytest.raises(BadInputError, match="not both"):
            link.setpoint(0, 0, 0, 30000, height_m=0.5)
        with pytest.raises(BadInputError, match=r"outside 0\.\.3"):
            link.setpoint(0, 0, 0, 0, height_m=math.nan)
        link.setpoint(0, 0, 0, 0)
        await link.close()
        return before, after

    with served(craft="crazyflie21", protocol=protocol, **{knows: True}) as craft:
        before, after = asyncio.run(fly(craft))
        until(lambda: not craft.craft.state().thrust, "no thrust")
    assert before.position_m[2] == pytest.approx(0.5, abs=0.15)
    assert after.angles_deg[1] < -3.0  # the firmware counts nose up
    assert after.angles_deg[2] > before.angles_deg[2] + 5.0
    assert entries[-1]["thrust"] == 0
    assert "height_m" not in entries[-1]
    assert max(entry.get("height_m", 0.0) for entry in entries) == 0.5


@pytest.mark.parametrize("protocol", [7, 12])
async def test_a_craft_with_a_flow_deck_moves_forward_and_left_as_it_is_headed_and_says_so(
    protocol: int,
) -> None:
    number = 0xABC << 64 | 5  # the first of its three parts is the lowest
    with served(craft="crazyflie21", flow_deck=True, protocol=protocol, cpu_id=number) as craft:
        link = CrazyflieLink(craft.uri)
        entries: list[dict[str, Any]] = []
        tables: list[LogTable] = []
        link.on_entry, link.on_table = entries.append, tables.append
        await link.open()
        assert (link.vehicle, link.craft_id) == ("crazyflie21", "000000050000000000000abc")
        async with asyncio.timeout(PATIENCE_S):
            while not (link.holds_place and link.supervisor.place is not None):
                await asyncio.sleep(0.02)

        async def go(seconds: float, vx_m_s: float, vy_m_s: float, yaw_dps: float = 0.0) -> Place:
            for _ in range(round(50 * seconds)):
                link.setpoint(0, 0, yaw_dps, 0, height_m=0.5, vx_m_s=vx_m_s, vy_m_s=vy_m_s)
                await asyncio.sleep(0.02)
            assert link.supervisor.place is not None
            return link.supervisor.place

        begun = await go(3.0, 0.0, 0.0)
        assert begun.tilt_deg < 10.0
        ahead = await go(1.5, 0.4, 0.0)
        assert ahead.x_m > begun.x_m + 0.15
        assert ahead.vx_m_s == pytest.approx(0.4, abs=0.2)
        aside = await go(1.5, 0.0, 0.4)
        assert aside.y_m > ahead.y_m + 0.15
        before_deg = craft.craft.state().angles_deg[2]
        await go(1.0, 0.0, 0.0, yaw_dps=40.0)
        assert craft.craft.state().angles_deg[2] > before_deg + 15.0
        truth, said = craft.craft.state().position_m, link.supervisor.place
        assert said is not None
        assert (said.x_m, said.y_m) == pytest.approx(truth[:2], abs=0.3)
        link.setpoint(0, 0, 0, 0)
        await link.close()
        assert {entry.get("vx_m_s") for entry in entries} == {0.0, 0.4, None}
        heights = [float(one.columns["stateEstimate.z"][0]) for one in tables]
        assert max(heights) == pytest.approx(0.5, abs=0.15)


async def test_a_craft_that_is_gone_is_said_to_be_gone_and_not_to_lack_a_deck() -> None:
    with served(craft="crazyflie21", height_deck=True) as craft:
        link = make_command_link(craft.uri)
        await link.open()
        link.setpoint(0, 0, 0, 0, height_m=0.1)
        await link.close()
        with pytest.raises(LinkError, match="is not connected"):
            link.setpoint(0, 0, 0, 0, height_m=0.1)


@pytest.mark.parametrize("protocol", [10, 12])
async def test_an_emergency_stop_locks_the_craft_of_either_supervisor(protocol: int) -> None:
    with served(craft="crazyflie21", protocol=protocol) as craft:
        link = make_command_link(craft.uri)
        kinds = []
        link.on_entry = lambda entry: kinds.append(entry["kind"])
        await link.open()
        assert link.emergency_stop()
        await eventually(lambda: craft.craft.state().supervisor == LOCKED, "the lock")
        await eventually(lambda: "has locked itself" in link.supervisor.trouble, "its word")
        assert kinds == ["emergency stop"]
        await link.close()
        assert not link.emergency_stop()


@on_a_stand_in
async def test_firmware_of_2014_has_no_emergency_stop(
    link: CrazyflieLink, entries: list[dict[str, Any]]
) -> None:
    assert not link.emergency_stop()
    assert entries == []


async def test_a_craft_that_flies_is_left_its_height_where_it_does_not_know_it_for_a_moment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with served(craft="crazyflie21", positioned=True) as craft:
        link = CrazyflieLink(craft.uri)
        await link.open()
        async with asyncio.timeout(PATIENCE_S):
            while not link.holds_height:
                await asyncio.sleep(0.02)
            while not link.supervisor.flies:
                link.setpoint(0, 0, 0, 0, height_m=0.4)
                await asyncio.sleep(0.02)
            monkeypatch.setattr(crazyflie, "HEIGHT_LOST_S", PATIENCE_S)
            craft.craft._firmware[0]["knows_height"] = 0
            said: list[Supervisor] = []
            while len(said) < 3 or said[-3].height_m is not None:
                link.setpoint(0, 0, 0, 0, height_m=0.4)
                await asyncio.sleep(0.02)
                if not said or link.supervisor is not said[-1]:
                    said.append(link.supervisor)
            assert link.holds_height
            monkeypatch.setattr(crazyflie, "HEIGHT_LOST_S", 0.0)
            while link.holds_height:
                link.setpoint(0, 0, 0, 0, height_m=0.4)
                await asyncio.sleep(0.02)
            assert link.supervisor.flies
        with pytest.raises(BadInputError, match="a positioning system"):
            link.setpoint(0, 0, 0, 0, height_m=0.4)
        await link.close()


@on_a_stand_in
async def test_a_craft_without_such_a_deck_or_firmware_is_asked_for_no_height(
    link: CrazyflieLink, entries: list[dict[str, Any]]
) -> None:
    assert not link.holds_height
    with pytest.raises(BadInputError, match="a deck that measures it"):
        link.setpoint(0, 0, 0, 0, height_m=0.5)
    assert entries == []
