"""The installed ``groundstation`` command, as a user runs it, and Dask's programs; and a library
that is loaded before the C library: it steps a program's wall clock, and logs what is synced.

Stepping the machine's own clock would disturb everything else on it, and pulling its plug even
more so. Needs a C compiler.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import warnings
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import psutil
import pytest

from groundstation.cli import main
from groundstation.errors import GroundStationError
from groundstation.recording.quality import inspect_recording
from groundstation.service.client import ask
from support.programs import Program, run_program
from support.waiting import PATIENCE_S, until

COMMAND = Path(sys.executable).with_name("groundstation")


def groundstation(*arguments, socket_path=None, cwd=None):
    """Run one command to its end."""
    return run_program(
        [COMMAND, *map(str, arguments)],
        env=_environment(socket_path),
        cwd=cwd,
        timeout=PATIENCE_S,
    )


def in_process(*arguments, socket_path=None, cwd=None):
    """The same in this process, where everything is loaded already, which takes a second: the whole
    program but for the moment at which it leaves."""
    out, error = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
    given = {"GROUNDSTATION_SOCKET": str(socket_path)} if socket_path else {}
    terminate, status = signal.getsignal(signal.SIGTERM), None
    with (
        contextlib.chdir(cwd or "."),
        patch.dict(os.environ, given),
        patch.object(sys, "argv", [str(COMMAND), *map(str, arguments)]),
        patch.object(main, "_leave", sys.exit),
        warnings.catch_warnings(),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(error),
    ):
        warnings.simplefilter("default")
        try:
            main.main()
        except SystemExit as end:
            status = end.code
    signal.signal(signal.SIGTERM, terminate)
    said = (one.buffer.getvalue().decode() for one in (out, error))
    return subprocess.CompletedProcess(arguments, status, *said)


def require_failure(result, status=1):
    """A failed command says why in one line and shows no traceback; that line."""
    assert result.returncode == status, result.stderr or result.stdout
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("groundstation: ")
    return lines[0]


def refused_run(folder, *arguments):
    """A daemon that cannot begin ends with one line of its own, after its events; that line.

    Its socket is its own and beside ``folder``: another test may run a daemon at the same time."""
    ended = in_process("run", *arguments, socket_path=f"{folder}.sock", cwd=folder)
    assert ended.returncode == 1, ended.stdout
    *_, line = ended.stderr.strip().splitlines()
    assert line.startswith("groundstation: ")
    assert "Traceback" not in ended.stderr
    return line


def gaps(recording):
    """How many gaps a recording of the stand-in has beside those that it explains itself: where
    the machine holds the daemon up, what the craft sent meanwhile is lost, as on a real link."""
    explained = sum("stood still for" in event["text"] for event in recording.events)
    return max(inspect_recording(recording)["gap_count"] - explained, 0)


class Daemon:
    """``groundstation run`` in a folder of its own: recordings in ``sessions``.

    Used as a context it is never left behind.
    """

    def __init__(
        self, folder, *arguments, socket_path=None, stdout=None, stderr=None, environment=None
    ):
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.socket = socket_path or self.folder / "control.sock"
        self.sessions = self.folder / "sessions"
        self._out, self._err = self.folder / "stdout", self.folder / "stderr"
        with self._out.open("wb") as out, self._err.open("wb") as err:
            self.process = Program(
                [COMMAND, "run", *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                stdout=stdout or out,
                stderr=stderr or err,
                env={**_environment(self.socket), **(environment or {})},
                cwd=self.folder,
            )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.end()

    @property
    def stdout(self):
        return self._out.read_text()

    @property
    def stderr(self):
        return self._err.read_text()

    @property
    def last_line(self):
        """What the program said last on stderr: an error, or an event."""
        lines = self.stderr.strip().splitlines()
        return lines[-1] if lines else ""

    def ask(self, method, route):
        return ask(self.socket, method, route)

    def status(self):
        """The daemon's status, or None while it does not answer yet."""
        assert self.process.poll() is None, f"it has ended: {self.stdout}{self.stderr}"
        with contextlib.suppress(GroundStationError):
            return self.ask("GET", "/status")
        return None

    def status_when(self, condition, what):
        """The first status for which ``condition`` holds."""

        def look():
            status = self.status()
            return status if status and condition(status) else None

        # 2 ms of processor time each, here and in the daemon
        return until(look, what, every_s=0.04)

    def recording(self, samples=1):
        """Wait until ``samples`` are in the file; the status then."""
        return self.status_when(
            lambda status: status["recording"]["samples"] >= samples, f"{samples} samples"
        )

    def files(self):
        return sorted(self.sessions.glob("*.mcap"))

    def only_file(self):
        (file,) = self.files()
        return file

    def children(self):
        return psutil.Process(self.process.pid).children(recursive=True)

    def child(self, marker):
        """The running child with this word on its command line, once there is one."""

        def look():
            for process in self.children():
                with contextlib.suppress(psutil.Error):  # it may have ended since
                    words = process.cmdline()
                    if marker in words and "groundstation.viewer.leash" not in words:
                        return process
            return None

        return until(look, f"a child {marker}")

    def stop(self, number=signal.SIGINT):
        """Send a signal and wait; the exit status."""
        self.process.send_signal(number)
        return self.wait()

    def wait(self):
        return self.process.wait(PATIENCE_S)


