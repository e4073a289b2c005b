"""What becomes of parameters that a client wrote and nobody settled: they are noted before they are
sent, and the former values are back as soon as the craft stands."""

import json
import os
import signal
from pathlib import Path

import pytest

from groundstation.cli import flying
from groundstation.cli.flying import write_parameters
from groundstation.errors import (
    BadInputError,
    GroundStationError,
    LinkError,
    NotAuthorisedError,
    TakenError,
)
from groundstation.service.client import Pilot
from groundstation.service.parameters import AGAIN_S, LOOKS_S, Changes
from support.worlds import GAINS, Tuning

ROLL, PITCH, YAW = GAINS


class Tuned(Tuning):
    def kill_daemon(self):
        """Nothing of it is done any more; the craft's own limits stop the motors."""
        self.end()
        self.world.pass_time(3.0)
        self.one.lose()

    def noted(self):
        return json.loads(self.path.read_text()) if self.path.exists() else {}


@pytest.fixture
def tuned(tmp_path):
    made = Tuned("crazyflie21", tmp_path / "state" / "changed.json")
    yield made
    made.close()


def unproven(tuned):
    return {name: (one.former, now) for name, (one, now) in
            tuned.commander.written.left(tuned.one).items()}  # fmt: skip


def test_a_change_is_on_disk_before_it_is_sent(tuned, monkeypatch):
    before, seen = tuned.gains(), []
    write = tuned.one._write_parameter

    async def looked_at(name, value):
        seen.append((name, tuned.noted()["udp://one:1"][name]))
        return await write(name, value)

    monkeypatch.setattr(tuned.one, "_write_parameter", looked_at)
    token = tuned.lease("learn")
    tuned.write(token, **{ROLL: 180.0, PITCH: 190.0})
    tuned.write(token, **{ROLL: 185.0})
    assert [name for name, _ in seen] == [ROLL, PITCH, ROLL]
    last = seen[-1][1]
    assert (last["former"], last["written"]) == (before[ROLL], [180.0, 185.0])
    assert last["client"] == "learn"


def test_a_client_that_releases_is_content_and_nothing_is_written_back(tuned):
    token = tuned.lease()
    tuned.write(token, **{ROLL: 180.0})
    assert tuned.noted()
    tuned.commander.release(token)
    assert tuned.noted() == {}
    tuned.wait(2.0)
    assert tuned.gains()[ROLL] == 180.0
    assert tuned.lease("another")


def test_a_client_that_releases_a_craft_out_of_reach_could_put_nothing_back(tuned):
    before = tuned.gains()
    token = tuned.lease("pid fly")
    tuned.write(token, **{ROLL: 180.0})
    tuned.one.lose()
    tuned.commander.release(token)
    assert tuned.noted()
    tuned.one.connect()
    tuned.wait(4.0)
    assert tuned.gains() == before


@pytest.mark.parametrize("end", ["it vanishes in flight", "it is silent on the ground", "a stop"])
def test_former_values_are_back_after_any_other_end_of_a_lease(tuned, end):
    before = tuned.gains()
    token = tuned.lease("learn")
    tuned.write(token, **{ROLL: 180.0, PITCH: 190.0})
    tuned.steer(token, 0.3, thrust=0)
    if end == "it vanishes in flight":
        tuned.steer(token, 0.5)
        tuned.wait(0.8)
    elif end == "a stop":
        tuned.stopped()
    else:
        tuned.wait(tuned.commander.limits.lease_s + 0.05)
    left = unproven(tuned)
    assert left[PITCH] == (before[PITCH], 190.0)
    assert left.get(ROLL, (before[ROLL], 180.0)) == (before[ROLL], 180.0)  # the first to be back
    with pytest.raises(TakenError, match=r"pid_rate\.pitch_kp|being stopped|being written"):
        tuned.lease("another")
    tuned.wait(4.0)
    assert tuned.gains() == before
    assert (unproven(tuned), tuned.noted()) == ({}, {})
    assert tuned.run(tuned.commander.restore()) == {ROLL: before[ROLL], PITCH: before[PITCH]}
    (said,) = [text for text in tuned.told if "the former values are back" in text]
    assert ROLL in said
    assert any("learn left pid_rate.roll_kp" in text for text in tuned.told)
    assert tuned.lease("another")


