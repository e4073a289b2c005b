"""The installed daemon, the official library and stand-ins, in the orders that once turned a
motor; the others are in ``test_any_order.py``, on a clock that the test turns."""

import contextlib
import json
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from groundstation.cli.flying import Flight as FlightOfPrograms
from groundstation.cli.flying import commanded, stopped_after
from groundstation.errors import GroundStationError
from groundstation.service.client import Pilot, ask
from groundstation.service.lease import LANDED, STOPPED
from support.crafts import served
from support.daemons import Daemon, groundstation
from support.waiting import until

CRAFT = {"craft": "crazyflie21", "plant": "reduced"}
FLOW = {"craft": "crazyflie21", "flow_deck": True}
HEIGHT_M = 0.5
THRUST = 20000


class Heard:
    """The thrust of each setpoint that reached a craft, in their order."""

    def __init__(self, served_craft):
        self.thrusts = []
        self._command = served_craft.craft.command
        served_craft.craft.command = self._take

    def _take(self, roll_deg, pitch_deg, yaw_dps, thrust):
        self.thrusts.append(thrust)
        self._command(roll_deg, pitch_deg, yaw_dps, thrust)


def turns(one):
    return any(one.craft.state().motors)


@contextlib.contextmanager
def commanding(folder, craft):
    """A daemon that is connected to a craft."""
    with Daemon(folder, "--link", craft.uri, "--no-record") as daemon:
        daemon.status_when(lambda status: (status["command"] or {}).get("state") == "connected",
                           "the craft is connected")  # fmt: skip
        yield daemon
        assert daemon.stop() == 0


def fly(pilot, craft):
    """Until the rotors turn."""
    pilot.setpoint(0.0, 0.0, 0.0, 0)  # today's firmware takes thrust after none

    def steered():
        pilot.setpoint(0.0, 0.0, 0.0, THRUST)
        return turns(craft)

    until(steered, "the rotors turn", every_s=0.02)


@pytest.mark.parametrize("stamped", [True, False], ids=["says when", "does not say when"])
def test_what_a_client_said_before_it_died_turns_nothing_when_the_daemon_wakes(tmp_path, stamped):
    with served(**CRAFT) as craft, commanding(tmp_path, craft) as daemon:
        heard = Heard(craft)
        pilot = Pilot(daemon.socket, "doomed").__enter__()
        fly(pilot, craft)
        daemon.process.send_signal(signal.SIGSTOP)
        made = {"made_s": time.monotonic()} if stamped else {}
        angles = dict.fromkeys(("roll_deg", "pitch_deg", "yaw_dps"), 0.0)
        last = {"token": pilot.lease["token"], **angles, "thrust": THRUST, **made}
        head = {"Content-Type": "application/json"}
        pilot._connection.request("POST", "/command/setpoint", json.dumps(last), head)
        pilot.close()
        until(lambda: not turns(craft), "the firmware's own limit has stopped the motors")
        before = len(heard.thrusts)
        daemon.process.send_signal(signal.SIGCONT)
        until(
            lambda: any("motors stopped, " in e["text"] for e in daemon.ask("GET", "/events")),
            "the daemon has seen them stand",
        )
        assert not turns(craft)
        assert set(heard.thrusts[before:]) == {0}
        assert daemon.status()["command"]["client"] is None


def test_a_craft_that_is_chosen_while_another_is_stopped_gets_nothing_of_its_stop(tmp_path):
    ended = threading.Event()
    with (
        served(**CRAFT) as craft,
        served(**CRAFT) as other,
        commanding(tmp_path, craft) as daemon,
        ThreadPoolExecutor(1) as pool,
    ):
        of_other, stop_it = Heard(other), other.craft.emergency_stop
        other.craft.emergency_stop = lambda: (ended.set(), stop_it())
        with Pilot(daemon.socket, "a program") as pilot:
            fly(pilot, craft)
            command = craft.craft.command
            craft.craft.command = lambda *setpoint: None  # it obeys nothing but an emergency stop,
            craft.each_step = lambda: command(0.0, 0.0, 0.0, THRUST)  # and flies on
            stop = pool.submit(ask, daemon.socket, "POST", "/command/stop")
            until(
                lambda: any(event["kind"] == "stop" for event in daemon.ask("GET", "/events")),
                "the stop has begun",
            )
            with contextlib.suppress(GroundStationError):  # it may wait for too long
                ask(daemon.socket, "POST", "/command/connect", {"uri": other.uri})
                assert not turns(craft), "another craft is commanded, and nobody stops this one"
        assert stop.result()["motors"] == STOPPED
        assert not turns(craft)
        assert not ended.is_set(), "the other craft was stopped in its place"
        assert of_other.thrusts == []


