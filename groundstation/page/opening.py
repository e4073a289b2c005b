"""Files that the operator opens: of the recordings folder, dropped on the page, or an example.

What is dropped becomes a recording of the folder; nothing is overwritten.
"""

from __future__ import annotations

import asyncio
import contextlib
import shutil
from collections.abc import AsyncIterator
from pathlib import Path

from groundstation.errors import BadInputError, GroundStationError
from groundstation.service.commands import own_program, run_command, run_program
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


async def add(folder: Path, name: str, content: AsyncIterator[bytes]) -> str:
    """A file becomes a recording of the folder: an MCAP as it is, anything else converted to one.
    The name it has there. Raises GroundStationError where it is no recording."""
    name = _plain(name)
    waiting = folder / "opened"
    waiting.mkdir(parents=True, exist_ok=True)
    source = _free(waiting, name)
    try:
        await _save(source, content)
        return await _taken(folder, source, name)
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
    return await _taken(folder, EXAMPLES / name, name)


async def _taken(folder: Path, source: Path, name: str) -> str:
    target = _free(folder, f"{Path(name).stem}.mcap")
    if name.endswith(".mcap"):
        await channels(source)  # whether it is a recording at all
        await asyncio.to_thread(shutil.copyfile, source, target)
    else:
        status, _, said = await run_command(
            "convert", str(source), str(target), patience_s=PATIENCE_S
        )
        if status:
            line = (said.splitlines() or [f"{name}: could not be read"])[-1]
            raise BadInputError(line.replace(f"{source}", name).removeprefix("groundstation: "))
    return target.name


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
