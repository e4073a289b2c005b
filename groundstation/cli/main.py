"""The ``groundstation`` command: what its end looks like, however it comes."""

from __future__ import annotations

import os
import sys
from typing import NoReturn

from groundstation.errors import GroundStationError


def main() -> NoReturn:
    """Run the command line; what went wrong becomes one line and exit status 1."""
    status = 1
    try:
        _hold_streams()
        # here, for importing takes long enough to be interrupted
        from groundstation.cli.app import app

        app()
    except GroundStationError as error:
        _complain(str(error))
    except KeyboardInterrupt:
        status = 130
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BrokenPipeError:
        pass
    except OSError as error:
        _complain(f"{error.filename or 'output'}: {error.strerror or error}")
    _leave(status)


def _leave(status: int) -> NoReturn:
    if status == 130:
        _complain("interrupted")
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError as error:
            _discard(stream.fileno())
            if status == 0:  # /dev/full tells at the end
                status = 1
                _complain(f"output: {error.strerror}")
    from groundstation.background import left_behind

    if left_behind():
        os._exit(status)
    sys.exit(status)


def _complain(text: str) -> None:
    try:
        print(f"groundstation: {text}", file=sys.stderr, flush=True)
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