def test_nothing_is_written_to_a_craft_that_still_flies(tmp_path):
    tuned = Tuned("crazyflie21", tmp_path / "changed.json", "flow_deck")
    token = tuned.lease()
    tuned.write(token, **{ROLL: 240.0})
    tuned.steer(token, 0.3, thrust=0)
    tuned.steer(token, 3.0, thrust=0, height_m=0.5)
    while tuned.one.turns:
        tuned.wait(0.1)
        assert tuned.gains()[ROLL] == 240.0
        if tuned.commander.lands:
            with pytest.raises(TakenError, match="does not stand"):
                tuned.run(tuned.commander.restore())
    tuned.wait(4.0)
    assert tuned.gains()[ROLL] != 240.0
    tuned.close()


def test_a_daemon_that_was_killed_writes_back_as_soon_as_it_is_there_again(tuned):
    before = tuned.gains()
    token = tuned.lease("learn")
    tuned.write(token, **{ROLL: 180.0})
    tuned.steer(token, 0.3, thrust=0)
    tuned.steer(token, 0.5)
    tuned.kill_daemon()
    tuned.begin(tuned.path)
    assert unproven(tuned) == {ROLL: (before[ROLL], None)}, "known before the craft is there"
    tuned.one.connect()
    with pytest.raises(TakenError, match="interrupted"):
        tuned.lease("another")
    tuned.wait(4.0)
    assert tuned.gains() == before
    assert tuned.lease("another")


def test_a_craft_that_was_switched_off_and_on_has_forgotten_and_so_does_the_daemon(tuned):
    token = tuned.lease()
    tuned.write(token, **{ROLL: 180.0})
    tuned.one.switch_on()
    tuned.wait(tuned.commander.limits.lease_s + 0.5)
    tuned.wait(1.0)
    assert tuned.noted() == {}
    assert not any("former values" in text for text in tuned.told)
    assert tuned.lease("another")


def test_a_client_that_writes_before_the_daemon_has_forgotten_gets_back_what_the_craft_has(tuned):
    """A former value of before the craft was switched off was written to it in the next flight."""
    tuned.one.craft.set_parameter(ROLL, 115.0)
    tuned.wait(1.0)
    tuned.write(tuned.lease(), **{ROLL: 130.0})
    tuned.kill_daemon()
    tuned.one.craft.set_parameter(ROLL, 120.0)  # it has been switched off
    tuned.begin(tuned.path)
    tuned.one.connect()
    token = tuned.lease("the next")
    assert tuned.noted() != {}, "the daemon has not looked yet"
    tuned.write(token, **{ROLL: 110.0})
    tuned.kill_daemon()
    tuned.begin(tuned.path)
    tuned.one.connect()
    tuned.wait(4.0)
    assert tuned.gains()[ROLL] == 120.0
    assert tuned.noted() == {}


def test_what_somebody_set_anew_since_is_left_alone(tuned):
    token = tuned.lease()
    tuned.write(token, **{ROLL: 180.0, PITCH: 190.0})
    tuned.kill_daemon()
    tuned.one.craft.set_parameter(ROLL, 201.0)
    tuned.begin(tuned.path)
    tuned.one.connect()
    tuned.wait(4.0)
    assert tuned.gains()[ROLL] == 201.0
    assert tuned.gains()[PITCH] != 190.0
    assert tuned.noted() == {}


def test_the_craft_s_own_number_says_whose_values_they_are(tuned):
    tuned.one.number, tuned.other.number = "aa", "bb"
    token = tuned.lease()
    tuned.write(token, **{ROLL: 180.0})
    tuned.kill_daemon()
    assert list(tuned.noted()) == ["aa"]
    tuned.one.number = "bb"  # another craft answers at this address now
    tuned.begin(tuned.path)
    tuned.one.connect()
    tuned.wait(2.0)
    assert tuned.gains()[ROLL] == 180.0
    assert tuned.lease("another")
    assert list(tuned.noted()) == ["aa"]


def test_a_craft_that_was_exchanged_is_neither_flown_nor_written_to(tuned):
    tuned.one.number = "aa"
    token = tuned.lease()
    tuned.one.number = "bb"
    with pytest.raises(NotAuthorisedError, match="another craft answers"):
        tuned.commander.setpoint(token, 0, 0, 0, 40000)
    with pytest.raises(NotAuthorisedError, match="another craft answers"):
        tuned.write(token, **{ROLL: 180.0})
    tuned.wait(0.2)
    assert not any(one.flies for one in tuned.one.delivered)
    assert tuned.gains()[ROLL] != 180.0


def test_where_writing_back_fails_it_is_tried_again_and_said_once(tuned):
    token = tuned.lease()
    tuned.write(token, **{ROLL: 180.0})
    tuned.one.refuses = True
    tuned.stopped()
    with pytest.raises(LinkError, match="not confirmed"):
        tuned.run(tuned.commander.restore())
    tuned.wait(5 * AGAIN_S)
    tries = [text for text in tuned.told if "could not be written back" in text]
    assert len(tries) == 1
    with pytest.raises(TakenError, match="interrupted"):
        tuned.lease("another")
    tuned.one.refuses = False
    tuned.wait(10 * AGAIN_S)
    assert tuned.gains()[ROLL] != 180.0
    assert tuned.lease("another")


