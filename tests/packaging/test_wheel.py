"""What is given to the package index: built, checked, and installed by its name alone.

Building and installing ask the package index for tools and libraries; without it these tests fail.
"""

import shutil
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

import groundstation
from support import RECORDINGS, ROOT
from support.programs import run_program

pytestmark = pytest.mark.timeout(900)
NO_INDEX = "pip could not fetch what the build or the program needs: is the package index in reach?"


def done(*command, cwd):
    """One command to its end; its output. Fails with what it said."""
    ended = run_program([*map(str, command)], cwd=cwd, timeout=600)
    if "No matching distribution" in ended.stderr or "NewConnectionError" in ended.stderr:
        pytest.fail(f"{NO_INDEX}\n{ended.stderr}")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """(source distribution, wheel), built from a copy of the files that git knows."""
    folder = tmp_path_factory.mktemp("built")
    for name in done("git", "ls-files", cwd=ROOT).splitlines():
        copy = folder / "source" / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, copy)
    done(sys.executable, "-m", "build", "-o", folder / "dist", folder / "source", cwd=folder)
    (source,) = (folder / "dist").glob("*.tar.gz")
    (wheel,) = (folder / "dist").glob("*.whl")
    return source, wheel


@pytest.fixture(scope="module")
def program(built, tmp_path_factory):
    """The command in a clean environment that has the wheel and nothing else of ours."""
    environment = tmp_path_factory.mktemp("clean") / "venv"
    venv.create(environment, with_pip=True)
    done(
        *(environment / "bin" / "pip", "install", "--disable-pip-version-check"),
        *("-c", ROOT / "constraints.txt", built[1]),
        cwd=environment,
    )
    return environment / "bin" / "groundstation"


def test_both_files_are_what_an_index_takes(built, tmp_path):
    assert [path.name.split("-")[0] for path in built] == ["crazyflie_groundstation"] * 2
    assert all(f"-{groundstation.__version__}" in path.name for path in built)
    done(sys.executable, "-m", "twine", "check", "--strict", *built, cwd=tmp_path)
    checker = Path(sys.executable).with_name("check-wheel-contents")
    done(checker, "--config", ROOT / "pyproject.toml", built[1], cwd=tmp_path)


def test_the_wheel_has_the_types_and_every_file_that_the_program_reads(built):
    inside = set(zipfile.ZipFile(built[1]).namelist())
    for package in ("groundstation", "firmware_sim"):
        tracked = done("git", "ls-files", package, cwd=ROOT).split()
        assert set(tracked) <= inside
    with tarfile.open(built[0]) as source:
        assert any(name.endswith("/LICENSE") for name in source.getnames())


def test_the_installed_wheel_records_inspects_and_fits_without_the_viewer(program, tmp_path):
    assert "record" in done(program, "--help", cwd=tmp_path)
    assert "samples" in done(program, "inspect", RECORDINGS / "thesis_excerpt.mcap", cwd=tmp_path)
    done(program, "run", "--link", "stand-in", "--for", "2", cwd=tmp_path)
    (recorded,) = (tmp_path / "sessions").glob("*.mcap")
    assert "samples" in done(program, "inspect", recorded, cwd=tmp_path)
    flights = [RECORDINGS / f"nanobench_{name}.mcap" for name in ("figure8", "trefoil")]
    options = ("--validate", flights[1], "-o", "real.json")
    done(program, "fit", "body", flights[0], *options, cwd=tmp_path)
    assert (tmp_path / "real.json").is_file()
    refused = run_program([program, "convert", recorded, "flight.rrd"], cwd=tmp_path)
    assert refused.returncode == 1
    assert "crazyflie-groundstation[viewer]" in refused.stderr
