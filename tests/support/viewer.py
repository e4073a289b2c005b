"""What an .rrd file holds, and pictures of one as the viewer shows it, without a window: for tests
and the pages.

Draws with a real rerun viewer, by a GPU if there is one and else by Mesa's software Vulkan
driver (Debian: mesa-vulkan-drivers, libvulkan1).
"""

from __future__ import annotations

import contextlib
import os
import socket
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader

from groundstation.errors import GroundStationError
from groundstation.rerun_log.channels import DEVICE_TIME, rerun_program
from groundstation.viewer.child import Child, free_port

SCALARS = "Scalars:scalars"
TEXT = "TextLog:text"


def column(path: Path, component: str) -> dict[str, np.ndarray]:
    """Entity -> the values (n, k) of a component in the order of ``device_time``."""
    found: dict[str, list[tuple[int, np.ndarray]]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a live view that is being saved has no footer yet
        reader = RrdReader(path)
    for chunk in reader.stream() if reader.recordings() else ():
        batch = chunk.to_record_batch()
        if component in batch.schema.names and batch.num_rows:
            values = batch[component].flatten().to_numpy(zero_copy_only=False)
            begins = batch["device_time"][0].value
            entity = chunk.entity_path.replace("\\", "")
            found.setdefault(entity, []).append((begins, values.reshape(batch.num_rows, -1)))
    in_order = {entity: sorted(parts, key=lambda part: part[0]) for entity, parts in found.items()}
    return {
        entity: np.concatenate([values for _, values in parts])
        for entity, parts in in_order.items()
    }


START_S = 60.0
PAINT_S = 30.0
REST = 2
"""The viewer fetches data as it paints: so many pictures must not differ from the one before."""
_SOFTWARE_DRIVERS = Path("/usr/share/vulkan/icd.d")


@dataclass(frozen=True, slots=True)
class HiddenViewer:
    """An open rerun viewer without a window. Made by ``hidden_viewer``."""

    client: Any

    def views(self) -> dict[str, str]:
        """Name -> id of the views on the screen; raises GroundStationError if one complains."""
        state = self.client.get_state()
        for view in state.views:
            for report in view.reports:
                raise GroundStationError(f"view {view.name}: {report.summary}")
        return {view.name: view.view_id for view in state.views if view.visible}

    def picture(self, at_s: float | None = None, view: str | None = None) -> bytes:
        """PNG of the screen, or of the view with this name, at a device time (default: the end).

        Raises GroundStationError when the picture does not come to rest.
        """
        if at_s is not None:
            self.client.set_time(DEVICE_TIME, duration=at_s, play_state="paused")
        before, same = b"", 0
        deadline = time.monotonic() + PAINT_S
        while time.monotonic() < deadline:
            picture = self._paint(view)
            same = same + 1 if picture and picture == before else 0
            if same >= REST and not self.client.get_state().loading:
                return picture
            before = picture
        raise GroundStationError(f"{view or 'the viewer'} did not come to rest in {PAINT_S:g} s")

    def _paint(self, view: str | None) -> bytes:
        views = self.views()
        if view is not None and view not in views:  # the layout has not been loaded yet
            return b""
        try:
            picture: bytes = self.client.take_screenshot(views[view] if view else None)
        except ConnectionError:  # the layout has just replaced the view
            return b""
        return picture


@contextlib.contextmanager
def hidden_viewer(path: Path, size: tuple[int, int] = (1920, 1080)) -> Iterator[HiddenViewer]:
    """Open the .rrd recording ``path`` in a viewer of ``size`` pixels.

    Raises GroundStationError when the viewer cannot start (no Vulkan driver, say) or cannot open
    the file.
    """
    from rerun.experimental import ViewerClient

    port = free_port("127.0.0.1")
    command = [
        str(rerun_program()), "--headless", "--bind", "127.0.0.1", "--port", str(port),
        "--window-size", f"{size[0]}x{size[1]}", "--hide-welcome-screen",
    ]  # fmt: skip
    process = Child(command, environment=_driver())
    try:
        client = _open(ViewerClient, process, port, path)
        viewer = HiddenViewer(client)
        viewer.picture()
        yield viewer
    finally:
        process.kill()
        while process.poll() is None:
            time.sleep(0.01)


def software_driver() -> Path | None:
    """Mesa's software Vulkan driver, if it is installed."""
    return next(iter(sorted(_SOFTWARE_DRIVERS.glob("lvp_icd*.json"))), None)


def _driver() -> dict[str, str]:
    driver = software_driver()
    has_gpu = any(Path("/dev/dri").glob("renderD*"))
    if driver is None or has_gpu or "VK_ICD_FILENAMES" in os.environ:
        return {}
    return {"VK_ICD_FILENAMES": str(driver)}


def _open(client_type: Any, process: Child, port: int, path: Path) -> Any:
    """Connect as soon as the viewer is up; it may still end for want of a graphics driver."""
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise GroundStationError(
                f"the viewer ended ({process.last_words}): is a Vulkan driver installed "
                "(Debian: mesa-vulkan-drivers libvulkan1)?"
            )
        with contextlib.suppress(OSError, RuntimeError):
            socket.create_connection(("127.0.0.1", port), 1).close()
            client = client_type.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.take_screenshot()  # without a driver, it ends when it should paint
            if client.open(str(path.resolve())).store_ids:
                return client
            raise GroundStationError(f"{path} could not be opened in the viewer")
        time.sleep(0.05)
    raise GroundStationError(f"the viewer did not answer within {START_S:g} s")
