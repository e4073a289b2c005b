"""What the daemon prints: nothing that happens to the terminal may stop a recording."""

from __future__ import annotations

import os
import sys


def say(text: str, *, end: str = "\n", error: bool = False) -> None:
    """Print at once to stdout, or stderr for ``error``.

    Where the reader has gone away (``| tee log`` ends first on Ctrl-C) or the log's disk is
    full, this and all that follows is thrown away.
    """
    stream = sys.stderr if error else sys.stdout
    try:
        print(text, end=end, file=stream, flush=True)
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


class Log:
    """Where structlog's lines go: stderr."""

    def msg(self, text: str) -> None:
        say(text, error=True)

    info = warning = msg
