"""One flight of the stand-in, the samples each link makes of it, and what is found from them."""

import asyncio
import json
import time

import numpy as np
from typer.testing import CliRunner

from firmware_sim.craft import StandIn
from firmware_sim.settings import Loss, StandInSettings
from groundstation.cli.app import app
from groundstation.control.design import Limits, design_direct
from groundstation.control.linear_loop import axis_plant
from groundstation.dynamics.model import load_model
from groundstation.links.replay import FAST, ReplayLink
from groundstation.links.serial import SerialLink
from groundstation.links.stand_in import StandInLink
from groundstation.recording.mcap_file import write_mcap
from groundstation.recording.session import Recording
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import COLUMNS, RawBatch
from support.links import joined, packets_read, read_to_end

BRIDGES = {"copies": False, "no copies": True}
"""What the bridge does with copies: whether it removes them."""
SEED, LOSS, SPAN_S = 5, 0.3, 2.0
PROVENANCE = ("sha256",)
"""What a result says of the file it was made from, beyond the file's name."""


class OneFlight:
    """What a bridge forwards of it: ``packets`` (n, 32) and ``arrival_s`` (n,)."""

    def __init__(self, deduplicated, *, span_s=SPAN_S, loss=LOSS, seed=SEED, **craft):
        self._options = {"seed": seed, "bridge_dedup": deduplicated, **craft}
        settings = StandInSettings(**self._options, loss=Loss(good_loss=loss))
        self._options["loss"] = {"good_loss": loss}
        self.packets, self.arrival_s = StandIn(settings).advance(span_s)

    def through_stand_in(self, speed=1.0):
        """Its packets with their stamps, as the stand-in link delivers them."""

        async def fly():
            async with StandInLink(self._options, speed=speed) as link:
                return await packets_read(link, len(self.packets))

        flown, rows = asyncio.run(fly()), slice(len(self.packets))
        return RawBatch(flown.packets[rows], flown.host_time_ns[rows])

    def through_replay(self, flown, path):
        """Samples of a recording of ``flown``, made at ``path`` and replayed."""
        return decode_all(*self.replayed(flown, path))[0]

    def replayed(self, flown, path):
        """The packets of that recording replayed, and the tick from which they count."""
        record(flown, path)

        async def replay():
            async with ReplayLink(path, speed=FAST) as link:
                return joined(await read_to_end(link)), link.start_ticks

        return asyncio.run(replay())

    def through_serial(self, line):
        """Samples of the flight sent down a pseudo-terminal in real time."""
        return decode_all(asyncio.run(self.sent_down(line)))[0]

    async def sent_down(self, line):
        """Its packets as they come out of the pseudo-terminal."""

        async def send(started_s):
            # a few together: one by one takes half a core
            ends = np.flatnonzero(np.diff(self.arrival_s // 0.004) > 0) + 1
            for batch in np.split(np.arange(len(self.packets)), ends):
                due_s = started_s + self.arrival_s[batch[-1]]
                await asyncio.sleep(max(0.0, due_s - time.monotonic()))
                line.send(self.packets[batch])
            while True:  # what did not fit goes when there is room
                await asyncio.sleep(0.01)
                line.send(self.packets[:0])

        async with SerialLink(line.path) as link:
            sending = asyncio.create_task(send(time.monotonic()))
            try:
                return await packets_read(link, len(self.packets))
            finally:
                sending.cancel()


def flight_and_bench():
    """name -> a flight with a slow gyro hidden in the craft and a run of the motor bench.

    Radio loss leaves a gap or two in each. The bridge of the bench removes copies.
    """
    made = {"seed": 3, "plant": "reduced", "loss": 0.15, "span_s": 16.0}
    hidden = {"gyro_low_pass": {"bandwidth_hz": 60.0}}
    return {
        "flight": OneFlight(False, effects=hidden, **made),
        "bench": OneFlight(True, program="motor_bench", **made),
    }


def record(raw, path, start_ticks=None):
    """Write what a link delivered to a new recording, decoded as the daemon does."""
    samples, _ = decode_all(raw, start_ticks)
    write_mcap(Recording(path.parent, "mcap", samples, raw), path)


def results(folder):
    """What identification, PID and search say of ``flight.mcap`` and ``bench.mcap``, by name."""

    def path(name):
        return folder / f"{name}.json"

    flight, model = folder / "flight.mcap", ("--model", path("body"))
    run("fit", "motor", folder / "bench.mcap", "-o", path("motor"))
    run("fit", "body", flight, "-o", path("body"), "--model", path("motor"))
    texts = {
        "motor": path("motor").read_text(),
        "body": path("body").read_text(),
        "evaluate": run("pid", "evaluate", *model, "--json"),
        "design": design(path("body")),
    }
    run("discrepancy", flight, *model, "--json", path("discrepancy"))
    texts["discrepancy"] = path("discrepancy").read_text()
    return {name: without_provenance(json.loads(text), folder) for name, text in texts.items()}


def design(model):
    """Gains and margins of a PID on u', which no motor follows, so that no command gives it."""
    gains, _, margins = design_direct(axis_plant(load_model(model), "yaw"), Limits())
    return json.dumps({"gains": gains.as_tuple(), "margins": margins.as_dict()})


def run(*arguments):
    """The command's output."""
    done = CliRunner().invoke(app, [str(one) for one in arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def without_provenance(said, folder):
    """A result without the hash of its recording and the folder it was made in."""
    if isinstance(said, dict):
        items = said.items()
        return {key: without_provenance(v, folder) for key, v in items if key not in PROVENANCE}
    if isinstance(said, list):
        return [without_provenance(value, folder) for value in said]
    return said.replace(f"{folder}/", "") if isinstance(said, str) else said


def require_same_on_this_machine(flight, line, path):
    """The samples of a flight, the same through stand-in, a replay of ``path`` and ``line``."""
    flown = flight.through_stand_in()
    samples, counts = decode_all(flown)
    assert counts.lost > 0
    assert len(samples) > 900
    require_equal(flight.through_replay(flown, path), samples, "replay")
    require_equal(flight.through_serial(line), samples, "serial")
    return samples


def require_equal(ours, expected, link):
    """Every column but the host's stamps, which are each link's own."""
    for name in COLUMNS:
        if name != "host_time_ns":
            np.testing.assert_array_equal(
                getattr(ours, name), getattr(expected, name), f"{name} through {link}"
            )
