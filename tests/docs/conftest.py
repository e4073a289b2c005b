"""Where the commands and examples of the pages are run."""

import os
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from support import ROOT
from support.daemons import Daemon
from support.pages import Larder
from support.programs import free_port


@pytest.fixture(scope="session")
def larder(tmp_path_factory):
    return Larder(tmp_path_factory.mktemp("larder"))


@contextmanager
def running_station(folder):
    """A running daemon with the software craft and a command link."""
    socket = folder / "groundstation" / "control.sock"
    socket.parent.mkdir()
    command = f"udp://127.0.0.1:{free_port()}"
    (folder / "waiting.toml").write_text("[stand_in]\nprogram = 'wait'\n")
    arguments = ("--link", "stand-in", "--command", command, "--config", folder / "waiting.toml")
    with Daemon(folder, *arguments, socket_path=socket) as daemon:
        daemon.status_when(
            lambda status: status["command"]["state"] == "connected", "the command link"
        )
        daemon.recording()
        yield daemon
        assert daemon.stop() == 0, daemon.stderr


@pytest.fixture
def with_station(tmp_path_factory, monkeypatch):
    """Commands find a daemon while they run, which flies no longer than that."""

    @contextmanager
    def begin():
        with (
            running_station(tmp_path_factory.mktemp("station")) as daemon,
            monkeypatch.context() as m,
        ):
            find_it(daemon, m)
            yield

    return begin


@pytest.fixture(scope="module")
def lasting_station(tmp_path_factory):
    with running_station(tmp_path_factory.mktemp("station")) as daemon:
        yield daemon


@pytest.fixture
def station(lasting_station, monkeypatch):
    """Commands find a daemon that records, the same for all tests of a module."""
    find_it(lasting_station, monkeypatch)
    if lasting_station.status()["recording"]["state"] != "recording":
        lasting_station.ask("POST", "/record/start")
    lasting_station.recording()


def find_it(daemon, monkeypatch):
    monkeypatch.setenv("GROUNDSTATION_SOCKET", str(daemon.socket))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(daemon.folder))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where a command is run: the repository's recordings are there, as after a clone."""
    (tmp_path / "recordings").symlink_to(ROOT / "recordings")
    (tmp_path / ".venv").symlink_to(sys.prefix)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    return tmp_path
