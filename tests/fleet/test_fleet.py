"""A fleet of the stand-in, in which something becomes of two crafts: catalogue, fits, findings."""

import json
import shutil
import sys

import pytest
from installed import COMMAND, require_failure
from programs import run_program

pytestmark = pytest.mark.timeout(1200)
PATIENCE_S = 600.0
CRAFTS, FLIGHTS = 4, 8


def fleet(folder, *words):
    return run_program([COMMAND, "fleet", *words], cwd=folder, timeout=PATIENCE_S)


def answer(folder, *words):
    done = fleet(folder, *words, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def fits(catalogue):
    from groundstation.fleet.fit import fits_table

    return fits_table(catalogue).rows()


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A folder with ``flights`` of four crafts, two of which change, and ``truth.json``."""
    folder = tmp_path_factory.mktemp("fleet")
    command = [sys.executable, "-m", "firmware_sim.fleet", "--crafts", CRAFTS, "--flights", FLIGHTS]
    command += ["--for", 16, "--seed", 4, "--wear", 2, "-o", "flights", "--truth", "truth.json"]
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
    told = answer(fitted, "report", "fleet", "--html", "fleet.html")
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


def test_digits_are_the_same_on_one_process_and_on_two_workers(fitted, tmp_path):
    one_craft = str(fitted / "flights" / "cf02")
    answer(tmp_path, "index", one_craft, "-o", "alone", "--workers", "1")
    told = answer(tmp_path, "fit", "alone", "--workers", "1")
    assert told["fitted"] == FLIGHTS
    alone, both = fits(tmp_path / "alone"), fits(fitted / "fleet")
    assert alone == {address: both[address] for address in alone}


def test_what_is_fitted_is_not_fitted_again(fitted, tmp_path):
    shutil.copytree(fitted / "fleet", tmp_path / "fleet")
    told = answer(tmp_path, "fit", "fleet")
    assert (told["fitted"], told["unchanged"]) == (0, CRAFTS * FLIGHTS)
    assert fits(tmp_path / "fleet") == fits(fitted / "fleet")


def test_a_report_of_what_is_not_fitted_says_what_to_do(flown, tmp_path):
    answer(tmp_path, "index", str(flown / "flights" / "cf02"), "-o", "fleet", "--workers", "1")
    done = fleet(tmp_path, "report", "fleet")
    assert "nothing is fitted: fleet fit first" in done.stdout
    assert "no catalogue" in require_failure(fleet(tmp_path, "fit", "nowhere", "--workers", "1"))


def test_the_truth_never_lies_among_the_recordings_and_nothing_is_overwritten(flown):
    command = [
        sys.executable,
        "-m",
        "firmware_sim.fleet",
        "-o",
        "others",
        "--truth",
        "others/t.json",
    ]
    done = run_program(command, cwd=flown)
    assert done.returncode == 1
    assert "must not lie among the recordings" in done.stderr
    again = run_program([*command[:3], "-o", "flights"], cwd=flown)
    assert again.returncode == 1
    assert "flights: exists already" in again.stderr
