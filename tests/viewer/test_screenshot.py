"""What people see: pictures of the real viewer, compared with pictures without data."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from groundstation.errors import GroundStationError
from groundstation.recording.rrd import write_rrd
from groundstation.recording.session import Recording
from groundstation.rerun_log.channels import GROUPS, MOTORS, STATISTICS
from groundstation.telemetry.samples import empty_samples
from support.viewer import hidden_viewer, software_driver

pytestmark = [
    pytest.mark.screenshot,
    pytest.mark.skipif(
        software_driver() is None,
        reason="no software Vulkan driver: apt-get install mesa-vulkan-drivers libvulkan1",
    ),
]

SERIES = {
    "Attitude (deg)": GROUPS[0].colors,
    "Rates (deg/s)": GROUPS[1].colors,
    "Accelerometer (g)": GROUPS[2].colors,
    "Motors (% duty)": GROUPS[3].colors,
    "Battery (V)": GROUPS[4].colors,
    "Link: loss (%), latency (ms)": (STATISTICS["loss_pct"][1], STATISTICS["latency_ms"][1]),
    "Samples per second": (STATISTICS["rate_hz"][1],),
}
LEVEL_S, ROLLED_S = 2.0, 6.0


def pixels(png: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(png)) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def painted(picture: np.ndarray, color: tuple[int, int, int]) -> int:
    """How many pixels have this color."""
    return int((np.abs(picture - color).max(axis=2) < 12).sum())


@pytest.fixture(scope="module")
def empty(tmp_path_factory):
    """Pictures of every view of a recording without data, by name."""
    path = tmp_path_factory.mktemp("empty") / "empty.rrd"
    write_rrd(Recording(Path("empty"), "mcap", empty_samples(0)), path)
    with hidden_viewer(path) as viewer:
        return {name: pixels(viewer.picture(view=name)) for name in viewer.views()}


@pytest.fixture
def rolling_flight(flight, wobble):
    """Eight seconds, from the fourth on rolled by 20 deg; no pitch or yaw at full seconds."""
    samples = wobble(4000)
    swing = np.sin(np.pi * samples.time_s)
    samples.attitude[:] = np.radians(np.stack([0 * swing, 5 * swing, -8 * swing], axis=1))
    samples.attitude[2000:, 0] = np.radians(20)
    return replace(flight, samples=samples)


def test_every_named_series_and_the_moved_craft_are_on_the_screen(rolling_flight, empty, tmp_path):
    write_rrd(rolling_flight, tmp_path / "flight.rrd")
    with hidden_viewer(tmp_path / "flight.rrd") as viewer:
        views = viewer.views()
        pictures = {name: pixels(viewer.picture(view=name)) for name in views}
        level, rolled = (pixels(viewer.picture(at, "Craft")) for at in (LEVEL_S, ROLLED_S))

    assert set(views) == set(empty) == {*SERIES, "Craft", "Events"}
    for name, colors in SERIES.items():
        for color in colors:
            # a line across the view, and not only the dot in the legend
            assert painted(pictures[name], color) > 150, (name, color)
            assert painted(empty[name], color) < 60, (name, color)
    assert lettering(pictures["Events"]) > lettering(empty["Events"]) + 300

    for color in MOTORS:
        assert shaded(level, color).sum() > 1000
        assert shaded(rolled, color).sum() > 1000
    assert (np.abs(rolled - level).max(axis=2) > 40).sum() > 5000
    # left side up: seen from behind, the left rotor has risen and the right one has sunk
    left, right = MOTORS[3], MOTORS[1]
    assert height(rolled, left) > height(level, left) + 5
    assert height(rolled, right) < height(level, right) - 5


def lettering(picture: np.ndarray) -> int:
    """How many pixels are bright."""
    return int((picture.max(axis=2) > 120).sum())


def height(picture: np.ndarray, color: tuple[int, int, int]) -> float:
    """Mean height in pixels above the bottom of what has this color."""
    return picture.shape[0] - float(np.nonzero(shaded(picture, color))[0].mean())


def shaded(picture: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Which pixels have this hue, in whatever light."""
    brightness = np.linalg.norm(picture, axis=2)
    likeness = picture @ np.array(color) / (np.linalg.norm(color) * np.maximum(brightness, 1))
    return (likeness > 0.998) & (brightness > 150)


def test_a_file_that_the_viewer_cannot_open_is_an_error(tmp_path):
    (tmp_path / "broken.rrd").write_bytes(b"not a recording")
    with (
        pytest.raises(GroundStationError, match="could not be opened"),
        hidden_viewer(tmp_path / "broken.rrd"),
    ):
        pass


def test_a_viewer_without_a_graphics_driver_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("VK_ICD_FILENAMES", str(tmp_path / "none.json"))
    with (
        pytest.raises(GroundStationError, match="mesa-vulkan-drivers"),
        hidden_viewer(tmp_path / "flight.rrd"),
    ):
        pass