def inspected(path):
    """``inspect --json`` of a file, which must be sound."""
    result = groundstation("inspect", path, "--json")
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def _environment(socket_path):
    environment = {**os.environ, "NO_COLOR": "1"}
    environment.pop("FORCE_COLOR", None)
    if socket_path is not None:
        environment["GROUNDSTATION_SOCKET"] = str(socket_path)
    return environment


@contextmanager
def dask(log, *words, cwd=None):
    """``dask scheduler`` or ``dask worker`` as a process."""
    command = [Path(sys.executable).with_name("dask"), *map(str, words)]
    places = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}  # for what a test sends
    with log.open("ab") as file:
        options = {"stdout": file, "stderr": file, "env": places, "cwd": cwd}
        with Program(command, **options) as program:
            yield program


@contextmanager
def scheduler(log, port):
    """One that answers."""

    def answers():
        with socket.socket() as trial:
            return trial.connect_ex(("127.0.0.1", port)) == 0

    with dask(log, "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard") as program:
        until(answers, "the scheduler answers")
        yield program


@contextmanager
def worker(log, port, folder):
    """One thread, at home in ``folder``, that its scheduler knows."""

    def known():
        return log.read_text().count("Registered to")

    folder.mkdir(exist_ok=True)
    command = ("worker", f"tcp://127.0.0.1:{port}", "--nthreads", 1, "--no-dashboard")
    before = known()
    with dask(log, *command, "--local-directory", folder, cwd=folder) as program:
        until(lambda: known() > before, "the scheduler knows the worker")
        yield program


SOURCE = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

static int (*real_gettime)(clockid_t, struct timespec *);
static int (*real_sync)(int);

static long long offset_s(void) {
    long long value = 0;
    const char *path = getenv("SHIM_OFFSET");
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (file >= 0) {
        if (read(file, &value, sizeof value) != sizeof value) value = 0;
        close(file);
    }
    return value;
}

int clock_gettime(clockid_t which, struct timespec *now) {
    if (!real_gettime) real_gettime = dlsym(RTLD_NEXT, "clock_gettime");
    int result = real_gettime(which, now);
    if (result == 0 && which == CLOCK_REALTIME) now->tv_sec += offset_s();
    return result;
}

int fdatasync(int number) {
    if (!real_sync) real_sync = dlsym(RTLD_NEXT, "fdatasync");
    struct stat before;
    int known = fstat(number, &before) == 0;
    int result = real_sync(number);
    const char *path = getenv("SHIM_SYNCS");
    if (path && known && result == 0) {
        struct timespec now;
        if (!real_gettime) real_gettime = dlsym(RTLD_NEXT, "clock_gettime");
        real_gettime(CLOCK_REALTIME, &now);
        FILE *log = fopen(path, "a");
        fprintf(log, "%lld %lld %lld\n", (long long)before.st_ino, (long long)before.st_size,
                now.tv_sec * 1000000000LL + now.tv_nsec);
        fclose(log);
    }
    return result;
}
"""


@dataclass
class Shim:
    """environment: for the program that is to be deceived."""

    folder: Path

    @property
    def environment(self) -> dict[str, str]:
        return {
            "LD_PRELOAD": str(self.folder / "shim.so"),
            "SHIM_OFFSET": str(self.folder / "offset"),
            "SHIM_SYNCS": str(self.folder / "syncs"),
        }

    def step_clock(self, seconds: int) -> None:
        """From now on the wall clock is so far from the real one."""
        (self.folder / "offset").write_bytes(struct.pack("q", seconds))

    def syncs(self, inode: int) -> list[tuple[int, int]]:
        """(size, Unix ns) of each sync of a file that has come back."""
        rows = [map(int, line.split()) for line in (self.folder / "syncs").read_text().splitlines()]
        return [(size, time_ns) for number, size, time_ns in rows if number == inode]


def build_shim(folder: Path) -> Shim:
    """Compile it, or skip the test where there is no compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("stepping a clock needs a C compiler")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "shim.c").write_text(SOURCE)
    run_program(
        [compiler, "-shared", "-fPIC", "-O1", "-o", folder / "shim.so", folder / "shim.c", "-ldl"],
        check=True,
    )
    return Shim(folder)
