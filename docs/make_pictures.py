"""``python docs/make_pictures.py RECORDING [--at SECONDS]``: the README's picture of the viewer.

Needs no display; without a GPU, Debian's mesa-vulkan-drivers and libvulkan1 draw it.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from groundstation.recording.open_recording import open_recording
from groundstation.viewer.rrd import write_rrd
from groundstation.viewer.screenshot import hidden_viewer

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path, help="any recording that groundstation reads")
    parser.add_argument("--at", type=float, help="device time in seconds (default: the end)")
    options = parser.parse_args()
    recording = open_recording(options.recording)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.rrd"
        write_rrd(recording, path)
        with hidden_viewer(path, (1600, 900)) as viewer:
            picture = viewer.picture(options.at)
    IMAGES.mkdir(exist_ok=True)
    (IMAGES / "viewer.png").write_bytes(picture)


if __name__ == "__main__":
    main()