def test_a_value_that_the_craft_did_not_confirm_is_written_back_too(tuned):
    """It may have it all the same: nobody has heard what it has."""
    before = tuned.gains()[ROLL]
    token = tuned.lease()
    tuned.one.refuses = True
    with pytest.raises(LinkError, match="not confirmed"):
        tuned.write(token, **{ROLL: 180.0})
    tuned.one.refuses = False
    sent = []
    write = tuned.one._write_parameter

    async def writing(name, value):
        sent.append((name, value))
        return await write(name, value)

    tuned.one._write_parameter = writing
    tuned.stopped()
    tuned.wait(4.0)
    assert sent == [(ROLL, before)]
    assert tuned.noted() == {}


def test_nothing_is_sent_that_the_disk_does_not_keep(tuned, tmp_path):
    (tmp_path / "state").write_text("a file where the folder would be")
    token = tuned.lease()
    with pytest.raises(BadInputError, match="cannot be written"):
        tuned.write(token, **{ROLL: 180.0})
    assert tuned.gains()[ROLL] != 180.0


@pytest.mark.parametrize("content", ["{", '{"udp://one:1": {"pid_rate.roll_kp": 3}}', "[]"])
def test_a_damaged_note_is_refused_in_words_and_nothing_is_flown(tuned, content):
    tuned.restoring.cancel()
    tuned.path.parent.mkdir()
    tuned.path.write_text(content)
    tuned.begin(tuned.path)
    with pytest.raises(BadInputError, match="cannot be read"):
        tuned.lease()
    tuned.wait(2 * LOOKS_S)
    assert tuned.path.read_text() == content


def test_values_that_are_written_back_by_the_client_itself_are_no_news(tuned):
    before = tuned.gains()[ROLL]
    token = tuned.lease()
    tuned.write(token, **{ROLL: 180.0})
    tuned.write(token, **{ROLL: before})
    tuned.kill_daemon()
    tuned.begin(tuned.path)
    tuned.one.connect()
    assert tuned.lease("another")
    tuned.wait(1.0)
    assert not any("former" in text for text in tuned.told)


def test_two_daemons_of_one_user_keep_each_other_s_notes(tmp_path):
    path = tmp_path / "changed.json"
    one, other = Changes(path), Changes(path)
    who = {"client": "learn", "uri": "udp://one:1"}
    one.note("aa", {ROLL: 180.0}, {ROLL: 250.0}, **who)
    other.note("bb", {PITCH: 190.0}, {PITCH: 250.0}, **who)
    one.note("aa", {YAW: 100.0}, {YAW: 120.0}, **who)
    assert set(json.loads(path.read_text())) == {"aa", "bb"}
    assert set(other.of("aa")) == {ROLL, YAW}
    other.settle("bb")
    one.settle("aa", [ROLL])
    assert {name: list(found) for name, found in json.loads(path.read_text()).items()} == {
        "aa": [YAW]
    }
    one.settle("aa")
    assert not path.exists()
    assert other.of("aa") == {}


def test_a_damaged_note_that_was_removed_is_forgotten(tmp_path):
    path = tmp_path / "changed.json"
    path.write_text("{")
    changes = Changes(path)
    assert "cannot be read" in changes.trouble
    with pytest.raises(BadInputError, match="cannot be read"):
        changes.note("aa", {ROLL: 1.0}, {ROLL: 2.0}, client="", uri="")
    path.unlink()
    assert changes.trouble == ""


def test_the_former_value_itself_needs_no_note(tmp_path):
    path = tmp_path / "changed.json"
    changes = Changes(path)
    changes.note("aa", {ROLL: 250.0}, {ROLL: 250.0}, client="", uri="")
    assert not path.exists()
    changes.note("aa", {ROLL: 180.0}, {ROLL: 250.0}, client="", uri="")
    changes.note("aa", {ROLL: 250.0}, {ROLL: 180.0}, client="", uri="")
    assert changes.of("aa")[ROLL].written == (180.0,)


class Local(Pilot):
    """The client; its requests go to the commander in this process."""

    def __init__(self, tuned):
        super().__init__(Path("/nowhere"), "pid fly")
        self._tuned = tuned

    def ask(self, method, route, body=None):
        tuned, commander = self._tuned, self._tuned.commander
        match method, route:
            case _, "/command/acquire":
                return {"token": commander.acquire(body["client"]).token, "holds_place": False}
            case _, "/command/release":
                return commander.release(**body)
            case "GET", "/command/parameters":
                return {"values": commander.parameters()}
            case "POST", "/command/parameters":
                written = commander.write_parameters(body["token"], body["values"])
                return {"values": tuned.looked(written)}
            case _:
                return {}


