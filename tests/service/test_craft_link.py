"""The daemon and a stock craft: telemetry by its log, commands on the same connection."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from groundstation.errors import LinkError
from groundstation.links.base import LinkState
from groundstation.links.command import DISARMED_ITSELF, CommandState, Supervisor
from groundstation.links.crazyflie import STATE_S
from groundstation.recording.formats import open_recording
from groundstation.recording.quality import inspect_recording
from groundstation.service import control
from groundstation.service.config import RadioConfig
from groundstation.service.station import Station
from support.crafts import ServedCraft, served
from support.waiting import eventually
from support.worlds import running, station_on

PATIENCE_S = 20.0


@pytest.fixture(scope="module")
def craft() -> Iterator[ServedCraft]:
    with served(craft="crazyflie21", plant="reduced") as running:
        yield running


def station_for(craft: ServedCraft, folder, **radio) -> Station:
    return station_on(craft.uri, folder, radio=RadioConfig(**radio))


def run(station: Station, scenario) -> None:
    async def session() -> None:
        async with running(station), asyncio.timeout(PATIENCE_S):
            await scenario()

    asyncio.run(session())


async def heard(station: Station, rows: int) -> None:
    """Wait for so many rows in the statistics."""
    await eventually(lambda: station.statistics is not None and station.statistics.samples > rows)


def recorded(folder):
    (path,) = folder.glob("*.mcap")
    return open_recording(path)


def test_a_flight_is_recorded_without_loss_and_says_whose_it_was(craft, tmp_path):
    station = station_for(craft, tmp_path, rate_hz=250)

    async def scenario() -> None:
        await heard(station, 300)

    run(station, scenario)
    recording = recorded(tmp_path)
    report = inspect_recording(recording)
    assert report["rate_hz"] == pytest.approx(250, rel=0.02)
    assert report["lost_samples"] == 0
    assert report["segments"] == 1
    assert recording.metadata["vehicle"] == {"profile": "crazyflie21"}
    assert set(report["missing"]) == {f"rotor_{m}" for m in range(1, 5)}
    assert recording.samples.accelerometer[:, 2].mean() == pytest.approx(9.81, rel=0.05)
    assert np.abs(np.degrees(recording.samples.gyro)).max() < 5
    assert station.statistics.packets > 2 * 300
    (found,) = [event for event in station.journal.events if event.kind == "found"]
    assert "Crazyflie 2.1" in found.text
    assert "250 times a second" in found.text
    assert "no rotor speeds (rpm.m1 or motor.m1_rpm)" in found.text
    assert any(event.kind == "console" for event in station.journal.events)


def test_what_else_is_logged_is_a_table_of_the_recording_on_the_telemetrys_own_time(
    craft, tmp_path
):
    station = station_for(craft, tmp_path, log="supervisor.info, stateEstimateZ.quat,pm.vbat")

    async def scenario() -> None:
        await heard(station, 200)

    run(station, scenario)
    recording = recorded(tmp_path)
    table = recording.tables["log"]
    assert list(table.columns) == ["supervisor.info", "stateEstimateZ.quat", "pm.vbat"]
    assert len(table.time_s) > 200
    period = np.median(np.diff(recording.samples.time_s))
    assert np.median(np.diff(table.time_s)) == pytest.approx(period)
    assert table.time_s[0] > recording.samples.time_s[0] - 0.1
    assert abs(table.time_s[-1] - recording.samples.time_s[-1]) < 0.2
    assert set(table.columns["supervisor.info"].astype(int) & 2) == {2}  # armed
    assert table.columns["pm.vbat"].mean() == pytest.approx(
        recording.samples.battery_v.mean(), 0.01
    )
    tables = inspect_recording(recording)["tables"]
    assert set(tables) == {"log", "state"}
    assert tables["log"] == len(table.time_s)


def test_where_the_craft_is_is_recorded_on_the_telemetrys_own_time(tmp_path):
    with served(craft="crazyflie21", flow_deck=True) as craft:
        station = station_for(craft, tmp_path)

        async def scenario() -> None:
            await eventually(lambda: control.place(station.commander.link) is not None)
            await heard(station, 200)

        run(station, scenario)
    recording = recorded(tmp_path)
    table = recording.tables["state"]
    names = [f"stateEstimate.{name}" for name in ("x", "y", "z", "vx", "vy", "vz")]
    assert list(table.columns) == [
        *names,
        *(f"stabilizer.{name}" for name in ("roll", "pitch", "thrust")),
    ]
    assert np.median(np.diff(table.time_s)) == pytest.approx(0.04, abs=0.002)
    assert abs(table.time_s[-1] - recording.samples.time_s[-1]) < 0.3
    assert np.abs(table.columns["stateEstimate.z"]).max() < 0.1


def test_the_same_connection_carries_commands(craft, tmp_path):
    station = station_for(craft, tmp_path)

    async def scenario() -> None:
        commander = station.commander
        await eventually(lambda: commander.link.state is CommandState.CONNECTED)
        lease = commander.acquire("test")
        before = commander.parameters()["pid_rate.roll_kp"]
        assert await commander.write_parameters(lease.token, {"pid_rate.roll_kp": 61.0}) == {
            "pid_rate.roll_kp": 61.0
        }
        commander.setpoint(lease.token, 0.0, 0.0, 0.0, 20000)
        await eventually(lambda: craft.craft.state().thrust == 20000)
        commander.release(lease.token)
        await eventually(lambda: craft.craft.state().thrust == 0)
        craft.craft.set_parameter("pid_rate.roll_kp", before)

    run(station, scenario)
    kinds = {entry["kind"] for entry in recorded(tmp_path).commands}
    assert {"parameters", "parameter", "setpoint"} <= kinds


def test_a_silent_craft_is_connected_to_again_and_the_recording_goes_on(
    craft, tmp_path, monkeypatch
):
    monkeypatch.setattr("groundstation.links.crazyflie.SILENT_S", 0.6)
    station = station_for(craft, tmp_path)
    server = craft.server
    send = server._send

    async def scenario() -> None:
        await eventually(lambda: station.receiver.state is LinkState.STREAMING)
        server._send = lambda packet, addr: None
        await eventually(lambda: station.receiver.state is LinkState.LOST)
        server._send = send
        await eventually(lambda: station.receiver.state is LinkState.STREAMING)
        before = station.statistics
        await eventually(lambda: station.statistics is not before)

    try:
        run(station, scenario)
    finally:
        server._send = send
    segments = np.unique(recorded(tmp_path).samples.segment)
    assert segments.tolist() == [0, 1]


def test_what_a_craft_says_it_is_does_not_override_the_configuration(craft, tmp_path):
    config = station_for(craft, tmp_path).config
    station = Station(msgspec.structs.replace(config, vehicle="brushless"))

    async def scenario() -> None:
        await eventually(lambda: station.receiver.state is LinkState.STREAMING)

    run(station, scenario)
    assert recorded(tmp_path).metadata["vehicle"] == {"profile": "brushless"}
    (said,) = [event.text for event in station.journal.events if event.kind == "vehicle"]
    assert said == "the craft says it is a crazyflie21; recordings say brushless, as configured"


def test_a_craft_answers_whether_it_is_armed_and_what_it_refuses_is_told(craft, tmp_path):
    station = station_for(craft, tmp_path)

    async def scenario() -> None:
        link = station.commander.link
        await eventually(lambda: link.state is CommandState.CONNECTED)
        await station.commander.operator.arm(True)
        assert control.status_of(station)["command"]["armed"] is True
        await eventually(lambda: link.supervisor.arms_itself)
        with pytest.raises(LinkError, match="has armed itself again, as a brushed one does"):
            await station.commander.operator.arm(False)

    run(station, scenario)
    assert [one["kind"] for one in recorded(tmp_path).commands] == ["arm", "disarm"]


def test_nothing_is_claimed_of_arming_that_the_craft_does_not_say(tmp_path, monkeypatch):
    monkeypatch.setattr("groundstation.links.crazyflie.SILENT_S", 0.6)
    with served(craft="brushless", plant="reduced", protocol=12) as craft:
        station = station_for(craft, tmp_path)
        link = station.commander.link

        def armed() -> bool | None:
            return control.status_of(station)["command"]["armed"]

        async def scenario() -> None:
            await eventually(lambda: link.state is CommandState.CONNECTED)
            await eventually(lambda: link.supervisor.bits is not None)
            assert armed() is False
            await station.commander.operator.arm(True)
            await eventually(lambda: link.supervisor.armed)
            assert armed() is True
            await asyncio.sleep(STATE_S)
            craft.craft.arm(False)  # as it does where it is not flown soon
            await eventually(lambda: armed() is False)
            await station.commander.operator.arm(True)
            craft.server._send = lambda packet, addr: None
            await eventually(lambda: link.state is not CommandState.CONNECTED)
            assert armed() is None

        run(station, scenario)
    (told,) = [one for one in station.journal.events if one.text == DISARMED_ITSELF]
    assert told.kind == "disarmed"


def test_firmware_in_software_that_repeats_a_request_to_arm_is_not_called_armed(tmp_path):
    """As that of April 2024 answers: one that is locked says so in its log alone."""
    with served(craft="brushless", plant="reduced", protocol=7, software_build=True) as craft:
        station = station_for(craft, tmp_path)
        link = station.commander.link

        async def scenario() -> None:
            await eventually(lambda: link.state is CommandState.CONNECTED)
            await eventually(lambda: link.supervisor.bits is not None)
            with pytest.raises(LinkError, match="refuses to arm its motors"):
                await station.commander.operator.arm(True)
            assert control.status_of(station)["command"]["armed"] is False
            craft.craft.emergency_stop()
            await eventually(lambda: link.supervisor.trouble)
            with pytest.raises(LinkError, match="refuses to arm its motors: the craft has locked"):
                await station.commander.operator.arm(True)

        run(station, scenario)


def test_parameters_of_a_craft_that_is_away_are_refused_as_such_and_not_as_unknown(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("groundstation.links.crazyflie.SILENT_S", 0.6)
    with served(craft="crazyflie21", plant="reduced") as craft:
        station = station_for(craft, tmp_path)
        link = station.commander.link

        async def scenario() -> None:
            await eventually(lambda: link.state is CommandState.CONNECTED)
            lease = station.commander.acquire("test")
            craft.server._send = lambda packet, addr: None
            await eventually(lambda: link.state is not CommandState.CONNECTED)
            with pytest.raises(LinkError, match="is not connected"):
                await station.commander.write_parameters(lease.token, {"pid_rate.roll_kp": 61.0})

        run(station, scenario)


def test_a_craft_that_arms_itself_again_after_a_landing_is_no_event(tmp_path):
    """Three seconds behind a landing today's firmware disarms, and a brushed craft arms itself."""
    with served(craft="crazyflie21", plant="reduced") as craft:
        station = station_for(craft, tmp_path)
        link = station.commander.link

        async def scenario() -> None:
            await eventually(lambda: link.supervisor.arms_itself and link.armed)
            for said in (0b100, 0b110):  # as between two of its steps
                link._take_state(Supervisor(said))
            assert link.armed

        run(station, scenario)
    assert not [one for one in station.journal.events if one.kind == "disarmed"]
