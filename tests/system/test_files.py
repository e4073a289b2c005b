"""inspect, convert, and help, as a user types them."""

import csv
import json

import numpy as np
import pytest
import typer

from groundstation import __version__
from groundstation.cli.app import app
from groundstation.recording.formats import open_recording
from support import RECORDINGS
from support.daemons import in_process, inspected, require_failure

EXCERPT = RECORDINGS / "thesis_excerpt.csv"
INSPECT_KEYS = {
    "samples", "raw_packets", "duration_s", "rate_hz", "lost_samples", "gaps", "duplicates",
    "link", "segments", "verdict",
}  # fmt: skip


def commands(command=None, path=()):
    """Every command that can be typed: its words, and the command itself."""
    command = command or typer.main.get_command(app)
    children = getattr(command, "commands", None)
    if children is None:
        yield path, command
    else:
        for name, child in children.items():
            yield from commands(child, (*path, name))


def convert(source, target, *options):
    result = in_process("convert", source, target, *options)
    assert result.returncode == 0, result.stderr
    assert str(target) in result.stdout
    return target


def test_the_real_excerpt_survives_csv_mcap_csv_byte_by_byte(tmp_path):
    as_mcap = convert(EXCERPT, tmp_path / "excerpt.mcap")
    as_csv = convert(as_mcap, tmp_path / "excerpt.csv")
    assert as_csv.read_bytes() == EXCERPT.read_bytes()


def test_a_flight_of_a_craft_that_tells_no_battery_is_given_what_its_motors_were_fed_with(tmp_path):
    whole = convert(EXCERPT, tmp_path / "whole.csv", "--physical")
    rows = list(csv.DictReader(whole.read_text().splitlines()))
    untold = tmp_path / "untold.csv"
    with untold.open("w", newline="") as file:
        out = csv.DictWriter(file, rows[0])
        out.writeheader()
        out.writerows({**row, "battery_v": ""} for row in rows)
    assert np.isnan(open_recording(untold).samples.battery_v).all()
    given = open_recording(convert(untold, tmp_path / "given.mcap", "--supply-v", "3.7"))
    assert given.samples.battery_v == pytest.approx(3.7)
    assert given.metadata["supply"] == {"given_v": "3.7"}
    for source, volts, why in ((whole, "3.7", "has the battery's voltage"), (untold, "1", "2..20")):
        refused = in_process("convert", source, tmp_path / "no.mcap", "--supply-v", volts)
        assert why in require_failure(refused)
        assert not (tmp_path / "no.mcap").exists()


def test_the_committed_mcap_is_the_committed_csv(tmp_path):
    as_csv = convert(RECORDINGS / "thesis_excerpt.mcap", tmp_path / "excerpt.csv")
    assert as_csv.read_bytes() == EXCERPT.read_bytes()


def test_the_excerpt_converts_to_rerun_which_is_not_read_back(tmp_path):
    as_rrd = convert(EXCERPT, tmp_path / "excerpt.rrd")
    line = require_failure(in_process("convert", as_rrd, tmp_path / "excerpt.csv"))
    assert "give the recording that it was made of" in line


def test_a_physical_table_has_units_in_its_header_and_the_values(tmp_path):
    table = convert(EXCERPT, tmp_path / "physical.csv", "--physical")
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 25
    gyro = [name for name in rows[0] if name.startswith("gyro_x")]
    assert gyro
    samples = open_recording(EXCERPT).samples
    values = np.array([float(row[gyro[0]]) for row in rows])
    assert "deg" in gyro[0]
    np.testing.assert_allclose(values, np.degrees(samples.gyro[:, 0]), rtol=1e-5)


