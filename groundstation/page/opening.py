"""Files that the operator opens: of the recordings folder, dropped on the page, or an example.

What is dropped becomes a recording of the folder; nothing is overwritten. Of a file whose columns
nobody knows the operator is asked what they are (``columns.py``).
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from groundstation.errors import BadInputError, GroundStationError
from groundstation.service.jobs import own_program, run_command, run_program
from groundstation.text import printable

EXAMPLES = Path(__file__).resolve().parents[2] / "recordings"
"""Of a checkout; a wheel has none."""
PATIENCE_S = 300.0
FILE_MOST = 1 << 31
_NOT_EXAMPLES = (".md", ".LICENSE")


def examples() -> list[str]:
    """Names of the recordings that come with the program."""
    found = EXAMPLES.iterdir() if EXAMPLES.is_dir() else ()
    return sorted(one.name for one in found if one.suffix not in _NOT_EXAMPLES)


async def channels(path: Path) -> bytes:
    """A recording's channels (``series.py``). Raises GroundStationError, in a reader's words."""
    words = own_program("-m", "groundstation.page.series", str(path), niceness=1)
    status, out, said = await run_program(words, path.name, PATIENCE_S, bounded=True)
    if status:
        raise GroundStationError(
            said.splitlines()[-1] if said else f"{path.name}: could not be read"
        )
    return out


class UnknownColumnsError(BadInputError):
    """form: with which the operator is asked what the columns of a file are."""

    def __init__(self, why: str, form: dict[str, Any]) -> None:
        super().__init__(why)
        self.form = form


@dataclass(frozen=True, slots=True)
class Opened:
    """file: its name in the folder. map: text of the column map by which it was read, or empty.
    said: what is wrong with it, though it was read."""

    file: str
    map: str = ""
    said: str = ""


async def add(
    folder: Path, name: str, content: AsyncIterator[bytes], answers: str | None = None
) -> Opened:
    """A file becomes a recording of the folder: an MCAP as it is, anything else converted to one.

    answers: JSON of the form with which the operator was asked for its columns.

    Raises GroundStationError where it is no recording, UnknownColumnsError where its columns have
    to be named.
    """
    name = _plain(name)
    waiting = folder / "opened"
    waiting.mkdir(parents=True, exist_ok=True)
    source = _free(waiting, name)
    try:
        await _save(source, content)
        if answers is None:
            return await _taken(folder, source, name)
        return await _mapped(folder, source, name, answers)
    finally:
        source.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            waiting.rmdir()


async def add_example(folder: Path, name: str) -> str:
    """The same with an example. Raises BadInputError for what is none."""
    if name not in examples():
        raise BadInputError(f"{name}: no such example")
    target = folder / f"{Path(name).stem}.mcap"
    if target.is_file():  # it was added before
        return target.name
    folder.mkdir(parents=True, exist_ok=True)
    return (await _taken(folder, EXAMPLES / name, name)).file


async def _taken(folder: Path, source: Path, name: str) -> Opened:
    target = _free(folder, f"{Path(name).stem}.mcap")
    try:
        if name.endswith(".mcap"):
            await channels(source)  # whether it is a recording at all
            await asyncio.to_thread(shutil.copyfile, source, target)
            return Opened(target.name)
        if await _convert(source, target, name):
            return Opened(target.name)
        why = f"{name}: no channel is known"
    except GroundStationError as error:
        why = str(error)
    if (form := await _form(source)) is not None:
        target.unlink(missing_ok=True)
        raise UnknownColumnsError(why, form)
    if not target.is_file():
        raise BadInputError(why)
    return Opened(target.name, said=why)


async def _mapped(folder: Path, source: Path, name: str, answers: str) -> Opened:
    """The same by the columns that the operator has named."""
    target = _free(folder, f"{Path(name).stem}.mcap")
    beside = [source.with_name(f"{source.name}.{end}") for end in ("answers", "map.toml")]
    try:
        beside[0].write_text(answers, "utf-8")
        text = (await _asked(source, str(beside[0]))).decode()
        beside[1].write_text(text, "utf-8")
        await _convert(source, target, name, "--columns", str(beside[1]))
    finally:
        for one in beside:
            one.unlink(missing_ok=True)
    return Opened(target.name, text)


async def _convert(source: Path, target: Path, name: str, *given: str) -> list[str]:
    """The channels that the new file has. Raises BadInputError, in a reader's words."""
    status, out, said = await run_command(
        "convert", str(source), str(target), "--json", *given, patience_s=PATIENCE_S
    )
    if status:
        line = (said.splitlines() or [f"{name}: could not be read"])[-1]
        raise BadInputError(line.replace(f"{source}", name).removeprefix("groundstation: "))
    found: list[str] = json.loads(out)["channels"]
    return found


async def _form(path: Path) -> dict[str, Any] | None:
    """What the operator is asked of a file's columns; None where it has none, or they are known."""
    try:
        form: dict[str, Any] | None = json.loads(await _asked(path))
    except GroundStationError:
        return None
    return form


async def _asked(path: Path, *answers: str) -> bytes:
    """What ``columns.py`` prints. Raises BadInputError, in its words."""
    words = own_program("-m", "groundstation.page.columns", str(path), *answers, niceness=1)
    status, out, said = await run_program(words, path.name, PATIENCE_S, bounded=True)
    if status:
        raise BadInputError(said.splitlines()[-1] if said else f"{path.name}: could not be read")
    return out


async def _save(path: Path, content: AsyncIterator[bytes]) -> None:
    size = 0
    with path.open("xb") as file:
        async for piece in content:
            size += len(piece)
            if size > FILE_MOST:
                raise BadInputError(f"{path.name}: longer than {FILE_MOST >> 30} GB")
            await asyncio.to_thread(file.write, piece)


def _plain(name: str) -> str:
    """A file's name as it can be kept. Raises BadInputError."""
    if not name or Path(name).name != name or name.startswith(".") or printable(name) != name:
        raise BadInputError(f"{printable(name)}: not a file's name")
    return name[-120:]


def _free(folder: Path, name: str) -> Path:
    """A name that nothing has yet."""
    path = folder / name
    number = 1
    while path.exists():
        number += 1
        path = folder / f"{Path(name).stem}_{number}{Path(name).suffix}"
    return path
