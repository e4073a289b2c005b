"""What the program prints: every line of it passes through here, and commands no terminal."""

from __future__ import annotations

import json
import os
import sys
from typing import Any

import typer

from groundstation import BadInputError
from groundstation.cli.progress import own_terminal, spoken
from groundstation.text import printable

_CLEAR = "\r\033[K"


def show(text: str = "", *, error: bool = False) -> None:
    """Print one line of a command's answer. Raises OSError where that is not possible."""
    spoken()
    print(printable(text), file=sys.stderr if error else sys.stdout, flush=True)


def show_json(value: Any, indent: int | None = 2) -> None:
    """Print an answer for programs, in ASCII."""
    spoken()
    print(json.dumps(value, indent=indent, default=str), flush=True)


def say(text: str, *, end: str = "\n", error: bool = False, clear: bool = False) -> None:
    """Print a line of the daemon at once to stdout, or stderr for ``error``: nothing that happens
    to the terminal may stop a recording.

    Where the reader has gone away (``| tee log`` ends first on Ctrl-C) or the log's disk is
    full, this and all that follows is thrown away. clear: over the line that is there.
    """
    spoken()
    stream = sys.stderr if error else sys.stdout
    try:
        print(_CLEAR * clear + printable(text), end=end, file=stream, flush=True)
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def require_yes(question: str, otherwise: str) -> None:
    """Ask the human. Raises BadInputError, saying ``otherwise``, for a no."""
    own_terminal()
    if not typer.confirm(question):
        raise BadInputError(otherwise)
