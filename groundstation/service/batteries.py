"""The battery that flies, and those that were flown until they were low: what is left of it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from groundstation.documents import decode_json, read_document
from groundstation.telemetry.discharge import Discharge, left_s
from groundstation.telemetry.samples import SampleBatch

FILE = "batteries.json"
"""In the recordings folder: craft -> its last batteries, volts of each 5 s of flying."""
KEPT = 5
_Curves = dict[str, list[list[float]]]


class Batteries:
    """Follows the voltage of the craft that flies.

    folder: where recordings are. craft: by what its batteries are known.
    note: told (kind, text) where they cannot be kept.
    """

    def __init__(
        self, folder: Path, craft: Callable[[], str], note: Callable[[str, str], None]
    ) -> None:
        self._path = folder / FILE
        self._craft, self._note = craft, note
        self._curves: _Curves = {}
        with contextlib.suppress(OSError, ValueError):  # none so far, or not ours
            self._curves = decode_json(read_document(self._path), _Curves)
        self._keeping: set[asyncio.Future[None]] = set()
        self.split()

    def split(self) -> None:
        """What follows comes from another craft."""
        self._discharge = Discharge()
        self._windows = 0
        self._told = False
        self._left: tuple[float, float] | None = None

    def samples(self, batch: SampleBatch) -> None:
        """Take rows; never waits."""
        discharge = self._discharge
        if discharge.feed(batch):
            self._told = False
        if len(discharge.volts) == self._windows:
            return
        self._windows = len(discharge.volts)
        known = self._curves.setdefault(self._craft(), [])
        self._left = left_s(discharge.volts, known)
        if discharge.is_low and not self._told:
            self._told, self._left = True, (0.0, 0.0)
            known[:] = [*known, [round(one, 4) for one in discharge.volts]][-KEPT:]
            self._keep()

    def status(self) -> dict[str, Any]:
        """See ``answers.BatteryStatus``."""
        return {
            "flown_s": round(self._discharge.flown_s, 1),
            "left_s": self._left,
            "known": len(self._curves.get(self._craft(), ())),
        }

    def _keep(self) -> None:
        content = msgspec.json.encode(self._curves)
        future = asyncio.get_running_loop().run_in_executor(None, self._write, content)
        self._keeping.add(future)
        future.add_done_callback(self._kept)

    def _kept(self, future: asyncio.Future[None]) -> None:
        self._keeping.discard(future)
        if not future.cancelled() and (error := future.exception()) is not None:
            self._note("fault", f"{self._path}: {error}; how long this battery flew is forgotten")

    def _write(self, content: bytes) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        fresh = self._path.with_suffix(".new")
        fresh.write_bytes(content)
        fresh.replace(self._path)