class Flight:
    """What becomes of a craft in the air, in truth: how fast it was before it met the ground."""

    def __init__(self, served_craft):
        self.craft, self.down_m_s, self.aside_m_s = served_craft.craft, 0.0, 0.0
        self.highest_m = 0.0
        served_craft.each_step = self._look

    def _look(self):
        state = self.craft.state()
        self.highest_m = max(self.highest_m, state.position_m[2])
        if 0.02 < state.position_m[2] < 0.2:
            x_m_s, y_m_s, z_m_s = state.velocity_m_s
            self.down_m_s = max(self.down_m_s, -z_m_s)
            self.aside_m_s = max(self.aside_m_s, abs(x_m_s), abs(y_m_s))

    @property
    def height_m(self):
        return self.craft.state().position_m[2]

    def require_landed(self):
        until(lambda: not any(self.craft.state().motors), "the motors stand")
        assert self.height_m < 0.1
        assert self.down_m_s < 0.6
        assert self.aside_m_s < 0.3


def hover(pilot, flight, seconds=1.0):
    """Up, and level: it leans and keeps its speed, as a real one does."""
    for _ in range(10):
        pilot.setpoint(0.0, 0.0, 0.0, 0)
        time.sleep(0.02)
    begun_s = time.monotonic()
    while flight.height_m < 0.8 * HEIGHT_M or time.monotonic() < begun_s + 3.0:
        rise_m = min(HEIGHT_M, 0.3 * (time.monotonic() - begun_s))
        pilot.setpoint(0.0, 0.0, 0.0, height_m=rise_m, vx_m_s=0.0, vy_m_s=0.0)
        time.sleep(0.02)
    end_s = time.monotonic() + seconds
    answer = None
    while time.monotonic() < end_s:
        answer = pilot.setpoint(4.0, 0.0, 0.0, height_m=HEIGHT_M)
        time.sleep(0.02)
    flight.down_m_s = flight.aside_m_s = 0.0
    return answer


def test_a_light_craft_whose_firmware_s_least_thrust_carries_it_is_flown_and_landed(tmp_path):
    light = {"mass_change": {"percent": -8.0}}
    with (
        served(craft="brushless", flow_deck=True, effects=light) as craft,
        Daemon(tmp_path, "--link", craft.uri) as daemon,
    ):
        daemon.status_when(lambda status: status["command"]["state"] == "connected", "it")
        flight, least = Flight(craft), craft.craft.get_parameter("posCtlPid.thrustMin")
        ask(daemon.socket, "POST", "/command/arm", {"on": True})
        flown = groundstation(
            *("pid", "fly", "--thrust", f"height:{HEIGHT_M}", "--axis", "roll", "--repeat", "1"),
            *("--yes", "--json"),
            socket_path=daemon.socket,
            cwd=tmp_path,
        )
        assert flown.returncode == 0, flown.stderr
        assert json.loads(flown.stdout)["restored"] == ["posCtlPid.thrustMin"]
        flight.require_landed()
        assert flight.highest_m < 1.3 * HEIGHT_M
        assert craft.craft.get_parameter("posCtlPid.thrustMin") == least


def told(daemon, part):
    return any(part in event["text"] for event in daemon.ask("GET", "/events"))


@pytest.mark.parametrize("way", ["vanishes", "releases", "asks", "operator", "daemon ends"])
def test_a_craft_that_holds_its_height_is_landed_and_not_dropped(tmp_path, way):
    with served(**FLOW) as craft, commanding(tmp_path, craft) as daemon:
        flight = Flight(craft)
        pilot = Pilot(daemon.socket, "a program").__enter__()
        assert pilot.lease["holds_place"]
        assert pilot.lease["software"]
        assert pilot.lease["craft"]["vehicle"] == "crazyflie21"
        assert len(pilot.lease["craft"]["id"]) == 24
        answer = hover(pilot, flight)
        assert answer["place"]["z_m"] == pytest.approx(HEIGHT_M, abs=0.15)
        assert answer["place"]["age_s"] < 0.5
        if way == "releases":
            pilot.release()
        elif way == "asks":
            assert pilot.land() == LANDED
            pilot.keep()
        elif way == "operator":
            assert ask(daemon.socket, "POST", "/command/land")["motors"] == LANDED
            with pytest.raises(GroundStationError, match="the operator has landed the craft"):
                pilot.keep()
        elif way == "daemon ends":
            assert daemon.stop() == 0
        pilot.close()
        flight.require_landed()
        if way == "vanishes":
            until(lambda: told(daemon, "the craft has landed"), "it says so")


