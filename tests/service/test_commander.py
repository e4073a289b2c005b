"""Commanding through the daemon: cflib over UDP to a stand-in, whose pilot holds the height.

What happens and in which order; when it does is told on a clock that the test turns, in
``tests/safety/test_stop_on_a_clock.py``.
"""

import asyncio
import contextlib
import math
import time

import numpy as np
import pytest

from groundstation.errors import BadInputError, GroundStationError, NotAuthorisedError
from groundstation.links.command import CommandState
from groundstation.service import commander
from groundstation.service import commander as freshness
from groundstation.service.client import Client, Pilot, ask, live
from groundstation.service.config import Config, FailsafeConfig, LinkConfig, RecordingConfig
from groundstation.service.lease import LANDED
from support import RECORDINGS
from support.crafts import run_flat
from support.programs import free_port
from support.waiting import in_real_time, until
from support.worlds import only_recording as recorded
from support.worlds import serve

HOVER = 40000
PATIENT = {"level_s": 1.0, "stop_s": 4.0}
"""The failsafe's limits where a loaded machine must not meet them."""
FRESH_S = 10.0
"""Nor the age at which a setpoint is refused."""


@pytest.fixture
def crafts():
    """The software crafts that were flown."""
    return []


@pytest.fixture
def stations():
    """The daemons that have flown."""
    return []


@pytest.fixture
def fly(tmp_path, path, crafts, stations, monkeypatch):
    """Runs a conversation with a daemon whose craft can be commanded; then its recording."""
    for module in (commander, freshness):
        monkeypatch.setattr(module, "LIFE_S", FRESH_S)

    def flying(conversation, stand_in=None, **failsafe):
        config = Config(
            link=LinkConfig(name="stand-in"),
            command=f"udp://127.0.0.1:{free_port()}",
            stand_in={"program": "wait", "altitude_hold": True} if stand_in is None else stand_in,
            recording=RecordingConfig(folder=str(tmp_path / "sessions"), low_space_mb=0),
            failsafe=FailsafeConfig(**failsafe),
        )

        def connected(station):
            until(
                lambda: ask(path, "GET", "/status")["command"]["state"] == "connected",
                "the command link is connected",
            )
            stations.append(station)
            crafts.append(station.receiver.link._craft)
            conversation()

        serve(config, path, connected)
        return recorded(config)

    return flying


def steer(pilot, seconds, *, roll=0.0, pitch=0.0, yaw=0.0, thrust=HOVER):
    """Command for some time; the last answer."""
    answer = None
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        answer = pilot.setpoint(roll, pitch, yaw, thrust)
        time.sleep(0.02)
    return answer


def in_the_loop(station, work):
    """Run ``work`` in the daemon's own event loop."""
    return asyncio.run_coroutine_threadsafe(work, station._loop).result(30)


async def burst(commanding, token):
    """From within the daemon: through the socket a slow machine may itself be slower than 100 a
    second."""
    for _ in range(600):
        commanding.setpoint(token, 0, 0, 0, 0)


def setpoints(recording):
    return [entry for entry in recording.commands if entry["kind"] == "setpoint"]


def test_the_craft_leans_and_turns_as_commanded_in_the_signs_of_the_telemetry(fly, path):
    def conversation():
        with Pilot(path, "test") as pilot:

            def leans(axis, angle_deg, **command):
                until(
                    lambda: steer(pilot, 0.1, **command)["telemetry"][axis] > angle_deg,
                    f"{axis} has followed",
                )

            steer(pilot, 2.5)
            leans("roll_deg", 3.0, roll=8.0)
            steer(pilot, 0.6, roll=-8.0)
            leans("pitch_deg", 3.0, pitch=8.0)
            steer(pilot, 0.6, pitch=-8.0)
            yaw_deg = steer(pilot, 0.1)["telemetry"]["yaw_deg"]
            leans("yaw_deg", yaw_deg + 15.0, yaw=60.0)

    recording = fly(conversation, **PATIENT)
    sent = setpoints(recording)
    assert {entry["client"] for entry in sent} - {"dead man"} == {"test"}
    assert max(entry["pitch_deg"] for entry in sent) == 8.0
    assert recording.samples.duty.max() > 0.3


