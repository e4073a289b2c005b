"""One flight of the stand-in, and the samples that each link makes of it."""

import asyncio
import time

import numpy as np
from link_contract import joined, packets_read, read_to_end

from firmware_sim.craft import StandIn
from firmware_sim.settings import Loss, StandInSettings
from groundstation.links.replay import FAST, ReplayLink
from groundstation.links.serial import SerialLink
from groundstation.links.stand_in import StandInLink
from groundstation.recording.recording_file import write_mcap
from groundstation.recording.session import Recording
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import COLUMNS, RawBatch

BRIDGES = {"copies": False, "no copies": True}
"""What the bridge does with copies: whether it removes them."""
SEED, LOSS, SPAN_S = 5, 0.3, 2.0


class OneFlight:
    """What a bridge forwards of it: ``packets`` (n, 32) and ``arrival_s`` (n,)."""

    def __init__(self, deduplicated):
        settings = StandInSettings(seed=SEED, bridge_dedup=deduplicated, loss=Loss(good_loss=LOSS))
        self._options = {"seed": SEED, "bridge_dedup": deduplicated, "loss": {"good_loss": LOSS}}
        self.packets, self.arrival_s = StandIn(settings).advance(SPAN_S)

    def through_stand_in(self):
        """Its packets with their stamps, as the stand-in link delivers them."""

        async def fly():
            async with StandInLink(self._options) as link:
                return await packets_read(link, len(self.packets))

        flown, rows = asyncio.run(fly()), slice(len(self.packets))
        return RawBatch(flown.packets[rows], flown.host_time_ns[rows])

    def through_replay(self, flown, path):
        """Samples of a recording of ``flown``, made at ``path`` and replayed."""
        write_mcap(Recording(path.parent, "mcap", decode_all(flown)[0], flown), path)

        async def replay():
            async with ReplayLink(path, speed=FAST) as link:
                return joined(await read_to_end(link)), link.start_ticks

        raw, start_ticks = asyncio.run(replay())
        return decode_all(raw, start_ticks)[0]

    def through_serial(self, line):
        """Samples of the flight sent down a pseudo-terminal in real time."""

        async def send(started_s):
            ends = np.flatnonzero(np.diff(self.arrival_s) > 0) + 1
            for batch in np.split(np.arange(len(self.packets)), ends):
                due_s = started_s + self.arrival_s[batch[0]]
                await asyncio.sleep(max(0.0, due_s - time.monotonic()))
                line.send(self.packets[batch])

        async def fly():
            async with SerialLink(line.path) as link:
                sending = asyncio.create_task(send(time.monotonic()))
                raw = await packets_read(link, len(self.packets))
                await sending
                return raw

        return decode_all(asyncio.run(fly()))[0]


def require_equal(ours, expected, link):
    """Every column but the host's stamps, which are each link's own."""
    for name in COLUMNS:
        if name != "host_time_ns":
            np.testing.assert_array_equal(
                getattr(ours, name), getattr(expected, name), f"{name} through {link}"
            )
