"""What the pages' examples work on: short flights of the stand-in, and models fitted to them."""

import shutil
from pathlib import Path

import msgspec
import numpy as np
from pages import ROOT, blocks_of

from firmware_sim.craft import StandIn
from firmware_sim.settings import StandInSettings
from groundstation.dynamics.model import save_model, vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.identification.body.workflow import identify_body
from groundstation.identification.motor.workflow import identify_motor
from groundstation.identification.runs import runs_of
from groundstation.recording.open_recording import open_recording
from groundstation.recording.recording_file import session_metadata, write_mcap
from groundstation.recording.session import Recording
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch

HIDDEN = {"effects": {"velocity_moment": {"moment": 10.0}}}
FLOWN = {
    "clean.mcap": (30.0, {"plant": "reduced", "seed": 1}),
    "flight.mcap": (20.0, {"plant": "reduced", "seed": 5, **HIDDEN}),
    "flight1.mcap": (20.0, {"plant": "reduced", "seed": 3, **HIDDEN}),
    "flight2.mcap": (20.0, {"plant": "reduced", "seed": 4, **HIDDEN}),
    "flight3.mcap": (20.0, {"plant": "reduced", "seed": 5, **HIDDEN}),
    "bench.mcap": (30.0, {"program": "motor_bench"}),
    "motor_bench.mcap": (20.0, {"plant": "reduced", "program": "motor_bench"}),
}
TAKEN = {"gains.toml": ROOT / "tests" / "control" / "data" / "gains.toml"}


class Larder:
    """Files by the names that the pages use, each made when it is first asked for."""

    def __init__(self, folder):
        self._folder = folder

    def give(self, name, folder):
        """Put a file of this name into ``folder``; False where none is known."""
        target = folder / name
        if target.exists():
            return True
        if name == "sessions":
            return self.give("sessions/torn.mcap", folder)
        source = self._source(name)
        if source is None:
            return False
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source, target)
        return True

    def _source(self, name):
        path = self._folder / Path(name).name
        if path.exists():
            return path
        if name in FLOWN:
            _fly(path, *FLOWN[name])
        elif name in TAKEN:
            shutil.copy(TAKEN[name], path)
        elif name in ("motor.json", "body.json"):
            self._fit(name, path)
        elif name == "sessions/torn.mcap":
            whole = (ROOT / "recordings" / "stand_in_flight.mcap").read_bytes()
            path.write_bytes(whole[: len(whole) // 3])
        elif name == "flight.toml":
            path.write_text("[stand_in]\nprogram = 'wait'\n")
        elif name in ("map.toml", "log.csv"):
            path.write_text(_block_of_formats(name))
        else:
            return None
        return path

    def _fit(self, name, path):
        vehicle = load_vehicle("crazyflie1")
        base = vehicle_model(vehicle)
        runs = self._runs("motor_bench.mcap")
        model = identify_motor(runs, [], base, vehicle).documented()
        if name == "body.json":
            runs = self._runs("clean.mcap")
            model = identify_body(runs, [], model, vehicle).documented()
        save_model(model, path)

    def _runs(self, name):
        return runs_of(open_recording(self._source(name)).samples, name)


def _fly(path, seconds, settings):
    craft = StandIn(msgspec.convert(settings, StandInSettings))
    packets, heard_s = craft.advance(seconds)
    raw = RawBatch(packets, np.rint(heard_s * 1e9).astype(np.int64))
    samples, _ = decode_all(raw)
    session = {"session": session_metadata("stand-in")}
    write_mcap(Recording(path, "mcap", samples, raw, metadata=session), path)


def _block_of_formats(name):
    blocks = blocks_of(ROOT / "docs" / "formats.md")
    (text,) = [
        block.text
        for block in blocks
        if block.text.startswith("[time]" if name == "map.toml" else "t_ms")
    ]
    return text