def test_a_flight_survives_mcap_csv_mcap_sample_by_sample(tmp_path):
    source = RECORDINGS / "stand_in_flight.mcap"
    back = convert(convert(source, tmp_path / "flight.csv"), tmp_path / "flight.mcap")
    one, other = open_recording(source).samples, open_recording(back).samples
    for name in ("ticks", "battery_v", "duty", "gyro", "accelerometer", "attitude", "debug"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


@pytest.mark.parametrize(
    ("arguments", "mentions"),
    [
        ((EXCERPT, "out.txt"), "must end in .csv, .mcap, .parquet or .rrd"),
        ((EXCERPT, "out.mcap", "--physical"), "--physical is for CSV files"),
        ((RECORDINGS / "README.md", "out.csv"), "no column is a time"),
        ((RECORDINGS / "thesis_excerpt.mcap", "out.csv", "--columns", EXCERPT), "column map"),
    ],
)
def test_conversions_that_make_no_sense_are_refused(tmp_path, arguments, mentions):
    line = require_failure(in_process("convert", *arguments, cwd=tmp_path))
    assert mentions in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["thesis_excerpt.csv", "thesis_excerpt.mcap", "microsd_log16"])
def test_inspect_has_the_keys_that_programs_read(name):
    report = inspected(RECORDINGS / name)
    assert set(report) >= INSPECT_KEYS
    assert report["lost_samples"] == 0 or name == "microsd_log16"
    assert report["gaps"] == [] or name == "microsd_log16"


def test_inspect_tells_the_committed_flight_for_what_it_is():
    report = inspected(RECORDINGS / "stand_in_flight.mcap")
    assert report["link"] == "stand-in"
    assert report["rate_hz"] == pytest.approx(500, abs=0.1)
    assert report["duration_s"] > 30
    assert report["verdict"].startswith("good")
    assert report["raw_packets"] - report["duplicates"] == report["samples"]
    duty = report["ranges"]["duty_1"]
    assert duty["min"] == 0
    assert duty["mean"] > 0.4, "it includes the take-off and flies"
    shown = in_process("inspect", RECORDINGS / "stand_in_flight.mcap")
    assert shown.returncode == 0
    assert report["verdict"] in shown.stdout
    assert len((RECORDINGS / "stand_in_flight.mcap").read_bytes()) < 1_500_000


def test_the_readme_describes_every_committed_recording():
    text = (RECORDINGS / "README.md").read_text()
    for path in RECORDINGS.iterdir():
        assert path.name == "README.md" or f"`{path.name}`" in text, path.name


def test_every_command_has_an_example_of_itself_in_its_help():
    found = list(commands())
    assert {path[0] for path, _ in found} >= {
        "run", "status", "events", "record", "inspect", "convert", "recover",
    }  # fmt: skip
    for path, command in found:
        _, _, example = (command.help or "").partition("Example: ")
        assert f"groundstation {' '.join(path)}" in example, path


@pytest.mark.parametrize("words", [[], ["convert"], ["record", "start"]])
def test_help_is_printed_on_request(words):
    result = in_process(*words, "--help")
    assert result.returncode == 0
    assert "Usage: groundstation" in result.stdout
    assert not words or f"groundstation {' '.join(words)}" in " ".join(result.stdout.split())


def test_the_version_is_printed_on_request():
    assert in_process("--version").stdout == f"groundstation {__version__}\n"


@pytest.mark.parametrize(
    "words",
    [
        ["fly-to-the-moon"],
        ["inspect"],
        ["inspect", "--colour", "file"],
        ["convert", "one"],
        ["run", "--for", "soon"],
        ["run", "--for", "-1"],
        ["run", "--web-port=9090"],
        ["simulate", "--html", "page.html"],
        ["record", "pause"],
    ],
)
def test_wrong_usage_has_its_own_exit_status(words, tmp_path):
    result = in_process(*words, cwd=tmp_path)
    assert result.returncode == 2
    assert "Usage: groundstation" in result.stderr
    assert result.stdout == ""


def test_json_is_the_only_thing_on_the_output():
    result = in_process("inspect", EXCERPT, "--json")
    assert json.loads(result.stdout)["samples"] == 25
    assert result.stderr == ""