def test_two_clients_cannot_both_command(fly, path):
    def conversation():
        with Pilot(path, "first") as first:
            with (
                pytest.raises(GroundStationError, match="first is commanding"),
                Pilot(path, "second"),
            ):
                pass  # fmt: skip
            first.setpoint(0, 0, 0, 0)
        with Pilot(path, "second") as second:
            with pytest.raises(GroundStationError, match="acquire a lease"):
                first.setpoint(0, 0, 0, HOVER)
            first.close()
            second.setpoint(0, 0, 0, 0)

    recording = fly(conversation)
    assert [(entry["client"], entry["thrust"]) for entry in setpoints(recording)] == [
        ("first", 0),
        ("second", 0),
    ]


def test_nothing_leaves_without_an_authorised_client(fly, path, crafts):
    def conversation():
        with Client(path) as client:
            for token in ("", "x" * 32, "\u20ac"):
                for what, content in (
                    ("setpoint", {"thrust": HOVER}),
                    ("parameters", {"values": {"pid_rate.roll_kp": 50.0}}),
                    ("keep", {}),
                    ("release", {}),
                ):
                    with pytest.raises(GroundStationError, match="acquire a lease"):
                        client.ask("POST", f"/command/{what}", {"token": token, **content})
            for body in ({"thrust": HOVER}, {"token": None, "thrust": 1}, [1], None):
                with pytest.raises(GroundStationError):
                    client.ask("POST", "/command/setpoint", body)
            assert client.ask("GET", "/status")["command"]["setpoints"] == 0
            assert crafts[0]._firmware["client_ns"][0] < 0, "no setpoint has reached the craft"

    assert fly(conversation).commands == []


def test_a_client_that_vanishes_means_level_and_then_motors_off(fly, path):
    def conversation():
        pilot = Pilot(path, "doomed").__enter__()
        steer(pilot, 1.5, roll=5.0)
        pilot.close()
        until(
            lambda: any("motors stopped, " in e["text"] for e in ask(path, "GET", "/events")),
            "the motors stand",
        )
        with Pilot(path, "next") as following:
            following.setpoint(0, 0, 0, 0)

    recording = fly(conversation, **PATIENT)
    entries = setpoints(recording)
    last = max(k for k, entry in enumerate(entries) if entry["client"] == "doomed")
    after = [entry for entry in entries[last + 1 :] if entry["client"] == "dead man"]
    assert {(entry["roll_deg"], entry["pitch_deg"]) for entry in after} == {(0.0, 0.0)}
    thrusts = [entry["thrust"] for entry in after]
    assert set(thrusts) == {HOVER, 0}
    assert thrusts == sorted(thrusts, reverse=True), "thrust comes back after the stop"
    told = [event["text"] for event in recording.events]
    level, vanished, stopped = (
        next(k for k, text in enumerate(told) if part in text)
        for part in (
            "no setpoint from doomed: level attitude",
            "doomed has vanished: its motors are asked to stop",
            "motors stopped, ",
        )
    )
    assert level < vanished < stopped
    assert recording.samples.duty.any()
    assert not recording.samples.duty[-1].any()


def test_a_client_that_vanishes_at_a_height_means_level_there_and_then_a_landing(fly, path):
    def conversation():
        pilot = Pilot(path, "doomed").__enter__()
        assert pilot.lease["holds_height"]
        for k in range(60):
            pilot.setpoint(5.0, 0, 0, height_m=min(0.01 * k, 0.4))
            time.sleep(0.02)
        pilot.close()
        until(lambda: ask(path, "GET", "/status")["command"]["client"] is None, "the lease is over")
        with pytest.raises(GroundStationError, match="being landed"), Pilot(path, "too soon"):
            pass
        assert pilot.land() == LANDED
        pilot.close()
        with Pilot(path, "next") as following:
            assert following.setpoint(0, 0, 0)["telemetry"]["motors"] == [0.0] * 4

    today = {"craft": "crazyflie21", "program": "wait", "height_deck": True}
    recording = fly(conversation, today, level_s=0.5, stop_s=1.5)
    entries = setpoints(recording)
    last = max(k for k, entry in enumerate(entries) if entry["client"] == "doomed")
    assert entries[last]["height_m"] == 0.4
    after = [entry for entry in entries[last + 1 :] if entry["client"] == "dead man"]
    assert {(entry["roll_deg"], entry["thrust"]) for entry in after} == {(0.0, 0)}
    heights = [entry.get("height_m") for entry in after]
    assert heights[0] == 0.4
    assert heights[-1] is None
    asked = [height for height in heights if height is not None]
    assert asked == sorted(asked, reverse=True), "it is asked to rise again"
    assert asked[-1] < 0.2
    assert (recording.samples.duty > 0).any(axis=1).sum() > 100
    assert recording.tables["state"].columns["stateEstimate.z"].max() > 0.3


