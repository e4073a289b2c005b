"""Commands as a newcomer would type them: shown, run, logged, and kept to be repeated by hand."""

from __future__ import annotations

import contextlib
import errno
import os
import resource
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from groundstation.documents import open_regular
from groundstation.errors import BadInputError, GroundStationError
from groundstation.paths import write_whole

LOG, SCRIPT = "log.txt", "commands.sh"
PROGRAMS = {
    "groundstation": (str(Path(sys.executable).with_name("groundstation")),),
    "python": (sys.executable,),
}
LAST_WORDS_MOST = 1 << 16
"""Bytes of a command's output in which its last line is looked for."""
END_S = 40.0
"""A program that was asked to end is given so long; a daemon finishes its recording."""
_SCRIPT_HEAD = """#!/bin/sh
# What '{by}' ran, to be repeated by hand: sh {script} NEW_FOLDER
set -e
here=$(dirname "$(realpath "$0")")
mkdir "${{1:?give a new folder}}"
cd "$1"
cp {inputs} .
export PATH={path}:"$PATH"
"""


@dataclass(frozen=True, slots=True)
class Spent:
    """wall_s, processor_s: since the shell was opened, its commands' processor time."""

    wall_s: float
    processor_s: float


class Shell:
    """Runs commands in a folder that becomes theirs. A context: nothing is left running.

    folder: must not exist or be empty, or be one that a shell goes on in, with ``goes_on``.
    inputs: name -> text of the files to begin with, or None for those that come later and are
    copied all the same. say: is given every command as it starts. by: whose commands they are, for
    the script.

    The script is written anew, so that it holds nothing that came with somebody else's folder. Who
    goes on says with ``keep`` what was run before.

    Programs run in process groups of their own: Ctrl-C is told them once, by us, and in order.
    """

    def __init__(
        self,
        folder: Path,
        inputs: Mapping[str, str | None],
        say: Callable[[str], None] = print,
        by: str = "groundstation thesis",
        goes_on: bool = False,
    ) -> None:
        begun = goes_on and (folder / SCRIPT).is_file()
        if not begun and folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise BadInputError(
                f"{folder}: exists already and is not an empty folder; name another one with -o"
            )
        self.folder = folder.absolute()
        self._say = say
        self._script = _head(inputs, by) if inputs else ""
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name, text in inputs.items():
                if text is not None and not begun:
                    write_whole(folder / name, text)
            write_whole(folder / SCRIPT, self._script)
            append = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW
            self._log = open(open_regular(folder / LOG, append), "ab")  # noqa: SIM115 - it stays
        except OSError as error:
            link = error.errno == errno.ELOOP
            why = f"{LOG} is a link to another file; remove it" if link else error.strerror
            raise BadInputError(f"{folder}: cannot be written: {why}") from error
        own = {k: v for k, v in os.environ.items() if not k.startswith("GROUNDSTATION_")}
        self._environment = {**own, "NO_COLOR": "1"}
        self._began_s = time.monotonic()
        self._began_processor_s = _children_s()

    def __enter__(self) -> Shell:
        return self

    def __exit__(self, *error: object) -> None:
        self._log.close()

    @property
    def spent(self) -> Spent:
        """What all has cost so far."""
        return Spent(time.monotonic() - self._began_s, _children_s() - self._began_processor_s)

    def run(self, *words: str, into: str | None = None) -> None:
        """Run one command to its end. Words may hold ``*``, as for a shell.

        into: file that takes what it prints, else the log does. Raises GroundStationError with
        what the command said last where it fails.
        """
        line = _shown(words) + (f" > {into}" if into else "")
        mark, before_s = self._tell(line), _children_s()
        with contextlib.ExitStack() as closing:
            out: IO[bytes] = self._log
            if into is not None:
                out = closing.enter_context((self.folder / into).open("xb"))
            with _Interruptions() as interruptions:
                process = self._start(words, out)
                try:
                    interruptions.let_in()
                    status = process.wait()
                finally:
                    _end(process)
        if status:
            self._note(f"# failed: {line}")
            if into is not None:
                (self.folder / into).unlink()  # what it said of itself; no recording
            raise GroundStationError(
                f"'{_shown(words)}' failed ({status}): {self._last_words(mark)};"
                f" all that was said is in {self.folder / LOG}"
            )
        self._log.write(f"# {_children_s() - before_s:.1f} s of processor time\n".encode())
        self._log.flush()
        self._note(line)

    def keep(self, *words: str) -> None:
        """Put a command into the script that was run before, and is not run again."""
        self._note(_shown(words))

    def files(self, pattern: str) -> list[Path]:
        """The folder's files that a pattern names, in order."""
        return sorted(self.folder.glob(pattern))

    def _start(self, words: tuple[str, ...], out: IO[bytes]) -> subprocess.Popen[bytes]:
        program, *arguments = words
        expanded = [name for word in arguments for name in self._expanded(word)]
        self._log.flush()
        try:
            return subprocess.Popen(
                [*PROGRAMS[program], *expanded],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=self._log,
                cwd=self.folder,
                env=self._environment,
                start_new_session=True,
            )
        except OSError as error:
            raise GroundStationError(f"{PROGRAMS[program][0]}: {error.strerror}") from error

    def _expanded(self, word: str) -> list[str]:
        if "*" not in word:
            return [word]
        found = [str(path.relative_to(self.folder)) for path in self.files(word)]
        if not found:
            raise GroundStationError(f"{self.folder / word}: no such file")
        return found

    def _tell(self, line: str) -> int:
        """Show and log a command; where in the log its own words begin."""
        self._say(f"$ {line}")
        self._log.write(f"\n$ {line}\n".encode())
        self._log.flush()
        return self._log.tell()

    def _note(self, line: str) -> None:
        self._script += f"{line}\n"
        write_whole(self.folder / SCRIPT, self._script)

    def _last_words(self, mark: int) -> str:
        with (self.folder / LOG).open("rb") as log:
            log.seek(max(mark, log.seek(0, os.SEEK_END) - LAST_WORDS_MOST))
            text = log.read().decode(errors="replace")
        lines = [line for line in text.splitlines() if line.strip()]
        return lines[-1].removeprefix("groundstation: ") if lines else "nothing was said"


class _Interruptions:
    """A context that keeps signals waiting until ``let_in``: one that came between a child's
    birth and our knowing of it would leave the child behind. For the main thread, as signals are.
    """

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self._came: list[int] = []

    def __enter__(self) -> _Interruptions:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if callable(before := signal.getsignal(number)):
                self._before[number] = before
                signal.signal(number, lambda came, frame: self._came.append(came))
        return self

    def __exit__(self, *error: object) -> None:
        self.let_in()

    def let_in(self) -> None:
        """Take care of those that came, and of those to come at once."""
        while self._before:
            signal.signal(*self._before.popitem())
        while self._came:
            signal.raise_signal(self._came.pop())


def _head(inputs: Iterable[str], by: str) -> str:
    copied = " ".join(f'"$here"/{name}' for name in inputs)
    path = shlex.quote(str(Path(sys.executable).parent))
    return _SCRIPT_HEAD.format(script=SCRIPT, inputs=copied, path=path, by=by)


def _end(process: subprocess.Popen[bytes]) -> int:
    """Ask a program to end; its status."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(END_S)
        except BaseException as error:  # a second Ctrl-C, too
            process.kill()
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
    return process.wait()


def _shown(words: tuple[str, ...]) -> str:
    return " ".join(word if "*" in word else shlex.quote(word) for word in words)


def _children_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
