"""The installed daemon, the official library and stand-ins, in the orders that once turned a
motor; the others are in ``test_any_order.py``, on a clock that the test turns."""

import contextlib
import json
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from groundstation.errors import GroundStationError
from groundstation.service.client import Pilot, ask
from groundstation.service.motor_stop import STOPPED
from support.crafts import served
from support.daemons import Daemon
from support.waiting import until

CRAFT = {"craft": "crazyflie21", "plant": "reduced"}
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
