"""A flight is begun by a craft that stands, told as it ended, and no interrupt is lost in it."""

import os
import signal

import pytest

from groundstation.cli.flying import NOT_LANDED, Interrupts, Room, fly_by_height
from groundstation.cli.learn import CLIENT, FastPlace
from groundstation.control.programme import LANDS
from groundstation.learn.planning import FlightPlan, Limits, library
from groundstation.links.command import RESETS_ESTIMATOR
from groundstation.links.software_craft import SoftwareCraft

WELL = '[stand_in]\nplant = "reduced"\ncraft = "crazyflie21"\n'
CARRIED_OFF = WELL + "[stand_in.effects.rotor_mismatch]\nrotor = 1.0\nexcess = -0.4\n"


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)


def plan():
    return FlightPlan((library(Limits())["roll doublets"],), "")


def flown(tmp_path, craft=SoftwareCraft, settings=WELL):
    (tmp_path / "craft.toml").write_text(settings)
    flying = craft(str(tmp_path / "craft.toml"), CLIENT, seed=1)
    flying.arm()
    with Interrupts() as signals:
        ended = fly_by_height(
            flying, plan(), Room(0.5, 0.0, 1.0), signals, tells_battery=True, clock=flying
        )
    return flying, ended


class TakenUp(SoftwareCraft):
    """Somebody takes it up while its estimator begins anew: behind the countdown, before the first
    thrust."""

    asked_m = None
    is_taken = False

    def write(self, values):
        self.is_taken |= RESETS_ESTIMATOR in values
        return super().write(values)

    def setpoint(self, *angles, height_m=None, **more):
        answer = super().setpoint(*angles, height_m=height_m, **more)
        self.asked_m = height_m
        if self.is_taken:
            answer["telemetry"]["roll_deg"] = 35.0
        return answer


def test_a_craft_that_is_taken_up_behind_the_countdown_does_not_take_off(tmp_path):
    flying, ended = flown(tmp_path, TakenUp)
    assert ended.why.startswith("it is tilted by 35 deg")
    assert flying.asked_m is None
    assert flying.position_m[2] < 0.01


class Dropped(SoftwareCraft):
    def land(self):
        super().land()
        return "stopped"


def test_a_flight_whose_landing_failed_is_no_good_one(tmp_path):
    _, ended = flown(tmp_path, Dropped)
    assert (ended.why, ended.motors) == (NOT_LANDED, "motors are off")


class Landing(SoftwareCraft):
    def mark(self, text, **details):
        super().mark(text, **details)
        if text == LANDS:
            interrupt()


def test_the_first_ctrl_c_lands_a_craft_that_was_about_to_land(tmp_path, capsys):
    _, ended = flown(tmp_path, Landing, CARRIED_OFF)
    assert ended.why.startswith("position: ")
    assert ended.motors == "landed, motors are off"
    assert "Ctrl-C again stops the motors" in capsys.readouterr().err


def test_a_ctrl_c_in_the_landing_ends_what_would_fly_again(tmp_path, monkeypatch):
    (tmp_path / "craft.toml").write_text(WELL)
    land = SoftwareCraft.land
    monkeypatch.setattr(SoftwareCraft, "land", lambda self: (interrupt(), land(self))[1])
    place = FastPlace(str(tmp_path / "craft.toml"), 0.5, 1.0)
    with pytest.raises(KeyboardInterrupt, match="Ctrl-C"):
        place.fly(plan(), tmp_path / "flight.mcap", seed=1)
    assert (tmp_path / "flight.mcap").exists()
