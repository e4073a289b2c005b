"""``pid fly`` and ``motors`` on today's craft over a radio that stalls, and on craft that refuse.

As a user does it: the software craft is a program of its own, heard and commanded over UDP.
"""

import contextlib
import json
import signal
import time

import pytest

from groundstation.dynamics.model import save_model, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.service.client import Pilot, ask, live
from support.commands import Beside, software_craft
from support.crafts import narrow
from support.daemons import Daemon, require_failure
from support.programs import free_port
from support.waiting import until

ONCE = ("--axis", "roll", "--repeat", "1", "--hold", "0.5", "--rest", "0.2")
LONG = ("--axis", "roll", "--repeat", "8", "--hold", "1.0", "--rest", "0.5")
LOCKED = "the craft has locked itself"
LANDED = "landed, motors are off"


class Field(Beside):
    """A craft, the radio between, and a daemon; commands beside it."""

    def __init__(self, craft, radio, daemon):
        super().__init__(daemon)
        self.craft, self.radio = craft, radio

    def connected_again(self):
        def streams(status):
            up = status["command"]["state"] == "connected"
            return up and status["link"]["state"] == "streaming"

        return self.daemon.status_when(streams, "the craft is connected again")

    def duty(self):
        """The largest of the motors, as the craft last said."""
        with contextlib.closing(live(self.daemon.socket)) as told:
            samples = next(content for kind, content in told if kind == "samples")
        return max(samples["duty"][-1])

    def says(self, text):
        """The craft itself says so of its state, which takes it a moment."""
        until(
            lambda: text in ask(self.daemon.socket, "GET", "/status")["command"]["hindrance"],
            f"the craft says: {text}",
        )


@pytest.fixture
def field(tmp_path, request):
    port = free_port()
    given = {"craft": '"crazyflie21"', "protocol": "9", **getattr(request, "param", {})}
    always = 'program = "wait"\nresume_s = 1e6\nflow_deck = true\n'
    settings = always + "".join(f"{key} = {value}\n" for key, value in given.items())
    with (
        software_craft(tmp_path, settings, "--crtp", f"127.0.0.1:{port}") as craft,
        narrow(port) as radio,
        Daemon(tmp_path, "--link", radio.uri, "--recordings", "sessions") as daemon,
    ):
        found = Field(craft, radio, daemon)
        found.connected_again()
        yield found


def last_line(flight):
    """What an aborted flight says in the end, which is all it may say but for the help, for what it
    does and for what becomes of the parameters that it wrote."""
    _, stderr = flight.communicate(timeout=120)
    assert flight.returncode == 1, stderr
    *before, last = stderr.strip().splitlines()
    assert len([line for line in before if "parameters" not in line]) <= 2, stderr
    assert last.startswith("groundstation: flight aborted: ")
    return last


def test_a_craft_flies_twice_and_is_not_locked_by_the_silence_after_a_flight(field):
    """Today's firmware locks a craft whose setpoints cease within 2 s after its motors turned."""
    for _ in range(2):
        flight = field.flown(*ONCE, "--json")
        assert json.loads(flight.stdout)["motors"] == LANDED
        time.sleep(3.0)
        assert field.events("fault") == []
        assert not any("Locked" in line for line in field.events("console"))


@pytest.mark.parametrize("field", [{"craft": '"brushless"', "protocol": "12"}], indirect=True)
def test_the_idling_motors_of_a_brushless_are_off_when_a_flight_is_over(field):
    field.says("the craft is not armed")
    assert "the craft is not armed" in require_failure(field.fly(*ONCE))
    assert field.run("motors", "arm").stdout == "armed\n"
    until(lambda: field.duty() > 0.1, "the motors idle")
    flight = field.flown(*ONCE, "--json")
    assert json.loads(flight.stdout)["motors"] == LANDED
    assert field.duty() == 0.0
    field.daemon.status_when(lambda s: s["command"]["armed"] is False, "the craft is disarmed")
    assert field.events("fault") == []
    assert field.run("motors", "arm").stdout == "armed\n", "it was not locked"
    assert field.run("motors", "stop").stdout.startswith("stopped")
    assert field.duty() == 0.0


