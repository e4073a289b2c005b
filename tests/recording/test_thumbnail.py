"""A flight at a glance."""

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from groundstation.recording.open_recording import open_recording
from groundstation.recording.thumbnail import COLUMNS, HEIGHT, thumbnail
from groundstation.telemetry.samples import empty_samples

FLIGHT = Path(__file__).parents[2] / "recordings" / "stand_in_flight.mcap"


@pytest.fixture(scope="module")
def samples():
    return open_recording(FLIGHT).samples


def strokes(svg, name):
    """Top and bottom of each column."""
    (path,) = (one for one in ElementTree.fromstring(svg) if one.get("class") == name)
    found = re.findall(r"M[\d.]+ (-?[\d.]+)V(-?[\d.]+)", path.get("d"))
    return np.array(found, float)


def test_every_column_reaches_from_the_least_to_the_most(samples):
    roll = strokes(thumbnail(samples), "roll")
    assert len(roll) == COLUMNS
    assert (roll[:, 0] <= roll[:, 1]).all()
    assert ((roll >= 0) & (roll <= HEIGHT)).all()
    angles = np.degrees(samples.attitude[:, :2])
    column = len(samples) // COLUMNS
    first = (HEIGHT / 2 - roll[0, 0]) / (HEIGHT / 2 - 1) * max(10.0, np.abs(angles).max())
    assert first == pytest.approx(angles[:column, 0].max(), abs=0.3)


def test_a_flight_that_hardly_leans_looks_like_that(samples):
    still = samples[:100]
    still.attitude[:] = np.radians(0.5)
    assert np.ptp(strokes(thumbnail(still), "roll")) < 2


def test_what_is_not_known_is_not_drawn(samples):
    assert len(ElementTree.fromstring(thumbnail(empty_samples(0)))) == 1
    blind = samples[:100]
    blind.attitude[:] = np.nan
    assert [one.get("class") for one in ElementTree.fromstring(thumbnail(blind))[1:]] == ["motors"]
