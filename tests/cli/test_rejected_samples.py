"""What inspect does not believe is missing to every command, and said once; the rest is used."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.dynamics.meanings import Use, suitability
from groundstation.dynamics.model import load_model
from groundstation.errors import BadInputError
from groundstation.recording.csv_file import write_table_csv
from groundstation.recording.session import Recording
from support.commands import run
from support.flights import recorded, truth_of

C0 = 0.00425
SECOND = 500


@pytest.fixture(scope="module")
def flight():
    """40 s of a craft whose rotor speeds are measured."""
    samples, truth = recorded(40.0, plant="faithful", seed=31)
    speeds = truth_of(samples, truth)["rotor_rev_s"].astype(np.float32)
    return replace(samples, rotor_rev_s=speeds)


def written(path, samples, **changes):
    """The file of samples, some fields changed in place."""
    for name, change in changes.items():
        values = getattr(samples, name).copy()
        change(values)
        samples = replace(samples, **{name: values})
    write_table_csv(Recording(Path(path), "csv", samples), path)
    return path


def fitted(file, *more):
    """What a fit says and the model that it writes."""
    model = file.with_suffix(".json")
    vehicle = () if "--vehicle" in more else ("--vehicle", "crazyflie1")
    return run("fit", "body", file, "-o", model, *vehicle, *more), model


def line(values):
    """As what joined sources of a flight extrapolates the one that ended."""
    rows = 25 * SECOND
    values[rows:] = values[rows] - 3e-4 * np.arange(len(values) - rows)[:, None]


def freeze(values):
    values[20 * SECOND : 24 * SECOND] = values[20 * SECOND]


WRONG = {"duty": (line, "duty_1"), "gyro": (freeze, "the gyro is frozen"),
         "accelerometer": (freeze, "the accelerometer is frozen")}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_fit_uses_what_is_sound_of_a_file_and_says_once_what_is_not(flight, name, tmp_path):
    change, words = WRONG[name]
    file = written(tmp_path / "flight.csv", flight, **{name: change})
    assert words in run("inspect", file)
    said, model = fitted(file, "--with", "dead_time")
    assert said.count("taken as missing") == 1
    assert words in said
    assert load_model(model).body.c0 == pytest.approx(C0, rel=0.05)


def test_every_command_says_what_it_does_not_use(flight, tmp_path):
    file = written(tmp_path / "flight.csv", flight, gyro=freeze)
    _, model = fitted(file)
    commands = [
        ("compare", file, "--model", model),
        ("attitude", file),
        ("simulate", "--recording", file, "--model", model, "-o", tmp_path / "out.csv"),
    ]
    for command in commands:
        assert run(*command).count("taken as missing: the gyro is frozen") == 1, command[0]


def test_measured_rotors_are_advised_where_their_sensors_are_sound_only(flight, tmp_path):
    def stick(speeds):
        speeds[12 * SECOND :, 2] = speeds[12 * SECOND, 2]

    advice = "with --measured-rotors"
    assert advice in fitted(written(tmp_path / "sound.csv", flight))[0]
    stuck = written(tmp_path / "stuck.csv", flight, rotor_rev_s=stick)
    said, _ = fitted(stuck)
    assert advice not in said
    assert "rotor_3 is stuck" in said
    other = written(tmp_path / "again.csv", flight, rotor_rev_s=stick)
    said, model = fitted(other, "--measured-rotors")
    assert load_model(model).body.c0 == pytest.approx(C0, rel=0.05)  # by the 12 s before


def test_a_refusal_says_what_was_taken_as_missing(flight, tmp_path):
    def millivolts(volts):
        volts *= 1000.0

    file = written(tmp_path / "flight.csv", flight, battery_v=millivolts)
    with pytest.raises(BadInputError, match=r"nowhere in it.*battery up to .* V, which cannot be"):
        fitted(file)


ROWS = [(1, ()), (2, ()), (3, ()), (10, ()), (1, ("--segment", "5:12"))]


class DesignBegunError(Exception):
    """A design was begun: whether any gains keep its limits takes a minute to search."""


def begun(*_arguments, **_more):
    raise DesignBegunError


@pytest.mark.parametrize(("every", "more"), ROWS)
def test_a_fit_states_a_verdict_that_a_design_keeps_to(every, more, tmp_path, monkeypatch):
    """Each axis that is good for a design is designed, each other is refused with its reason."""
    monkeypatch.setattr("groundstation.control.design.optimise", begun)
    samples, _ = recorded(32.0, craft="crazyflie21", plant="faithful", seed=11)
    file = written(tmp_path / "flight.csv", samples[::every])
    said, model = fitted(file, "--vehicle", "crazyflie21", *more)
    found = suitability(load_model(model))
    first = said.splitlines()[1].lower()
    assert ("good enough" in first) == any(one.use == Use.DESIGN for one in found.values())
    for axis, one in found.items():
        arguments = ("pid", "design", "--model", model, "--axis", axis, "--draws", 0)
        with pytest.raises(DesignBegunError if one.designs else BadInputError) as ended:
            run(*arguments)
        if not one.designs:
            assert str(ended.value).startswith(f"{axis}: the model is ")