def test_a_daemon_that_ends_stops_the_motors_first(fly, path):
    def conversation():
        pilot = Pilot(path, "flying").__enter__()
        steer(pilot, 1.5)
        pilot.close()  # and the station is stopped at once

    recording = fly(conversation, **PATIENT)
    last = setpoints(recording)[-1]
    assert (last["thrust"], last["client"]) == (0, "dead man")


def test_an_operator_stops_the_motors_of_whoever_commands(fly, path, stations):
    def conversation():
        with pytest.raises(GroundStationError, match="nobody commands"):
            ask(path, "POST", "/command/level", {"on": True})
        with Pilot(path, "a program") as pilot:
            steer(pilot, 0.5)
            ask(path, "POST", "/command/stop")
            with pytest.raises(GroundStationError, match="the operator has stopped the motors"):
                pilot.setpoint(0.0, 0.0, 0.0, HOVER)
            until(lambda: stations[0].newest.telemetry().motors == [0.0] * 4, "the motors stand")
        ask(path, "POST", "/command/stop")  # also where nobody commands

    recording = fly(conversation, **PATIENT)
    told = [event["text"] for event in recording.events if event["kind"] == "stop"]
    assert told == [
        "the operator stops the motors; a program commands no more",
        "the operator stops the motors; nobody commanded",
    ]
    assert setpoints(recording)[-1]["client"] == "operator"


def test_an_operator_holds_the_craft_level_and_leaves_the_thrust_to_the_client(fly, path):
    def conversation():
        with Pilot(path, "a program") as pilot:
            steer(pilot, 0.3, roll=10.0)
            ask(path, "POST", "/command/level", {"on": True})
            assert ask(path, "GET", "/status")["command"]["held_level"] is True
            steer(pilot, 0.3, roll=11.0, yaw=50.0)
            ask(path, "POST", "/command/level", {"on": False})
            steer(pilot, 0.3, roll=12.0)
            ask(path, "POST", "/command/level", {"on": True})
            pilot.stop()
        assert ask(path, "GET", "/status")["command"]["held_level"] is False
        with Pilot(path, "another") as pilot:
            until(lambda: is_taken(pilot), "the stop is over")
            steer(pilot, 0.1, roll=13.0)

    def is_taken(pilot):
        with contextlib.suppress(GroundStationError):
            return pilot.setpoint(0.0, 0.0, 0.0, 0)

    sent = [
        entry for entry in setpoints(fly(conversation, **PATIENT)) if entry["client"] != "dead man"
    ]
    running = [(entry["roll_deg"], entry["yaw_dps"]) for entry in sent if entry["thrust"]]
    kept = [one for place, one in enumerate(running) if place == 0 or one != running[place - 1]]
    assert kept == [(10.0, 0.0), (0.0, 0.0), (12.0, 0.0), (13.0, 0.0)]


def test_a_daemon_that_stood_still_in_flight_takes_no_stale_setpoint(fly, path, stations):
    """The failsafe does not wait for the loop that stands still: level, then off."""

    async def stand_still(commander, token):
        until(lambda: commander.client is None, "the failsafe has ended the lease")  # blocks
        with pytest.raises(NotAuthorisedError, match="no setpoint came in time"):
            commander.setpoint(token, 0.0, 0.0, 0.0, HOVER)

    def conversation():
        with Pilot(path, "stale") as pilot:
            steer(pilot, 0.5)
            in_the_loop(stations[0], stand_still(stations[0].commander, pilot.lease["token"]))

    entries = setpoints(fly(conversation, **PATIENT))
    last = max(k for k, entry in enumerate(entries) if entry["client"] == "stale")
    after = entries[last + 1 :]
    assert {entry["client"] for entry in after} == {"dead man"}
    thrusts = [entry["thrust"] for entry in after]
    assert set(thrusts) == {HOVER, 0}
    assert thrusts == sorted(thrusts, reverse=True), "thrust comes back after the stop"