@pytest.mark.parametrize("field", [{"software_build": "true", "protocol": "7"}], indirect=True)
def test_a_software_build_that_tells_no_battery_is_flown_and_that_is_said(field, tmp_path):
    model = tmp_path / "model.json"
    save_model(vehicle_model(BUILT_IN["crazyflie21"]), model)
    flight = field.flown(*ONCE, "--model", model, "--json")
    assert "the craft does not tell its battery's voltage" in flight.stderr
    assert "no battery was told: the prediction is for 3.7 V" in flight.stderr
    told = json.loads(flight.stdout)
    assert told["motors"] == LANDED
    assert "NaN" not in flight.stdout


@pytest.mark.parametrize("field", [{"protocol": "7"}, {"protocol": "12"}], indirect=True)
def test_a_client_that_leaves_a_craft_in_altitude_hold_leaves_no_motor_turning(field):
    """With ``flightmode.althold`` zero thrust asks for a rate of descent."""
    with Pilot(field.daemon.socket, "a program") as pilot:
        pilot.write({"flightmode.althold": 1.0})
        for thrust in (0, *[34000] * 50, *[0] * 50):
            pilot.setpoint(0.0, 0.0, 0.0, thrust)
            time.sleep(0.02)
        assert field.duty() > 0.1, "zero thrust does not stop them"
    until(lambda: field.duty() == 0.0, "the motors stand")
    until(lambda: any("motors stopped" in one for one in field.events("command")), "it is said")
    assert LOCKED not in field.events("fault")


@pytest.mark.parametrize("field", [{"craft": '"brushless"', "protocol": "12"}], indirect=True)
def test_a_second_without_radio_ends_a_flight_and_the_next_one_flies(field):
    assert field.run("motors", "arm").stdout == "armed\n"
    with field.flying(*LONG) as flight:
        field.radio.stalled = True
        time.sleep(1.4)
        field.radio.stalled = False
        last = last_line(flight)
    # both end after 1 s, and whichever log group came last is told
    assert "no telemetry for 1." in last or "no position from the craft for 1 s" in last
    assert "motors are off" in last
    field.daemon.status_when(lambda s: s["command"]["armed"] is False, "the craft is disarmed")
    time.sleep(2.5)  # armed before that it would call itself landed, and be disarmed 3 s later
    assert field.run("motors", "arm").stdout == "armed\n"
    field.flown(*ONCE)


@pytest.mark.parametrize("field", [{"craft": '"crazyflie21plus"', "protocol": "7"}], indirect=True)
def test_five_seconds_without_radio_end_it_and_nobody_says_that_the_motors_stopped(field):
    with field.flying(*LONG) as flight:
        field.radio.stalled = True
        last = last_line(flight)
        assert "nothing says that the motors stopped" in last
        assert "motors are off" not in last
        told = require_failure(field.run("motors", "stop"))
        assert "not connected" in told
        time.sleep(2.0)
        field.radio.stalled = False
    field.connected_again()
    field.says(LOCKED)
    assert LOCKED in require_failure(field.run("motors", "arm"))
    refused = require_failure(field.fly(*ONCE))
    assert LOCKED in refused
    assert refused.endswith("switch it off and on; nothing was flown")
    assert field.run("motors", "stop").stdout.startswith("stopped")


@pytest.mark.parametrize("field", [{"craft": '"brushless"'}], indirect=True)
def test_a_craft_whose_program_stands_still_for_five_seconds_ends_the_flight(field):
    """Its time stands still too, unlike a radio's; what was sent meanwhile comes late."""
    assert field.run("motors", "arm").stdout == "armed\n"
    with field.flying(*LONG) as flight:
        field.craft.send_signal(signal.SIGSTOP)
        try:
            last = last_line(flight)
        finally:
            time.sleep(2.0)
            field.craft.send_signal(signal.SIGCONT)
    assert "nothing says that the motors stopped" in last
    field.connected_again()
    assert field.run("motors", "stop").stdout.startswith("stopped")


@pytest.mark.parametrize("field", [{"craft": '"brushless"', "upside_down": "true"}], indirect=True)
def test_a_craft_on_its_back_is_neither_armed_nor_flown(field):
    field.says("lies on its side or its back: set it upright")
    told = require_failure(field.run("motors", "arm"))
    assert "the craft refuses to arm its motors: the craft lies on its side" in told
    refused = require_failure(field.fly(*ONCE))
    assert refused.endswith("set it upright; nothing was flown")
    told = require_failure(field.run("motors", "recover"))
    assert "the craft does not say that it has crashed" in told
    assert "pid fly begins" not in field.events("mark")
    assert field.events("fault") == ["the craft lies on its side or its back: set it upright"]
