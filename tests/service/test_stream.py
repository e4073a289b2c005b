"""The live stream: who shows and does not compute gets few rows, as they came."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.errors import GroundStationError
from groundstation.service.client import ask, live
from groundstation.service.config import Config, RecordingConfig
from groundstation.service.stream import thinned
from groundstation.telemetry.samples import TICK_S, empty_samples
from support.waiting import until
from support.worlds import serve


def rows_of(count, period_s=0.002):
    batch = empty_samples(count, TICK_S)
    return replace(batch, ticks=np.round(np.arange(count) * period_s / TICK_S).astype(np.int64))


@pytest.mark.parametrize(("count", "kept"), [(50, 5), (500, 50), (7, 1), (1, 1)])
def test_few_rows_are_evenly_spread_and_the_newest_is_among_them(count, kept):
    batch = rows_of(count)
    few = thinned(batch, 50.0)
    assert 0.9 * kept <= len(few) <= kept
    assert few.ticks[-1] == batch.ticks[-1]
    assert set(few.ticks) <= set(batch.ticks)
    apart = np.diff(few.ticks)
    assert not len(apart) or np.ptp(apart) <= 1


def test_a_slow_source_is_not_thinned():
    batch = rows_of(40, period_s=0.02)
    assert len(thinned(batch, 100.0)) == 40


def talk(path, conversation):
    config = Config(recording=RecordingConfig(folder=str(path.parent), enabled=False))
    return serve(config, path, conversation)


def test_a_client_gets_about_the_rows_that_it_asks_for(path):
    def conversation(station):
        ticks, messages = [], 0
        for kind, content in live(path, rows_hz=50.0):
            if kind != "samples":
                continue
            messages += 1
            ticks += content["ticks"]
            if messages == 20:
                break
        until(lambda: len(station.stream) == 0, "it has left")
        return len(ticks), (ticks[-1] - ticks[0]) * content["tick_s"], content["dropped"]

    rows, lasted_s, dropped = talk(path, conversation)
    assert 25.0 < rows / lasted_s < 55.0
    assert dropped == 0


@pytest.mark.parametrize("rows_hz", ["0", "-1", "nan", "inf", "many", ""])
def test_rows_that_cannot_be_are_refused(path, rows_hz):
    def conversation(station):
        with pytest.raises(GroundStationError, match=r"give a number of 1 or more"):
            ask(path, "GET", f"/stream?rows_hz={rows_hz}")

    talk(path, conversation)