def test_a_lease_that_ends_ends_what_is_being_written(fly, path, stations):
    async def write_and_release(commander):
        token = commander.acquire("leaving").token
        values = {"pid_rate.roll_kp": 55.0, "pid_rate.pitch_kp": 56.0}
        sent = asyncio.Event()
        write = commander.link._write_parameter

        async def slowly(name, value):
            sent.set()
            return await write(name, value)

        commander.link._write_parameter = slowly
        writing = asyncio.create_task(commander.write_parameters(token, values))
        await sent.wait()
        commander.release(token)
        with pytest.raises(NotAuthorisedError, match=r"pid_rate\.pitch_kp and what comes after"):
            await writing

    def conversation():
        in_the_loop(stations[0], write_and_release(stations[0].commander))
        values = ask(path, "GET", "/command/parameters")["values"]
        assert (values["pid_rate.roll_kp"], values["pid_rate.pitch_kp"]) == (55.0, 70.0)

    fly(conversation)


def test_nobody_can_begin_to_command_a_daemon_that_ends(fly, path, stations):
    async def end(commander):
        ending = asyncio.create_task(commander.close())
        await asyncio.sleep(0)
        assert commander.link.state is CommandState.CONNECTED
        with pytest.raises(BadInputError, match="the daemon ends"):
            commander.acquire("late")
        await ending

    def conversation():
        pilot = Pilot(path, "flying").__enter__()
        steer(pilot, 0.3)
        pilot.close()
        in_the_loop(stations[0], end(stations[0].commander))

    assert setpoints(fly(conversation, **PATIENT))[-1]["thrust"] == 0


def test_a_silent_client_on_the_ground_loses_its_lease(fly, path):
    def conversation():
        with Pilot(path, "patient") as pilot:
            until(
                lambda: ask(path, "GET", "/status")["command"]["client"] is None,
                "the lease is over",
            )
            with pytest.raises(GroundStationError, match="patient was silent for 1 s"):
                pilot.keep()

    recording = fly(conversation, lease_s=1.0)
    assert "patient was silent for 1 s: its lease is over" in [e["text"] for e in recording.events]


def test_parameters_are_written_all_or_none_and_read_back(fly, path):
    gains = {"pid_rate.roll_kp": 55.5, "pid_attitude.pitch_ki": 0.1, "imu_acc_lpf.factor": 16}

    def conversation():
        with Pilot(path, "tuner") as pilot:
            before = pilot.parameters()
            for name, value in (
                ("pid_rate.nonsense", 1.0),
                ("pid_rate.pitch_kp", -1.0),
                ("pid_rate.pitch_kp", 1001.0),
                ("imu_acc_lpf.factor", 256),
                ("imu_acc_lpf.factor", 1.5),
                ("sensorfusion6.kp", 1e39),
            ):
                with pytest.raises(GroundStationError, match=name):
                    pilot.write({"pid_rate.roll_kp": 60.0, name: value})
            for bad in (math.nan, math.inf):
                with pytest.raises(GroundStationError, match="body"):
                    pilot.write({"pid_rate.roll_kp": bad})
            assert pilot.parameters() == before
            back = pilot.write(gains)
            assert back == {name: float(np.float32(value)) for name, value in gains.items()}
            assert pilot.parameters() == before | back

    recording = fly(conversation)
    written = [entry for entry in recording.commands if entry["kind"] == "parameter"]
    assert [(entry["name"], entry["direction"]) for entry in written] == [
        (name, direction) for name in gains for direction in ("out", "in")
    ]
    (known,) = [entry for entry in recording.commands if entry["kind"] == "parameters"]
    assert known["values"]["pid_rate.roll_kp"] == 70


