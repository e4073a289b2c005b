"""The installed ``compare`` and ``discrepancy``: what they write, and what they refuse."""

import json
import os
import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from groundstation.cli.app import app
from groundstation.comparison.gap import CHANNELS
from groundstation.discrepancy.report_json import CompareReport, DiscrepancyReport
from groundstation.dynamics.model import load_model, save_model
from groundstation.errors import BadInputError
from groundstation.recording.mcap_file import RecordingFile, session_metadata
from support.daemons import COMMAND, in_process, require_failure
from support.flights import BASE, CARRYING_GAINS, recorded
from support.programs import run_program

HIDDEN = {"velocity_moment": {"moment": 12.0}}


def write(path, samples, **metadata):
    out = RecordingFile(path, {"session": session_metadata("stand-in"), **metadata})
    out.samples(samples)
    out.finish()
    return path


def flight(seconds=40.0, **settings):
    samples, _ = recorded(
        seconds,
        **{"seed": 3, "plant": "reduced", "gains": CARRYING_GAINS, "copies": 1, **settings},
    )
    return samples


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A flight with a hidden effect, one without, and the base model."""
    folder = tmp_path_factory.mktemp("flights")
    write(folder / "hidden.mcap", flight(effects=HIDDEN))
    write(folder / "clean.mcap", flight())
    save_model(BASE, folder / "base.json")
    lighter = msgspec.structs.replace(BASE.body, thrust_per_mass=1.2 * BASE.body.thrust_per_mass)
    save_model(msgspec.structs.replace(BASE, body=lighter), folder / "lighter.json")
    return folder


@pytest.fixture(scope="module")
def searched(folder):
    """The folder after a search on the flight with the hidden effect, by a craft that is heavier
    than its model, and what was printed."""
    done = run_program(
        [
            *(COMMAND, "discrepancy", "hidden.mcap", "--model", "lighter.json"),
            *("-o", "improved.json", "--json", "report.json"),
            *("--html", "report.html", "--rerun", "shown.rrd"),
        ],
        cwd=folder,
        env={**os.environ, "NO_COLOR": "1"},
        timeout=280,
    )
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


def test_the_effect_is_named_and_the_gap_closes_on_the_held_out_third(searched):
    folder, said = searched
    report = msgspec.json.decode((folder / "report.json").read_bytes(), type=DiscrepancyReport)
    assert [effect.name for effect in report.effects] == ["mass_change", "velocity_moment"]
    assert report.validation == "last third"
    heavier, effect = report.effects
    assert heavier.parameters["percent"].value == pytest.approx(20.0, abs=0.6)
    moment = effect.parameters["moment"]
    assert abs(moment.value - 12.0) < 4 * moment.stderr
    level = report.gap.validation
    assert level.before > 1.5 > 1.1 > level.after
    assert effect.gap.after == pytest.approx(level.after)
    assert "2. velocity_moment" in said


def test_a_constant_that_moved_is_a_finding_and_no_effect_has_its_merit(searched):
    folder, said = searched
    report = json.loads((folder / "report.json").read_text())
    (change,) = report["base_changes"]
    assert change["name"] == "thrust_per_mass"
    given = 1.2 * BASE.body.thrust_per_mass
    assert change["from"] == pytest.approx(given)
    assert change["to"] == pytest.approx(BASE.body.thrust_per_mass, abs=4 * change["stderr"])
    assert change["percent"] == pytest.approx(-100.0 / 6.0, abs=0.5)
    assert "changed: thrust_per_mass -17 % +- " in said
    assert "the craft is 20 % heavier or its rotors weaker" in said
    improved = load_model(folder / "improved.json")
    assert improved.body.c0 == BASE.body.c0  # what these data cannot improve is as it was given
    _, effect = report["effects"]
    assert effect["gap"]["before"] < 0.7 * report["gap"]["validation"]["before"]
    assert report["left"] == []


def test_the_report_has_the_keys_that_other_programs_read(searched):
    folder, _ = searched
    report = json.loads((folder / "report.json").read_text())
    assert {"verdict", "effects", "where", "gap", "residual"} <= set(report)
    _, effect = report["effects"]
    assert {"name", "order", "parameters", "evidence", "alternatives", "gap"} <= set(effect)
    assert set(effect["parameters"]["moment"]) == {"value", "stderr", "unit"}
    assert {"channel", "regime", "rms", "expected_rms"} <= set(report["where"][0])
    gap = report["gap"]
    assert {"unit", "floor_source", "validation", "train", "channels"} <= set(gap)
    assert set(gap["channels"]) == set(CHANNELS)
    for level in (gap["validation"], gap["train"], *gap["channels"].values()):
        assert np.isfinite([level["before"], level["after"], level["noise_floor"]]).all()


def test_the_improved_model_is_judged_at_the_floor_by_compare(searched):
    folder, _ = searched
    improved = load_model(folder / "improved.json")
    assert [term.name for term in improved.effects] == ["mass_change", "velocity_moment"]
    assert improved.fit["discrepancy"]["verdict"] == "effects_found"
    flights = folder / "clean.mcap", folder / "hidden.mcap"
    said = told("compare", *flights, "--model", folder / "improved.json", "--json")
    report = msgspec.json.decode(said, type=CompareReport)
    assert report.gap.validation.after is None
    # The effect is in one of the two flights only: the model that has it is wrong on the other.
    assert report.gap.channels["gyro_x"].before > 1.2


def test_the_page_holds_every_figure_and_names_the_effect(searched):
    folder, _ = searched
    page = (folder / "report.html").read_text()
    assert page.count("<svg") >= 6
    for words in ("velocity_moment", "The gap closes", "All candidates", "How it is measured"):
        assert words in page
    assert ">nan<" not in page
    assert not re.search(r"(src|href)=\"http", page)


def test_the_rerun_file_is_written_as_asked(searched):
    folder, said = searched
    assert (folder / "shown.rrd").stat().st_size > 100_000
    assert "written: shown.rrd" in said


def told(*arguments):
    """What a command prints that does its work; in this process, where it is loaded already."""
    done = CliRunner().invoke(app, [str(one) for one in arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def said_no(*arguments):
    """Why the command line refuses, in one line; in this process, where it is loaded already."""
    with pytest.raises(BadInputError) as refused:
        app([str(argument) for argument in arguments], standalone_mode=False)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_the_report_is_printed_where_no_file_is_wanted(folder):
    model = folder / "base.json"
    said = told("discrepancy", folder / "clean.mcap", "--model", model, "--json", "-")
    report = msgspec.json.decode(said, type=DiscrepancyReport)
    assert report.verdict == "no_discrepancy"


def test_without_a_model_the_body_is_fitted_first_on_the_flights_that_choose(folder, tmp_path):
    improved, report = tmp_path / "improved.json", tmp_path / "report.json"
    told(
        *("discrepancy", folder / "hidden.mcap", "--vehicle", "crazyflie1"),
        *("-o", improved, "--json", report),
    )
    read = msgspec.json.decode(report.read_bytes(), type=DiscrepancyReport)
    assert read.model == "crazyflie1, its body fitted on these flights"
    assert "velocity_moment" in [effect.name for effect in read.effects]
    found = load_model(improved)
    assert found.body.c0 == pytest.approx(BASE.body.c0, rel=0.05)
    assert found.fit["body"]["recordings"] == [{"file": "hidden.mcap"}]
    assert "give its file with --model" in said_no("discrepancy", folder / "hidden.mcap").lower()


def test_where_no_body_can_be_fitted_the_search_begins_with_the_profile_and_says_so(
    folder, tmp_path, monkeypatch
):
    """And no design takes what it writes for a fit."""

    def refused(*given, **more):
        raise BadInputError("body not identified, because c0 is nan")

    monkeypatch.setattr("groundstation.discrepancy.engine.identify_body", refused)
    improved, report = tmp_path / "improved.json", tmp_path / "report.json"
    told(
        *("discrepancy", folder / "hidden.mcap", "--vehicle", "crazyflie1"),
        *("-o", improved, "--json", report),
    )
    read = msgspec.json.decode(report.read_bytes(), type=DiscrepancyReport)
    assert read.model == "crazyflie1, the body of its profile"
    assert any("the body could not be fitted" in line for line in read.warnings)
    assert "not fitted" in said_no("pid", "design", "--model", improved)


def test_compare_says_where_in_words_and_as_a_page(folder, tmp_path):
    flight, model = folder / "hidden.mcap", folder / "base.json"
    said = told("compare", flight, "--model", model, "--html", tmp_path / "where.html")
    assert "translation" in said
    assert "gap over all channels" in said
    assert (tmp_path / "where.html").read_text().count("<svg") >= 4


@pytest.fixture(scope="module")
def refused(folder):
    """What the command says to a recording made of these samples."""

    def refused(samples, command="discrepancy", model="base.json", *more, **metadata):
        path = folder / f"refused{len(list(folder.iterdir()))}.mcap"
        write(path, samples, **metadata)
        return said_no(command, path, "--model", folder / model, *more)

    return refused


def without(samples, **columns):
    whole = {
        name: np.full_like(getattr(samples, name), np.nan) for name, gone in columns.items() if gone
    }
    return replace(samples, **whole)


@pytest.mark.parametrize("command", ["compare", "discrepancy"])
def test_a_recording_without_gyro_is_refused(refused, command):
    assert "the gyro is not in the recording" in refused(without(flight(12.0), gyro=True), command)


def test_a_refusal_is_one_line_and_exit_status_one(folder):
    write(folder / "short.mcap", flight(12.0)[:1000])
    for command in ("compare", "discrepancy"):
        done = in_process(command, "short.mcap", "--model", "base.json", cwd=folder)
        assert "at least 5 s are needed" in require_failure(done)


def test_a_recording_too_short_to_use_is_left_out_by_name_where_another_is_not(folder):
    write(folder / "beside.mcap", flight(12.0))
    write(folder / "brief.mcap", flight(12.0)[2000:4000])
    done = in_process("compare", "brief.mcap", "beside.mcap", "--model", "base.json", cwd=folder)
    assert done.returncode == 0
    assert "left out: brief.mcap: the longest uninterrupted stretch lasts" in done.stderr
    assert "gap over all channels" in done.stdout


def test_a_craft_that_stayed_on_the_ground_is_refused(refused):
    assert "in the air" in refused(flight(12.0, program="wait"))


def test_a_recording_labelled_with_another_vehicle_is_refused(refused):
    said = refused(flight(12.0), vehicle={"profile": "crazyflie21"})
    assert "the vehicle is 'crazyflie21', the model is for 'crazyflie1'" in said
    assert "--vehicle crazyflie1" in said


def test_a_model_that_is_not_for_the_given_vehicle_is_refused(refused):
    said = refused(flight(12.0), "discrepancy", "base.json", "--vehicle", "crazyflie21")
    assert "the model is for 'crazyflie1'" in said


def test_a_recording_both_fitted_and_held_out_is_refused(folder, tmp_path):
    copy = tmp_path / "copy.mcap"
    copy.write_bytes((folder / "clean.mcap").read_bytes())
    model = ("--model", folder / "base.json")
    said = said_no("discrepancy", folder / "clean.mcap", *model, "--validate", copy)
    assert "copy.mcap: the same as" in said
    assert "given twice" in said_no("compare", copy, copy, *model)


def test_a_pipe_is_refused_and_not_waited_for(folder, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for command in ("compare", "discrepancy"):
        done = in_process(command, tmp_path / "pipe", "--model", "thesis")
        assert "not a file" in require_failure(done)
