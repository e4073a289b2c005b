"""What all commands share: what they print, how they wait, options that are no more."""

from __future__ import annotations

import itertools
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from groundstation import BadInputError
from groundstation.compiling import compiles
from groundstation.paths import write_whole
from groundstation.text import printable

# What a command waits for: after a second of silence a word and a bar on a terminal's standard
# error; nothing where that is none. Every command is watched, and what is printed ends the silence.


SILENT_S = 1.0
TURN_S = 0.15
WIDTH = 24
TOLD = "GROUNDSTATION_PROGRESS"
"""Variable that names the file in which a program that waits for this one finds the same."""
CLEAR = "\r\033[K"


class Waiting:
    """The line that is drawn, by a thread of its own.

    share: done, 0 to 1; None where nobody knows. what: is being done.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._drawn = False
        self._spoken_s = time.monotonic()
        self.share: float | None = None
        self.what = "working"
        self._thread = threading.Thread(target=self._draw, name="waiting", daemon=True)

    def begin(self) -> None:
        self._thread.start()

    def interrupt(self) -> None:
        """Something is to be printed now: the line goes, and the silence begins anew."""
        with self._lock:
            self._clear()
            self._spoken_s = time.monotonic()

    def end(self) -> None:
        """Nothing is drawn any more. Safe to call twice."""
        with self._lock:
            self._ended.set()
            self._clear()

    def _draw(self) -> None:
        for turn in itertools.count():
            if self._ended.wait(TURN_S):
                return
            with self._lock:
                silent_s = time.monotonic() - self._spoken_s
                if silent_s >= SILENT_S and not self._ended.is_set():
                    self._drawn = True
                    _write(f"{CLEAR}{line(turn, self.share, self.what, silent_s)}")

    def _clear(self) -> None:
        if self._drawn:
            self._drawn = False
            _write(CLEAR)


def line(turn: int, share: float | None, what: str, seconds: float) -> str:
    """One line: a bar (to and fro where no share is known), what is being done, for how long."""
    if compiles():
        share, what = None, f"{what}; first time here: compiling, once per machine"
    if share is None:
        at = abs(turn % (2 * WIDTH - 6) - (WIDTH - 3))
        bar = " " * at + "=" * 3 + " " * (WIDTH - 3 - at)
    else:
        bar = ("=" * round(WIDTH * min(max(share, 0.0), 1.0))).ljust(WIDTH)
    return f"[{bar}] {printable(what)}, {seconds:.0f} s"


_watched: list[Waiting] = []
"""The command that runs; of one that is called by another, both."""


@contextmanager
def watched() -> Iterator[None]:
    """The block is a command: where it is silent for a second, that it works is shown."""
    if not sys.stderr.isatty():
        yield
        return
    waiting = Waiting()
    _watched.append(waiting)
    waiting.begin()
    try:
        yield
    finally:
        waiting.end()
        _watched.remove(waiting)


def spoken() -> None:
    """Call before anything is printed."""
    for waiting in _watched:
        waiting.interrupt()


def own_terminal() -> None:
    """The command that runs draws, or asks, by itself: nothing more is shown of its silence."""
    for waiting in _watched:
        waiting.end()


@contextmanager
def shown(first: str) -> Iterator[Callable[[float, str], None]]:
    """Within the block, call what is yielded with (share done, what is being done)."""

    def show(share: float, what: str) -> None:
        _tell({"share": share if share >= 0.0 else None, "stage": what})
        for waiting in _watched:
            if share >= 0.0:  # less: no further than before
                waiting.share = share
            waiting.what = what

    show(-1.0, first)
    yield show


def tell_found(text: str) -> None:
    """What the command has found, in a line, for a program that waits for it."""
    _tell({"found": text})


def _tell(what: dict[str, Any]) -> None:
    path = os.environ.get(TOLD)
    if path:
        with suppress(OSError):  # nobody waits any more
            write_whole(Path(path), json.dumps(what))


def _write(text: str) -> None:
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except (OSError, ValueError):  # the terminal is gone
        pass


# What the program prints: every line of it passes through here, and commands no terminal.


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
        print(CLEAR * clear + printable(text), end=end, file=stream, flush=True)
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def require_yes(question: str, otherwise: str) -> None:
    """Ask the human. Raises BadInputError, saying ``otherwise``, for a no."""
    own_terminal()
    if not typer.confirm(question):
        raise BadInputError(otherwise)


# Groups of commands whose options mean what was typed.


FORMER = {
    "attitude --tune": "give Q and R by --noise; only their ratios matter",
    "config --reload": "a change takes effect with the next start of the daemon",
    "config --show": "'groundstation config' shows it",
    "export": "the header is groundstation/telemetry/groundstation_telemetry.h, also in a wheel",
    **dict.fromkeys(
        (
            f"bench motor {one}"
            for one in ("-o", "--output", "--html", "--with", "--motor", "--mass", "--vehicle")
        ),
        "'groundstation fit motor' fits the recording that is made",
    ),
    **dict.fromkeys(
        (f"fit {what} --rerun" for what in ("motor", "body", "arx")),
        "--html draws the same series",
    ),
    "inspect --thumbnail": "the page opens a recording with all its plots",
    "jobs": "jobs are begun and watched on the page ('groundstation page') and by the control API"
    " (POST /jobs/start, GET /jobs)",
    "models": "models are on the page ('groundstation page') and in the control API (GET /models);"
    " 'groundstation link stand-in:ID' flies one, POST /models/watch watches with one",
    "pid design --attitude": "the firmware's loops fly a model's body, --loop direct its"
    " polynomials",
    "pid design --rounding": "--sensitivity keeps margins, by more than printed digits leave open",
    "pid evaluate --attitude": "the firmware's loops fly a model's body, --loop direct and"
    " whole its polynomials",
    "recordings": "'groundstation inspect FOLDER' lists a folder of recordings",
    "pid evaluate --thesis": "'groundstation thesis' has the printed tables",
    "run --page-port": "give --set page.port=PORT",
    "run --viewer-port": "give --set viewer.port=PORT",
    "run --web-port": "give --set viewer.web_port=PORT",
    **dict.fromkeys(
        (
            f"{what} {one}"
            for what in ("compare", "discrepancy")
            for one in ("--stretch", "--marked")
        ),
        "the report shows the seconds in which the model is most wrong ('A closer look'); 'inspect'"
        " lists what the live model check marked",
    ),
    "simulate --html": "'groundstation compare --html' draws where a model and a flight disagree;"
    " in Python, simulate_run(...).plot() draws a replayed flight",
}
"""Commands and options of earlier versions, and what does their work now."""


class Commands(typer.Typer):
    """A group of commands; an option that holds one value may be given once."""

    def command(self, *names: Any, **more: Any) -> Any:
        """As typer's; of an option given twice, typer's own commands take the last in silence."""
        return super().command(*names, **{"cls": _Command, **more})


class _Command(TyperCommand):
    def invoke(self, ctx: Any) -> Any:
        with watched():
            return super().invoke(ctx)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        for word in args:
            option = word.partition("=")[0]
            _require_current(ctx, f"{ctx.command_path.partition(' ')[2]} {option}")
        _, _, given = self.make_parser(ctx).parse_args(args=list(args))
        for one in given:
            single = one.nargs == 1 and not getattr(one, "multiple", False)
            times = given.count(one)
            if single and not getattr(one, "is_flag", False) and times > 1:
                listed = "commas" in (getattr(one, "help", None) or "") or "," in str(one.metavar)
                several = ", several separated by commas" if listed else ""
                raise BadInputError(f"{one.opts[0]}: given {times} times; give it once{several}")
        return super().parse_args(ctx, args)


class Root(TyperGroup):
    """Of all commands: knows those that there were."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        _require_current(ctx, args[0])
        return super().resolve_command(ctx, args)


def _require_current(ctx: Any, words: str) -> None:
    """Raise a usage error for what there is no more."""
    if words in FORMER:
        raise typer.BadParameter(f"there is no '{words}' any more: {FORMER[words]}", ctx)