def test_stored_gains_survive_a_power_cycle_of_the_craft(fly, path, crafts):
    name, stock = "pid_rate.roll_kp", 250.0
    stand_in = {"craft": "crazyflie21", "plant": "reduced", "program": "wait", "recharge_s": 0.5}

    def known(wanted):
        def look():
            return ask(path, "GET", "/status")["command"]["stored"] == wanted

        until(look, f"{wanted} is what the status says is stored")

    def conversation():
        (craft,) = crafts
        known({})
        with Pilot(path, "tuner") as pilot:
            assert pilot.stored()[name] == {"now": stock, "default": stock, "stored": None}
            pilot.write({name: 55.5})
            assert pilot.store()[name] == {"now": 55.5, "default": stock, "stored": 55.5}
        run_flat(craft)
        until(lambda: craft.boots == 2, "a charged cell is in")
        assert craft.get_parameter(name) == 55.5
        known({name: 55.5})
        with Pilot(path, "tuner") as pilot:
            assert pilot.clear_stored()[name] == {"now": 55.5, "default": stock, "stored": None}
            pilot.setpoint(0.0, 0.0, 0.0, 0)
            steer(pilot, 0.5)
            with pytest.raises(GroundStationError, match="land first"):
                pilot.store(name)
            pilot.stop()
        run_flat(craft)
        until(lambda: craft.boots == 3, "a charged cell is in")
        assert craft.get_parameter(name) == stock

    with in_real_time():
        try:
            recording = fly(conversation, stand_in)
        except GroundStationError as error:  # late telemetry says of no motor that it stands
            raise AssertionError(str(error)) from error
    said = [event["text"] for event in recording.events if event["kind"] == "stored"]
    assert said == [
        f"tuner has stored {name} 55.5 on the craft",
        f"tuner has cleared the stored {name} on the craft",
    ]


def test_a_craft_whose_firmware_stores_nothing_says_so(fly, path):
    def conversation():
        assert not ask(path, "GET", "/status")["command"]["stores"]
        with Pilot(path, "tuner") as pilot:
            for work in (pilot.stored, pilot.store, pilot.clear_stored):
                with pytest.raises(GroundStationError, match="stores no parameters"):
                    work()

    fly(conversation)


def test_setpoints_that_come_too_fast_or_are_out_of_range_are_refused(fly, path, stations):
    def conversation():
        with Pilot(path, "fast") as pilot:
            with pytest.raises(GroundStationError, match="faster than 100 a second"):
                in_the_loop(stations[0], burst(stations[0].commander, pilot.lease["token"]))
            time.sleep(0.2)
            with pytest.raises(GroundStationError, match="thrust 70000"):
                pilot.setpoint(0, 0, 0, 70000)
            with pytest.raises(GroundStationError, match="roll_deg 50"):
                pilot.setpoint(50, 0, 0, 0)

    assert 100 <= len(setpoints(fly(conversation))) < 600


def test_the_stream_carries_samples_events_and_marks(fly, path):
    seen = {}

    def conversation():
        with Pilot(path, "marker") as pilot:
            for kind, content in live(path):
                if kind not in seen:
                    seen[kind] = content
                    pilot.mark("step 1", axis="roll")
                if kind == "event" and content["kind"] == "mark":
                    seen["mark"] = content
                if {"samples", "statistics", "mark"} <= set(seen):
                    break
        assert ask(path, "GET", "/status")["stream"]["clients"] <= 1

    recording = fly(conversation)
    assert seen["mark"]["details"] == {"axis": "roll"}
    assert seen["samples"]["dropped"] == 0
    rows = len(seen["samples"]["ticks"])
    assert np.shape(seen["samples"]["gyro_rad_s"]) == (rows, 3)
    where = np.searchsorted(recording.samples.ticks, seen["samples"]["ticks"])
    np.testing.assert_allclose(
        recording.samples.attitude[where], seen["samples"]["attitude_rad"], atol=1e-6
    )
    assert "step 1" in [event["text"] for event in recording.events if event["kind"] == "mark"]


@pytest.mark.parametrize(
    ("link", "command", "says"),
    [
        ("stand-in", "", "no command link"),
        (f"replay:{RECORDINGS / 'stand_in_flight.mcap'}", "udp://127.0.0.1:1", "is a recording"),
        ("stand-in", "radio://0/80/2M", "the telemetry is the stand-in's"),
    ],
)
def test_where_no_craft_can_be_commanded_a_client_is_told_why(tmp_path, path, link, command, says):
    config = Config(
        link=LinkConfig(name=link),
        command=command,
        recording=RecordingConfig(folder=str(tmp_path), enabled=False),
    )

    def conversation(station):
        with pytest.raises(GroundStationError, match=says), Pilot(path, "hopeful"):
            pass
        told = [event.text for event in station.journal.events if event.kind == "waiting"]
        assert (len(told) == 1 and says in told[0]) == bool(command)

    serve(config, path, conversation)