def test_a_killed_daemon_s_successor_writes_the_former_values_back(tmp_path):
    name = "pid_rate.roll_kp"
    with served(**CRAFT) as craft:
        before = craft.craft.get_parameter(name)
        state = {"environment": {"XDG_STATE_HOME": str(tmp_path / "state")}}
        with Daemon(tmp_path / "one", "--link", craft.uri, "--no-record", **state) as daemon:
            daemon.status_when(lambda status: status["command"]["state"] == "connected", "it")
            pilot = Pilot(daemon.socket, "learn").__enter__()
            pilot.write({name: 180.0})
            assert daemon.status()["command"]["unproven"] == {}, "it flies them"
            daemon.stop(signal.SIGKILL)
            pilot.close()
        assert craft.craft.get_parameter(name) == 180.0
        with Daemon(tmp_path / "two", "--link", craft.uri, "--no-record", **state) as daemon:
            until(lambda: craft.craft.get_parameter(name) == before, "it is as before")
            until(lambda: told(daemon, "the former values are back"), "it says so")
            assert ask(daemon.socket, "POST", "/command/restore")["values"] == {name: before}
            with Pilot(daemon.socket, "another") as pilot:
                assert pilot.parameters()[name] == before
            assert daemon.stop() == 0


@pytest.mark.parametrize("ending", [signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("stays", [True, False], ids=["new gains", "the former gains"])
def test_a_flight_whose_daemon_is_gone_before_the_craft_is_given_back_does_not_say_that_gains_stay(
    tmp_path, monkeypatch, ending, stays
):
    name = "pid_rate.roll_kp"
    ends = pytest.raises(GroundStationError, match="what was written to the craft does not stay")
    with served(**CRAFT) as craft, Daemon(tmp_path, "--link", craft.uri) as daemon:
        monkeypatch.setenv("GROUNDSTATION_SOCKET", str(daemon.socket))
        daemon.status_when(lambda status: status["command"]["state"] == "connected", "it")
        with ends if stays else contextlib.nullcontext(), commanded("pid fly") as pilot:
            before = craft.craft.get_parameter(name)
            flight = FlightOfPrograms(pilot)
            flight.change({name: 180.0}, stays=stays)
            flown = flight.fly(
                lambda signals: stopped_after(lambda: fly(pilot, craft) or "", pilot, signals),
                "pid fly begins",
            )
            assert flown.why == ""
            assert list(flown.restored) == ([] if stays else [name])
            assert craft.craft.get_parameter(name) == (180.0 if stays else before)
            daemon.stop(ending)


def test_a_program_begun_before_a_stop_does_not_command_again(tmp_path):
    with served(**CRAFT) as craft, commanding(tmp_path, craft) as daemon:
        stops = daemon.status()["command"]["stops"]
        with Pilot(daemon.socket, "learn", stops) as pilot:
            pilot.announce("takes off", 10.0)
            said = daemon.status()["command"]["announced"]
            assert said["text"] == "takes off"
            assert 0.0 < said["in_s"] <= 10.0
        ask(daemon.socket, "POST", "/command/stop")
        with (
            pytest.raises(GroundStationError, match="Motors were stopped since this program began"),
            Pilot(daemon.socket, "learn", stops),
        ):
            pass
        assert daemon.status()["command"]["stops"] == stops + 1


@pytest.mark.parametrize(
    ("profile", "is_refused"),
    [("crazyflie21plus", False), ("crazyflie21upgrade", False), ("brushless", True),
     ("crazyflie1", True)],
)  # fmt: skip
def test_a_profile_that_contradicts_the_craft_is_refused(tmp_path, profile, is_refused):
    with served(**CRAFT) as craft:
        more = ("--no-record", "--set", f"vehicle={profile}")
        with Daemon(tmp_path, "--link", craft.uri, *more) as daemon:
            daemon.status_when(lambda status: status["command"]["state"] == "connected", "it")
            refused = pytest.raises(GroundStationError, match="the craft says it is a crazyflie21")
            with refused if is_refused else contextlib.nullcontext():
                Pilot(daemon.socket, "a program").__enter__().close()
            assert daemon.stop() == 0
