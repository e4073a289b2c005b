"""The daemon between two crafts, over cflib and UDP."""

import asyncio

from groundstation.links.command import CommandState
from groundstation.service import control
from groundstation.service.config import Config, LinkConfig, RecordingConfig
from groundstation.service.lease import STOPPED
from groundstation.service.station import Station
from support.crafts import served
from support.waiting import eventually


def test_the_commands_follow_the_telemetry_to_another_craft(tmp_path):
    """One connection carries both; a craft that is heard and commanded elsewhere is named."""

    async def session(one, other):
        station = Station(
            Config(
                link=LinkConfig(name=one.uri),
                recording=RecordingConfig(folder=str(tmp_path), enabled=False),
            )
        )
        commander = station.commander
        running = asyncio.create_task(station.run())
        try:
            await eventually(lambda: commander.link.state is CommandState.CONNECTED, "connected")
            await station.switch_link(other.uri)
            assert commander.link.uri == other.uri
            await eventually(
                lambda: commander.link.state is CommandState.CONNECTED, "connected again"
            )
            assert await commander.operator.stop() == STOPPED
            assert control.status_of(station)["command"]["out_of_reach"] == ""
            await station.craft.connect_command(one.uri)
            (reason,) = [text for text in control.problems(station) if "stopped from here" in text]
            assert other.uri in reason
            assert one.uri in reason
        finally:
            station.stop()
            await running

    settings = {"craft": "crazyflie21", "plant": "reduced"}
    with served(**settings) as one, served(**settings) as other:
        asyncio.run(session(one, other))
