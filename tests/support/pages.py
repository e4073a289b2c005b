"""README and docs taken apart, and what their examples work on."""

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from firmware_sim.craft import StandIn
from firmware_sim.settings import StandInSettings
from groundstation.dynamics.model import save_model, vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.identification.body import identify_body
from groundstation.identification.motor.workflow import identify_motor
from groundstation.identification.runs import runs_of
from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_file import session_metadata, write_mcap
from groundstation.recording.session import Recording
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch
from support import ROOT

PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
PROGRAMS = {
    *("groundstation", "make", "python", "pip", "source", "curl", "sudo"),
    *("ssh", "sh", "pytest"),
}
"""What the first word of a command in a block can be."""
DATA = {"python", "toml", "json", "csv", "c", "text", "console"}
"""Languages of blocks that hold no commands; ``text`` behind commands is what they
print, ``console`` the same where no test repeats it."""
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


@dataclass(frozen=True)
class Block:
    """A fenced block: line is that of its first line of content, from 1."""

    page: Path
    line: int
    language: str
    text: str

    @property
    def where(self):
        return f"{self.page.name}:{self.line}"

    @property
    def holds_commands(self):
        """Marked ``sh``, or unmarked and beginning with a program."""
        words = self.text.split(maxsplit=1)
        return self.language == "sh" or (not self.language and bool(words) and words[0] in PROGRAMS)

    def commands(self):
        """The command lines, continued ones joined, without comments."""
        found = []
        joined = self.text.replace("\\\n", " ")
        for line in joined.splitlines():
            without = re.sub(r"(^|\s)#\s.*$", "", line).strip()
            if without:
                found.append(" ".join(without.split()))
        return found


def blocks_of(page):
    found, lines, start, language = [], [], None, ""
    for number, line in enumerate(page.read_text().splitlines(), 1):
        mark = re.match(r"\s*```(\w*)\s*$", line)
        if mark is None:
            if start is not None:
                lines.append(line)
        elif start is None:
            start, language, lines = number + 1, mark.group(1), []
        else:
            found.append(Block(page, start, language, "\n".join(lines) + "\n"))
            start = None
    assert start is None, f"{page.name}:{start}: a block that does not end"
    return found


def prose_of(page):
    """The page without its fenced blocks."""
    return re.sub(r"^\s*```.*?^\s*```\s*$", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)


def inline_code(page):
    """What stands in backticks in the prose, line breaks made blanks."""
    return [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", prose_of(page))]


def links_of(page):
    """(target, anchor) of each relative link and image."""
    for target in re.findall(r"\]\(([^)\s]+)\)", prose_of(page)):
        if not re.match(r"\w+:", target):
            path, _, anchor = target.partition("#")
            yield path, anchor


def anchors_of(page):
    """The names under which headings can be linked, as GitHub makes them."""
    heads = re.findall(r"^#+ (.*)$", prose_of(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


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
