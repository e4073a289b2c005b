"""A real station with its control API in this process, and a conversation with it in a thread."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from groundstation.service.config import Config
from groundstation.service.control import ControlServer
from groundstation.service.control_socket import ControlSocket
from groundstation.service.station import Station

T = TypeVar("T")


def serve(config: Config, path: Path, conversation: Callable[[Station], T]) -> T:
    """What ``conversation`` gives, run off the loop of a station that serves at ``path``."""

    async def session() -> T:
        station = Station(config)
        control = ControlSocket(path)
        server = ControlServer(station, control)
        await server.start()
        running = asyncio.create_task(station.run())
        try:
            await station.receiver.tried.wait()
            return await asyncio.to_thread(conversation, station)
        finally:
            station.stop()
            await running
            await server.stop()
            control.close()

    return asyncio.run(session())


def recorded(config: Config) -> Any:
    """The only recording that was made."""
    from groundstation.recording.open_recording import open_recording

    (path,) = Path(config.recording.folder).glob("*.mcap")
    return open_recording(path)