def refusing(tuned, monkeypatch, name, values):
    """Have the craft not confirm these values of a parameter."""
    write = tuned.one._write_parameter

    async def some(written, value):
        if (written, value) in {(name, one) for one in values}:
            raise LinkError(f"parameter {name} was not confirmed")
        return await write(written, value)

    monkeypatch.setattr(tuned.one, "_write_parameter", some)


def test_what_was_written_half_way_is_written_back(tuned, monkeypatch):
    before = tuned.gains()
    refusing(tuned, monkeypatch, PITCH, [190.0])
    with pytest.raises(LinkError, match="was not confirmed"), Local(tuned) as pilot:
        write_parameters(pilot, {ROLL: 180.0, PITCH: 190.0, YAW: 60.0})
    tuned.wait(4.0)
    assert tuned.gains() == before
    assert tuned.noted() == {}


def test_gains_do_not_stay_without_a_word_where_another_parameter_is_not_put_back(
    tuned, monkeypatch
):
    before = tuned.gains()
    monkeypatch.setattr(flying, "begin_recording", dict)
    monkeypatch.setattr(flying, "end_recording", lambda recording, why: "flight.mcap")
    refusing(tuned, monkeypatch, PITCH, [before[PITCH]])
    with Local(tuned) as pilot:
        flight = flying.Flight(pilot)
        flight.change({ROLL: 180.0}, stays=True)
        flight.change({PITCH: 100.0})
        ended = flight.fly(lambda signals: flying.Ended("", flying.MOTORS_OFF), "begins")
    with pytest.raises(GroundStationError, match="what was written does not stay"):
        ended.require("flight")
    monkeypatch.undo()
    tuned.wait(4.0)
    assert tuned.gains() == before


@pytest.mark.parametrize("when", ["put back", "recorded"])
def test_an_interrupt_behind_a_flight_is_told(tuned, monkeypatch, when):
    def interrupt(*given):
        os.kill(os.getpid(), signal.SIGINT)
        return "flight.mcap"

    monkeypatch.setattr(flying, "begin_recording", dict)
    monkeypatch.setattr(flying, "end_recording", lambda recording, why: "flight.mcap")
    if when == "recorded":
        monkeypatch.setattr(flying, "end_recording", interrupt)
    with Local(tuned) as pilot:
        flight = flying.Flight(pilot)
        flight.change({ROLL: 180.0})
        write = pilot.write

        def interrupted(values):
            if when == "put back" and values == flight.former:
                interrupt()
            return write(values)

        monkeypatch.setattr(pilot, "write", interrupted)
        ended = flight.fly(lambda signals: flying.Ended("", flying.MOTORS_OFF), "begins")
    assert str(ended.interrupted) == "Ctrl-C"
    with pytest.raises((KeyboardInterrupt, GroundStationError), match="Ctrl-C"):
        ended.require("flight")


def test_what_was_written_back_is_not_told_of_a_craft_that_was_changed_since(tuned):
    before = tuned.gains()
    tuned.write(tuned.lease("learn"), **{ROLL: 180.0})
    tuned.wait(9.0)
    assert tuned.run(tuned.commander.restore()) == {ROLL: before[ROLL]}
    token = tuned.lease("pid fly")
    tuned.write(token, **{ROLL: 120.0})
    with pytest.raises(TakenError, match="pid fly commands"):
        tuned.run(tuned.commander.restore())
    tuned.commander.release(token)
    assert tuned.run(tuned.commander.restore()) == {}
    assert tuned.gains()[ROLL] == 120.0


@pytest.mark.parametrize("flies", [False, True], ids=["stands", "flies"])
def test_a_stop_ends_the_lease_of_a_craft_that_is_out_of_reach(tuned, flies):
    token = tuned.lease("a program")
    tuned.steer(token, 0.3, thrust=0)
    if flies:
        tuned.steer(token, 0.5)
        assert tuned.one.turns
    tuned.one.lose()
    with pytest.raises(LinkError, match="the stop was not sent"):
        tuned.run(tuned.commander.operator.stop())
    tuned.one.connect()
    tuned.wait(0.2)
    with pytest.raises(NotAuthorisedError, match="the operator has stopped the motors"):
        tuned.commander.keep(token)
    tuned.wait(0.8)  # sooner than the firmware's own limit
    assert not tuned.one.turns
