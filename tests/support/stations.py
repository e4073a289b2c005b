"""A real station with its control API in a thread, and a conversation with it in the caller's."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

from groundstation.service.config import Config, ControlSocket
from groundstation.service.control import ControlServer
from groundstation.service.station import Station

T = TypeVar("T")


def serve(config: Config, path: Path, conversation: Callable[[Station], T]) -> T:
    """What ``conversation`` gives, beside the loop of a station that serves at ``path``."""
    serving: Future[tuple[Station, asyncio.AbstractEventLoop]] = Future()

    async def session() -> None:
        station = Station(config)
        control = ControlSocket(path)
        server = ControlServer(station, control)
        await server.start()
        running = asyncio.create_task(station.run())
        try:
            await station.receiver.tried.wait()
            serving.set_result((station, asyncio.get_running_loop()))
            await running
        finally:
            station.stop()
            await running
            await server.stop()
            control.close()

    with ThreadPoolExecutor(1) as beside:
        served = beside.submit(asyncio.run, session())
        served.add_done_callback(
            lambda one: serving.done() or serving.set_exception(one.exception())
        )
        station, loop = serving.result()
        try:
            return conversation(station)
        finally:
            loop.call_soon_threadsafe(station.stop)
            served.result()


def only_recording(config: Config) -> Any:
    """The only recording that was made."""
    from groundstation.recording.formats import open_recording

    (path,) = Path(config.recording.folder).glob("*.mcap")
    return open_recording(path)
