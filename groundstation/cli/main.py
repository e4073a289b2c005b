"""The ``groundstation`` command: what its end looks like, however it comes."""

from __future__ import annotations

import os
import signal
import sys
import time
import warnings
from types import FrameType
from typing import NoReturn

from groundstation import GroundStationError
from groundstation.allocator import keep_freed
from groundstation.text import printable

begun_ns = time.time_ns()
"""When a person began this command, Unix ns: nothing much was imported before."""


def main() -> NoReturn:
    """Run the command line; what went wrong becomes one line and exit status 1.

    SIGTERM ends it as Ctrl-C does: a script's background job ignores SIGINT.
    """
    global begun_ns
    begun_ns = time.time_ns()
    status, interrupted = 1, 128 + signal.SIGINT

    def terminate(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = 128 + number
        raise KeyboardInterrupt(signal.Signals(number).name)

    signal.signal(signal.SIGTERM, terminate)
    warnings.showwarning = lambda message, *_, **__: _complain(str(message))
    try:
        _hold_streams()
        # Matrices here are small: BLAS's threads only wait for each other. For two searches side by
        # side on two cores that took seven times the processor time.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        keep_freed()
        # here, for importing takes long enough to be interrupted
        from groundstation.cli.app import app

        app()
    except GroundStationError as error:
        _complain(str(error))
    except KeyboardInterrupt:
        status = interrupted
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
        if status == 128 + signal.SIGINT:  # typer knows Ctrl-C only
            status = interrupted
    except BrokenPipeError:
        pass
    except OSError as error:
        _complain(f"{error.filename or 'output'}: {error.strerror or error}")
    _leave(status)


_INTERRUPTIONS = {128 + signal.SIGINT: "interrupted", 128 + signal.SIGTERM: "terminated"}


def _leave(status: int) -> NoReturn:
    if status in _INTERRUPTIONS:
        _complain(_INTERRUPTIONS[status])
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError as error:
            _discard(stream.fileno())
            if status == 0:  # /dev/full tells at the end
                status = 1
                _complain(f"output: {error.strerror}")
    # not imported here: an import that was interrupted halfway cannot always be begun again
    background = sys.modules.get("groundstation.background")
    if background is not None and background.left_behind():
        os._exit(status)
    sys.exit(status)


def _complain(text: str) -> None:
    try:
        print(f"groundstation: {printable(text)}", file=sys.stderr, flush=True)
    except OSError:
        _discard(2)


def _hold_streams() -> None:
    """A closed standard stream (``>&-``) would give its number to the next file opened."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            mode = "w" if number else "r"
            setattr(sys, name, open(_discard(number), mode, encoding="utf-8"))  # noqa: SIM115 - it stays open
    # a file name need not be UTF-8
    sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]  # a text file


def _discard(number: int) -> int:
    """Let a file descriptor lead nowhere; its number."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    if nowhere != number:
        os.dup2(nowhere, number)
        os.close(nowhere)
    return number
