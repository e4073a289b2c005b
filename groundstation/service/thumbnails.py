"""Pictures of recordings for lists of them, drawn when they are first asked for and kept."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from groundstation.errors import BadInputError, GroundStationError
from groundstation.service.commands import run_command

FOLDER = "thumbnails"
"""In the recordings folder."""
_MOST = 1 << 18


class Thumbnails:
    """Of the recordings in a folder, one drawn at a time, in a process of its own."""

    def __init__(self, folder: Callable[[], Path]) -> None:
        self._folder = folder
        self._drawing = asyncio.Lock()

    async def of(self, name: str) -> str:
        """The SVG of a recording. Raises BadInputError for what is not in the folder,
        GroundStationError where it cannot be drawn."""
        folder = self._folder().absolute()
        recording, picture = folder / name, folder / FOLDER / f"{name}.svg"
        if Path(name).name != name or name.startswith("."):
            raise BadInputError(f"{name}: no such recording in {folder}")
        async with self._drawing:
            if not await asyncio.to_thread(_is_fresh, picture, recording):
                await self._draw(recording, picture)
            return await asyncio.to_thread(_read, picture)

    async def _draw(self, recording: Path, picture: Path) -> None:
        await asyncio.to_thread(_make_room, recording, picture)
        _, _, said = await run_command("inspect", str(recording), "--thumbnail", str(picture))
        if not await asyncio.to_thread(picture.is_file):  # a damaged one is drawn as far as it goes
            raise GroundStationError(said or f"{recording}: no picture was drawn")


def _is_fresh(picture: Path, recording: Path) -> bool:
    try:
        return picture.stat().st_mtime_ns >= recording.stat().st_mtime_ns
    except (OSError, ValueError):  # no such name can be
        return False


def _make_room(recording: Path, picture: Path) -> None:
    if not recording.is_file():
        raise BadInputError(f"{recording.name}: no such recording in {recording.parent}")
    try:
        picture.parent.mkdir(exist_ok=True)
        picture.unlink(missing_ok=True)
        for other in picture.parent.glob("*.svg"):
            if not (recording.parent / other.stem).exists():
                other.unlink(missing_ok=True)  # its recording was deleted
    except OSError as error:
        raise GroundStationError(f"{picture}: {error.strerror}") from error


def _read(picture: Path) -> str:
    try:
        with picture.open() as file:
            return file.read(_MOST)
    except (OSError, ValueError) as error:
        raise GroundStationError(f"{picture}: {error}") from error
