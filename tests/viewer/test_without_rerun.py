"""Everything but the live view works without rerun; what needs it names the extra to install."""

import sys

import pytest

from support import RECORDINGS
from support.daemons import require_failure
from support.programs import run_program

FLIGHT = RECORDINGS / "stand_in_flight.mcap"
WITHOUT = (
    "import sys; sys.modules['rerun'] = sys.modules['rerun_cli'] = None; "
    "from groundstation.cli.main import main; main()"
)
EXTRA = "needs rerun, an optional part of some 500 MB: pip install"


def without_rerun(*arguments, cwd):
    return run_program([sys.executable, "-c", WITHOUT, *map(str, arguments)], cwd=cwd)


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "--link", f"replay:{FLIGHT}", "--viewer", "serve", "--no-record"),
        ("convert", FLIGHT, "flight.rrd"),
        ("discrepancy", FLIGHT, "--model", "thesis", "--rerun", "shown.rrd"),
    ],
    ids=["live view", "convert", "discrepancy --rerun"],
)
def test_what_needs_rerun_names_the_extra(arguments, tmp_path):
    said = require_failure(without_rerun(*arguments, cwd=tmp_path))
    assert f"{EXTRA} 'crazyflie-groundstation[viewer]'" in said
    assert not any(tmp_path.iterdir()), "nothing half-made"


def test_the_daemon_records_without_rerun(tmp_path):
    options = ("--link", f"replay:{FLIGHT}", "--speed", "max", "--recordings", "sessions")
    done = without_rerun("run", *options, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (recorded,) = (tmp_path / "sessions").glob("*.mcap")
    assert "samples" in without_rerun("inspect", recorded, cwd=tmp_path).stdout
