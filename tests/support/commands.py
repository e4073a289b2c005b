"""Commands as a user types them: in this process, on a terminal, and beside a daemon's craft."""

import contextlib
import os
import pty
import signal
import subprocess
import sys

from typer.testing import CliRunner

from groundstation.cli.app import app
from groundstation.service.client import ask
from support.daemons import COMMAND
from support.programs import Program, run_program
from support.waiting import until


def done(*arguments, typed=None):
    """A command that ends well, in this process; what it raises, raised."""
    words = [str(one) for one in arguments]
    result = CliRunner().invoke(app, words, input=typed, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result


def run(*arguments):
    """What it says, on both streams."""
    return done(*arguments).output


class Terminal:
    """A program on a pseudo-terminal of its own: what it shows, and what is typed."""

    def __init__(self, folder, *arguments, environment=()):
        self.shown = ""
        self.status = None
        self._pid, self._screen = pty.fork()
        if self._pid == 0:
            os.chdir(folder)
            os.environ["GROUNDSTATION_SOCKET"] = str(folder / "control.sock")
            os.environ.update(environment)
            os.execv(COMMAND, [COMMAND, *map(str, arguments)])
        os.set_blocking(self._screen, False)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.status is None:
            os.kill(self._pid, signal.SIGKILL)
            os.waitpid(self._pid, 0)
        os.close(self._screen)

    def type(self, keys):
        os.write(self._screen, keys)

    def shows(self, text):
        self._look()
        return text in self.shown

    def until(self, text):
        """Wait for what it shows."""
        until(lambda: self.shows(text), text)

    def ends(self, *patience_s):
        """Wait for its end; its exit status."""
        until(self._has_ended, "the end", *patience_s)
        return self.status

    def _has_ended(self):
        self._look()
        pid, status = os.waitpid(self._pid, os.WNOHANG)
        if pid:
            self.status = os.waitstatus_to_exitcode(status)
            self._look()
        return pid

    def _look(self):
        try:
            while piece := os.read(self._screen, 65536):
                self.shown += piece.decode(errors="replace")
        except OSError:  # nothing more now, or the other side is closed
            pass


class Beside:
    """Commands beside a daemon, with a state folder of their own."""

    def __init__(self, daemon):
        self.daemon = daemon
        self._environment = {
            **os.environ,
            "NO_COLOR": "1",
            "GROUNDSTATION_SOCKET": str(daemon.socket),
            "XDG_STATE_HOME": str(daemon.folder / "state"),
        }

    def run(self, *arguments):
        words = [COMMAND, *map(str, arguments)]
        return run_program(words, env=self._environment, timeout=200)

    def begun(self, *arguments):
        """One that goes on beside the test."""
        piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return Program([COMMAND, *map(str, arguments)], env=self._environment, **piped)

    def fly(self, *arguments):
        return self.run("pid", "fly", *arguments)

    def flown(self, *arguments):
        """The same, to a good end."""
        flight = self.fly(*arguments)
        assert flight.returncode == 0, flight.stderr
        return flight

    @contextlib.contextmanager
    def flying(self, *arguments, mark="pid fly programme"):
        """``pid fly`` in the midst of its programme; killed in the end if it still runs."""
        with self.begun("pid", "fly", *arguments) as flight:

            def in_programme():
                assert flight.poll() is None, f"it ended by itself: {flight.communicate()}"
                return mark in self.events("mark")

            until(in_programme, "the programme is flown")
            yield flight

    def events(self, kind):
        told = ask(self.daemon.socket, "GET", "/events")
        return [event["text"] for event in told if event["kind"] == kind]

    def gains(self):
        """Every parameter of the craft."""
        return ask(self.daemon.socket, "GET", "/command/parameters")["values"]


def connected(status):
    """Whether the daemon commands a craft."""
    command = status["command"]
    return command is not None and command["state"] == "connected"


@contextlib.contextmanager
def software_craft(folder, settings, *arguments):
    """A craft that is a program of its own, switched on just now."""
    path = folder / "craft.toml"
    path.write_text(settings)
    command = [sys.executable, "-m", "firmware_sim", "--settings", path, *arguments]
    with Program(command, stdout=subprocess.PIPE, text=True) as craft:
        assert any("udp://" in line or "serial:" in line for line in craft.stdout), "its address"
        yield craft
