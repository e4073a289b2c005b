"""What the story does without: cflib, a machine that keeps up with real time."""

import importlib.util

import pytest

from firmware_sim.programme import load_programme
from firmware_sim.settings import load_settings
from groundstation.demo import story
from groundstation.demo.outcome import IN_THE_AIR_S
from groundstation.demo.shell import Shell
from groundstation.demo.story import (
    CRAFT_FILE,
    FLIGHT,
    FLIGHT_S,
    PID_FLIGHTS,
    STAGES,
    WAITING,
    Stage,
    inputs,
    tell,
)
from groundstation.errors import GroundStationError


@pytest.fixture
def shell(tmp_path):
    with Shell(tmp_path / "story", inputs(1), lambda line: None) as opened:
        yield opened


def only(monkeypatch, name):
    monkeypatch.setattr(story, "STAGES", tuple(one for one in STAGES if one.name == name))


def aborting(monkeypatch, times, why="flight aborted: no telemetry for 1.0 s"):
    """``pid fly`` ends early so many times; the names of the attempts."""
    attempts = []

    def fly(shell, name):
        attempts.append(name)
        if len(attempts) <= times:
            raise GroundStationError(why)

    monkeypatch.setattr(story, "_fly_gains", fly)
    monkeypatch.setattr(Shell, "run", lambda *words, **more: None)
    only(monkeypatch, "controller_flies")
    return attempts


def test_without_cflib_only_the_controller_s_flight_is_left_out_and_why_is_said(shell, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "cflib" else find(name)
    )
    only(monkeypatch, "controller_flies")
    told = tell(shell, 1, lambda number, stage: None)
    assert "pip install" in told.skipped["controller_flies"]


def test_a_flight_that_a_busy_machine_aborted_is_tried_once_more(shell, monkeypatch):
    attempts = aborting(monkeypatch, 1)
    told = tell(shell, 1, lambda number, stage: None)
    assert attempts == list(PID_FLIGHTS)
    assert not told.skipped


def test_aborted_twice_the_story_goes_on_without_it(shell, monkeypatch):
    aborting(monkeypatch, 2)
    told = tell(shell, 1, lambda number, stage: None)
    assert "no telemetry" in told.skipped["controller_flies"]


def test_another_failure_ends_the_story_and_names_the_stage(shell, monkeypatch):
    attempts = aborting(monkeypatch, 2, "the daemon has ended (1)")
    with pytest.raises(GroundStationError, match="stage 'The controller flies': the daemon has"):
        tell(shell, 1, lambda number, stage: None)
    assert len(attempts) == 1


def test_stages_are_announced_in_order_and_their_cost_is_told(shell, monkeypatch):
    stages = [Stage(name, name.title(), lambda shell, seed: None) for name in ("one", "two")]
    monkeypatch.setattr(story, "STAGES", tuple(stages))
    begun = []
    told = tell(shell, 1, lambda number, stage: begun.append((number, stage.name)))
    assert begun == [(0, "one"), (1, "two")]
    assert list(told.cost) == ["one", "two"]


def test_the_flight_is_in_the_air_where_the_models_are_compared(shell, monkeypatch):
    monkeypatch.chdir(shell.folder)
    programme = load_programme(FLIGHT)
    assert sum(segment.seconds for segment in programme.segment) == FLIGHT_S
    begin = 0.0
    for segment in programme.segment:
        end = begin + segment.seconds
        if end > IN_THE_AIR_S[0] and begin < IN_THE_AIR_S[1]:
            assert segment.kind == "fly"
            assert segment.height_m > 0.5
        begin = end


def test_the_story_s_crafts_are_ones_the_stand_in_takes(shell, monkeypatch):
    monkeypatch.chdir(shell.folder)
    craft, waiting = (load_settings(shell.folder / name) for name in (CRAFT_FILE, WAITING))
    assert craft.program == FLIGHT
    assert waiting.program == "wait"
    assert craft.gains == waiting.gains
    assert craft.effects == {}
    assert set(waiting.effects) == {"attitude_filter_lean"}
