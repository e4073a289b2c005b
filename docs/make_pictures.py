"""``python docs/make_pictures.py [viewer] [page] [report] [where]``: pictures.

viewer: a stand-in flight in the viewer; needs no display; without a GPU, Debian's
mesa-vulkan-drivers and libvulkan1 draw it. page: the operator's page after half a minute of flight,
light, dark and on a phone; report: a comparison's, likewise; both need the tests' library and
Debian's chromium. where: the map of where a model and
a craft with hidden effects disagree, and how the gap shrinks as the search names them. Any other
name is an error.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from firmware_sim.craft import StandIn
from firmware_sim.settings import StandInSettings
from groundstation import (
    RawBatch,
    Run,
    decode_all,
    find_discrepancy,
    flights_of,
    load_vehicle,
    open_recording,
    vehicle_model,
)
from groundstation.discrepancy.report import waterfall, where_map
from groundstation.recording.rrd import write_rrd
from groundstation.report.page import png
from groundstation.viewer.child import free_port

IMAGES = Path(__file__).parent / "images"
RECORDING = Path(__file__).parents[1] / "recordings" / "stand_in_flight.mcap"
AT_S = 24.0
HIDDEN = {
    "centre_of_gravity_offset": {"x_m": 0.0001},
    "velocity_moment": {"moment": 10.0},
    "rotor_acceleration_torque": {"rotor_inertia_kg_m2": 2e-8},
}
FLIGHT_S = 40.0
PROGRAM = "from groundstation.cli.main import main; main()"
LOOKS = {
    "light": ("light", 1280, 1000),
    "dark": ("dark", 1280, 1000),
    "phone": ("dark", 390, 844),
}
"""Name -> theme, width and height in pixels."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    known = ["viewer", "page", "report", "where"]
    parser.add_argument("pictures", nargs="*", choices=[[], *known])
    chosen = parser.parse_args().pictures or known
    if "viewer" in chosen:
        save("viewer.png", viewer_picture(RECORDING, AT_S))
    if "page" in chosen:
        for look, picture in page_pictures().items():
            save(f"page_{look}.png", picture)
    if "report" in chosen:
        for look, picture in report_pictures(RECORDING).items():
            save(f"report_{look}.png", picture)
    if "where" in chosen:
        where, gap = search_pictures()
        save("where.png", where)
        save("gap.png", gap)


def save(name: str, picture: bytes) -> None:
    (IMAGES / name).write_bytes(picture)
    print(IMAGES / name)


def page_pictures() -> dict[str, bytes]:
    """The page of a daemon whose stand-in has flown for half a minute, by look."""
    from playwright.sync_api import expect, sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        command = [sys.executable, "-c", PROGRAM]
        environment = {**os.environ, "GROUNDSTATION_SOCKET": f"{folder}/control.sock"}
        port = str(free_port("127.0.0.1"))
        with subprocess.Popen(
            [*command, "run", "--page", "--set", f"page.port={port}"],
            cwd=folder, env=environment, stdout=subprocess.PIPE, text=True,
        ) as daemon:  # fmt: skip
            try:
                assert daemon.stdout is not None
                next(line for line in daemon.stdout if line.split()[:1] == ["control"])
                answer = subprocess.check_output([*command, "page"], env=environment, text=True)
                page = browser_page(playwright)
                page.goto(answer.strip())
                expect(page.locator("#live")).to_have_text("live", timeout=120_000)
                page.wait_for_timeout(30_000)
                return looks(page, full=True)
            finally:
                daemon.terminate()


def report_pictures(recording: Path) -> dict[str, bytes]:
    """The report of a comparison of the thesis's model with a recording, by look."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        report = Path(folder) / "report.html"
        words = ["compare", str(recording), "--model", "thesis", "--html", str(report)]
        command = [sys.executable, "-c", PROGRAM, *words]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        page = browser_page(playwright)
        page.goto(report.as_uri())
        return looks(page, full=False)


def browser_page(playwright: Any) -> Any:
    chromium = playwright.chromium.launch(
        executable_path=shutil.which("chromium"), args=["--no-sandbox"]
    )
    return chromium.new_page()


def looks(page: Any, *, full: bool) -> dict[str, bytes]:
    """Pictures of a browser's page: light, dark, and on a phone. full: to its end."""
    pictures = {}
    for look, (theme, width, height) in LOOKS.items():
        page.set_viewport_size({"width": width, "height": height})
        page.emulate_media(color_scheme=theme)
        page.wait_for_timeout(1_000)
        pictures[look] = page.screenshot(full_page=full and look != "phone")
    return pictures


def viewer_picture(recording: Path, at_s: float) -> bytes:
    """The recording in the viewer, the cursor at a device time."""
    sys.path.append(str(Path(__file__).parents[1] / "tests"))
    from support.viewer import hidden_viewer

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.rrd"
        write_rrd(open_recording(recording), path)
        with hidden_viewer(path, (1600, 900)) as viewer:
            return viewer.picture(at_s)


def search_pictures() -> tuple[bytes, bytes]:
    """(where a model errs on a craft with hidden effects, the gap as they are named)."""
    model = vehicle_model(load_vehicle("crazyflie1"))
    found = find_discrepancy([flown(3), flown(4)], model, [flown(5)])
    proof = found.proof
    print(", ".join(one.name for one in found.findings.effects), [s[1] for s in proof.steps])
    return (
        png(where_map([("the model given: error over noise", proof.before.places)])),
        png(waterfall(proof.steps)),
    )


def flown(seed: int) -> list[Run]:
    settings = {"plant": "reduced", "seed": seed, "effects": HIDDEN}
    packets, heard_s = StandIn(msgspec.convert(settings, StandInSettings)).advance(FLIGHT_S)
    samples, _ = decode_all(RawBatch(packets, np.rint(heard_s * 1e9).astype(np.int64)))
    return flights_of(samples, f"flight {seed}")


if __name__ == "__main__":
    main()
