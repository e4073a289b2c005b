"""A fleet of the stand-in, in which something becomes of two crafts: catalogue, fits, findings."""

import contextlib
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from bench import fleet_flights
from groundstation.cli.app import app
from groundstation.dynamics.model import Model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.fleet.search import CraftFlights, search_craft
from groundstation.identification.body import fit_body
from groundstation.identification.flight import stretches_of
from groundstation.identification.runs import bridged
from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_file import write_mcap
from support.daemons import COMMAND, require_failure
from support.programs import run_program

pytestmark = pytest.mark.timeout(1200)
PATIENCE_S = 600.0
CRAFTS, FLIGHTS = 4, 8


def fleet(folder, *words):
    return run_program([COMMAND, "fleet", *words], cwd=folder, timeout=PATIENCE_S)


def answer(folder, *words):
    done = fleet(folder, *words, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def answer_here(folder, *words):
    """The same of a command that takes this process alone, where it is loaded already."""
    with contextlib.chdir(folder):
        done = CliRunner().invoke(app, ["fleet", *words, "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def fits(catalogue):
    from groundstation.fleet.fit import fits_table

    return fits_table(catalogue).rows()


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A folder with ``flights`` of four crafts, two of which change, and ``truth.json``."""
    folder = tmp_path_factory.mktemp("fleet")
    command = [sys.executable, fleet_flights.__file__, "--crafts", CRAFTS, "--flights", FLIGHTS]
    command += ["--for", 16, "--seed", 0, "--wear", 2, "-o", "flights", "--truth", "truth.json"]
    done = run_program([str(one) for one in command], cwd=folder, timeout=PATIENCE_S)
    assert done.returncode == 0, done
    return folder


@pytest.fixture(scope="module")
def fitted(flown):
    """The same with its catalogue ``fleet``."""
    damaged = flown / "flights" / "cf01" / "2026-01-01T00-00-00Z_torn.npz"
    damaged.write_bytes(b"PK\x03\x04 and nothing else")
    made = answer(flown, "index", "flights", "-o", "fleet")
    assert made["recordings"] == CRAFTS * FLIGHTS + 1
    assert made["damaged"] == 1
    assert made["crafts"] == [f"cf{number:02d}" for number in range(1, CRAFTS + 1)]
    told = answer(flown, "fit", "fleet")
    assert (told["fitted"], told["refused"]) == (CRAFTS * FLIGHTS, 0)
    return flown


def test_what_became_of_whom_is_named_and_nobody_else(fitted):
    told = answer_here(fitted, "report", "fleet", "--html", "fleet.html")
    truth = json.loads((fitted / "truth.json").read_text())
    assert {one["kind"] for one in truth} == {"rotor", "load"}
    assert len(told["findings"]) == len(truth)
    for one in truth:
        (found,) = (f for f in told["findings"] if f["craft"] == one["craft"])
        assert found["kind"] == "change"
        assert found["flight"] == one["since"]
        if one["kind"] == "rotor":
            assert found["quantity"] == f"rotor_{one['rotor']}"
            # the others carry a quarter each of what it does not
            assert found["size"] == pytest.approx(-0.75 * one["size"], rel=0.15)
        else:
            assert found["quantity"] == "thrust_per_mass"
            assert found["size"] == pytest.approx(1.0 / (1.0 + one["size"]) - 1.0, rel=0.1)
    page = (fitted / "fleet.html").read_text()
    assert "2 of 4 crafts changed" in page
    assert "2026-01-01T00-00-00Z_torn.npz" in page


def test_what_is_fitted_is_not_fitted_again(fitted, tmp_path):
    shutil.copytree(fitted / "fleet", tmp_path / "fleet")
    told = answer(tmp_path, "fit", "fleet")
    assert (told["fitted"], told["unchanged"]) == (0, CRAFTS * FLIGHTS)
    assert fits(tmp_path / "fleet") == fits(fitted / "fleet")


@pytest.fixture(scope="module")
def sound(fitted, tmp_path_factory):
    """A catalogue of one craft of which nothing became, searched on three of its flights."""
    ill = {one["craft"] for one in json.loads((fitted / "truth.json").read_text())}
    craft = min({f"cf{number:02d}" for number in range(1, CRAFTS + 1)} - ill)
    folder = tmp_path_factory.mktemp("sound")
    answer_here(folder, "index", str(fitted / "flights" / craft), "-o", "one", "--workers", "1")
    told = answer_here(folder, "discrepancy", "one", "--flights", "3", "--workers", "1")
    assert (told["searched"], told["refused"]) == (1, 0)
    return folder, told["crafts"][0]


def delay_of(address):
    """By the body fit of one flight alone."""
    runs = bridged(open_recording(Path(address)).samples)
    stretches = stretches_of(runs, BUILT_IN["crazyflie1"].motor)
    return fit_body(
        stretches, BUILT_IN["crazyflie1"], ("dead_time", "rotor_acceleration_torque")
    ).delay_s


def test_a_craft_is_searched_on_its_flights_together_and_whole_flights_are_held_out(sound):
    folder, row = sound
    assert (len(row["fitted"]), len(row["held_out"])) == (2, 1)
    assert {"attitude_filter_lean", "dead_time"} <= set(row["effects"])
    assert row["gap_after"] < row["gap_before"]
    sizes = dict(zip(row["parameters"], row["values"], strict=True))
    assert sizes["attitude_filter_lean.strength"] == pytest.approx(1.0, abs=0.01)
    # Each flight has its own: the phase of its sample clock against the loop is drawn.
    delays = [delay_of(address) for address in row["fitted"]]
    assert min(delays) - 1e-4 < sizes["dead_time.delay_s"] < max(delays) + 1e-4
    assert any("yaw steps" in one for one in row["to_fly"])  # so short a flight has none
    again = answer_here(folder, "discrepancy", "one", "--flights", "3", "--workers", "1")
    assert (again["searched"], again["unchanged"]) == (0, 1)


def test_a_flight_that_is_too_short_is_left_out_by_name_and_the_others_are_searched(sound):
    folder, row = sound
    whole = open_recording(Path(row["fitted"][0]))
    write_mcap(replace(whole, samples=whole.samples[:1500]), folder / "short.mcap")
    flights = (row["fitted"][0], str(folder / "short.mcap"))
    task = CraftFlights(row["craft"], flights, tuple(row["held_out"]), "")
    told = search_craft(task, msgspec.json.decode(row["model"], type=Model), None)
    assert told["reason"] is None
    assert told["gap_after"] <= told["gap_before"]
    assert any("short.mcap" in words and "left out" in words for words in told["warnings"])


def test_the_page_says_effects_and_what_is_otherwise_since_a_date(sound):
    folder, row = sound
    report = answer_here(
        folder, "report", "one", "--compare-before", "2026-01-06", "--html", "one.html"
    )
    assert [one["craft"] for one in report["effects"]] == [row["craft"]]
    assert set(report["to_fly"]) <= {row["craft"]}
    page = (folder / "one.html").read_text()
    for heading in ("Effects", "Before and after 2026-01-06"):
        assert f">{heading}</h2>" in page
    refused = fleet(folder, "report", "one", "--compare-before", "yesterday")
    assert "not a date" in require_failure(refused)


def test_a_report_of_what_is_not_fitted_says_what_to_do(flown, tmp_path):
    answer_here(tmp_path, "index", str(flown / "flights" / "cf02"), "-o", "fleet", "--workers", "1")
    done = fleet(tmp_path, "report", "fleet")
    assert "nothing is fitted: fleet fit first" in done.stdout
    assert "no catalogue" in require_failure(fleet(tmp_path, "fit", "nowhere", "--workers", "1"))


def test_the_truth_never_lies_among_the_recordings_and_nothing_is_overwritten(flown):
    command = [
        sys.executable,
        fleet_flights.__file__,
        "-o",
        "others",
        "--truth",
        "others/t.json",
    ]
    done = run_program(command, cwd=flown)
    assert done.returncode == 1
    assert "must not lie among the recordings" in done.stderr
    again = run_program([*command[:2], "-o", "flights"], cwd=flown)
    assert again.returncode == 1
    assert "flights: exists already" in again.stderr
