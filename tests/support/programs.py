"""Programs that tests start: each is killed in the end, with all that it started itself.

By leaving its context, whatever the test's state; and by a guard, a process of its own, when the
interpreter that runs the tests is gone, however it went: then also what the code under test
started. What belongs to a program is told by a variable in its environment, which all that it
starts inherits, in whatever session or group. No other file starts a process (``tests/suite``).
"""

import contextlib
import functools
import itertools
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

LONGEST_S = 240.0
"""Less than a test is given (pyproject.toml)."""
MARK = "STARTED_BY_TESTS"
PORTS = range(20_000, 32_000)
_PORTS = itertools.islice(itertools.cycle(PORTS), 131 * os.getpid() % len(PORTS), None)
_numbers = itertools.count()


class Program(subprocess.Popen):
    """``subprocess.Popen`` with a process group of its own. Used as a context it ends with it."""

    def __init__(self, command, *, env=None, **options):
        start_guard()
        self._token = f"{os.getpid()}.{next(_numbers)}/"
        environment = dict(os.environ if env is None else env)
        environment[MARK] = os.environ[MARK] + self._token
        super().__init__(command, process_group=0, env=environment, **options)

    def __exit__(self, *error):
        self.end()
        super().__exit__(*error)

    def end(self):
        """Kill it, and whatever it started that still runs."""
        if self.poll() is None:
            self.kill()
            self.wait()
        end_all(self._token)


def run_program(command, *, input=None, timeout=LONGEST_S, check=False, **options):
    """``subprocess.run`` with words for output, and an end: nothing outlives it."""
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    if input is not None:
        piped["stdin"] = subprocess.PIPE
    with Program(command, **{**piped, **options}) as program:
        out, error = program.communicate(input, timeout)
    done = subprocess.CompletedProcess(command, program.returncode, out, error)
    if check:
        assert done.returncode == 0, f"{command}: {out}{error}"
    return done


def end_all(token):
    """SIGKILL to every process whose mark has ``token``, until there is none in two looks.

    One that begins another program at that very moment shows no environment. One that hangs in the
    kernel (a dead mount) is left behind after 10 s.
    """
    deadline, looks = time.monotonic() + 10.0, 0
    while looks < 2 and time.monotonic() < deadline:
        marked = _marked(token)
        looks = 0 if marked else looks + 1
        for pid in marked:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.002)


def _marked(token):
    """What is dead already has no environment."""
    sign, found = f"/{token}".encode(), []
    for path in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            variables = path.read_bytes().split(b"\0")
            if any(sign in one for one in variables if one.startswith(MARK.encode())):
                found.append(int(path.parent.name))
    return found


@functools.cache
def start_guard():
    """Mark this process, and so all that it starts from now on, and keep its guard waiting.

    The guard is nobody's child, has no mark, and is out of reach of signals to our group.
    """
    inner, outer = os.pipe()
    token = f"{os.getpid()}/"
    environment = {name: value for name, value in os.environ.items() if name != MARK}
    subprocess.run([sys.executable, "-IS", __file__, token], stdin=inner, start_new_session=True,
                   check=True, env=environment)  # fmt: skip
    os.close(inner)
    os.environ[MARK] = os.environ.get(MARK, "/") + token
    return outer


def main():
    """The guard: at the end of its input everything ends that its starter has started."""
    if os.fork():
        return
    nowhere = os.open(os.devnull, os.O_RDWR)
    os.dup2(nowhere, 1)  # a pipe of ours, which somebody may wait for
    os.dup2(nowhere, 2)
    os.read(0, 1)
    end_all(sys.argv[1])


def free_port() -> int:
    """One that nobody has, for TCP or UDP: another one each time, and below those that the system
    gives to whoever asks for any, for it would give this one away before it is used."""
    for _ in PORTS:
        port = next(_PORTS)
        with contextlib.suppress(OSError), contextlib.ExitStack() as probes:
            for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
                probe = probes.enter_context(socket.socket(socket.AF_INET, kind))
                probe.bind(("127.0.0.1", port))
            return port
    raise RuntimeError(f"no port from {PORTS.start} to {PORTS.stop - 1} is free")


def on_free_ports(*keys):
    """The words that give each of these configuration keys a free port."""
    return [word for key in keys for word in ("--set", f"{key}={free_port()}")]


if __name__ == "__main__":
    main()
