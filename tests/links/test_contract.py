"""Every backend under the same contract."""

import asyncio
from typing import ClassVar

import numpy as np
import pytest

from groundstation.links.factory import make_link
from groundstation.recording.mcap_file import write_mcap
from groundstation.recording.session import Recording
from groundstation.telemetry.samples import SampleBatch
from support import RECORDINGS, packets
from support.crafts import served
from support.links import FiniteLinkContract, LinkContract

SOUND_RADIO = {"loss": {"good_loss": 0.0}}
ROWS = 150


def open_and_close(link):
    async def session():
        async with link:
            pass

    asyncio.run(session())


class MadeByTheFactory:
    """Links as the daemon makes them."""

    name = ""
    options: ClassVar[dict] = {}

    def make(self, tmp_path):
        return make_link(self.name.format(tmp_path=tmp_path), speed=1.0, stand_in=self.options)

    def open_wrongly(self, name, options):
        settings = {key: value for key, value in options.items() if key != "speed"}
        open_and_close(make_link(name, speed=options.get("speed", 1.0), stand_in=settings))


class TestStandIn(MadeByTheFactory, LinkContract):
    name = "stand-in"
    options = SOUND_RADIO
    bad = (
        ("stand-in", {"copys": 4}, "copys"),
        ("stand-in", {"plant": "perfect"}, "plant"),
        ("stand-in", {"program": "no such programme"}, "no such programme"),
        ("stand-in", {"effects": {"phlogiston": {}}}, "phlogiston"),
        ("stand-in", {"speed": 0.0}, "greater than 0"),
        ("stand-in:2", {}, "stand-in:2"),
        ("teleport", {}, "replay:FILE"),
    )


class TestStandInThatFiltersCopies(MadeByTheFactory, LinkContract):
    """The bridge of the thesis forwards each packet once."""

    name = "stand-in"
    options = SOUND_RADIO | {"bridge_dedup": True}
    copies = 1
    bad = (("stand-in", {"bridge_dedup": 7}, "bridge_dedup"),)


@pytest.fixture(scope="module")
def craft():
    with served(craft="crazyflie21", plant="reduced") as running:
        yield running


class TestCrazyflieLog(MadeByTheFactory, LinkContract):
    """A stock Crazyflie that is asked for its log."""

    kind = SampleBatch
    bad = (
        ("radio:0/80", {}, "radio:0/80"),
        ("teleport://0", {}, "radio://0/80/2M/E7E7E7E7E7"),
    )

    @pytest.fixture(autouse=True)
    def address(self, craft):
        self.name = craft.uri

    def make(self, tmp_path):
        return make_link(self.name, speed=1.0, stand_in={}, rate_hz=500)


class TestReplay(MadeByTheFactory, FiniteLinkContract):
    name = "replay:{tmp_path}/flight.mcap"
    bad = (
        ("replay:{tmp_path}/nowhere.mcap", {}, "nowhere.mcap"),
        ("replay:", {}, "replay"),
        ("replay:{tmp_path}/flight.mcap", {"speed": -1.0}, "greater than 0"),
        ("replay:{tmp_path}/flight.mcap", {"speed": float("nan")}, "greater than 0"),
    )

    def make(self, tmp_path):
        packets.write_flight(tmp_path / "flight.mcap", ROWS)
        return super().make(tmp_path)


class TestReplayOfSamples(MadeByTheFactory, FiniteLinkContract):
    """A source that never had packets, as a microSD log."""

    name = "replay:{tmp_path}/samples.mcap"
    kind = SampleBatch
    bad = (("replay:{tmp_path}/nowhere", {}, "nowhere"),)

    def make(self, tmp_path):
        _, samples = packets.flight(0, ROWS)
        samples.ticks[:] = np.arange(ROWS) * 2000
        recording = Recording(tmp_path, "microsd", samples)
        write_mcap(recording, tmp_path / "samples.mcap")
        return super().make(tmp_path)


async def test_a_link_is_added_by_one_row_and_one_file(tmp_path, monkeypatch):
    from groundstation import links
    from groundstation.links.factory import LINKS, split_name

    (tmp_path / "thesis_excerpt.py").write_text(
        "from pathlib import Path\n"
        "from groundstation.links.replay import ReplayLink\n"
        "def make(options):\n"
        "    return ReplayLink(Path(options.argument), speed=float('inf'), clock=options.clock)\n"
    )
    monkeypatch.setattr(links, "__path__", [*links.__path__, str(tmp_path)])
    monkeypatch.setitem(LINKS, "excerpt:FILE", "thesis_excerpt")
    name = f"excerpt:{RECORDINGS / 'thesis_excerpt.csv'}"
    assert split_name(name)[0] == "excerpt"

    async with make_link(name) as link:
        found = len(await link.read())
    assert found == 25
