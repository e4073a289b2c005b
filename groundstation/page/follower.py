"""What browsers are shown of the live stream: one reader for all of them, and none without them."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from groundstation.errors import GroundStationError
from groundstation.service.client import Client, ask, live

ROWS_HZ = 50.0
"""Rows a second that the daemon is asked for: each is one that came, what lies between is left
out."""
KEPT_S = 20.0
ANSWER_ROWS_MOST = 250
"""A browser that asks seldom gets fewer of the rows it has missed, not more."""
WANTED_S = 5.0
"""So long after the last browser asked the stream is left."""
STATUS_S = 1.0
RETRY_S = 0.5
OFFSET_MOST_S = 1.0
DRIFT = 2e-4
"""By which the craft's clock may be off, of the time."""
EVENTS_KEPT = 40

Row = tuple[int, float, dict[str, Any]]
"""Number, time of this machine (``time.monotonic``), values in units of people."""


class Follower:
    """Follows the daemon at ``control`` while somebody asks; safe to ask from any thread."""

    def __init__(self, control: Path) -> None:
        self._control = control
        self._lock = threading.Lock()
        self._rows: deque[Row] = deque()
        self._number = 0
        self._newest_s: float | None = None
        self._offset_s = -math.inf  # of the craft's clock
        self._events: deque[dict[str, Any]] = deque(maxlen=EVENTS_KEPT)
        self._twin_event: dict[str, Any] | None = None
        self._status: dict[str, Any] | None = None
        self._status_number = 0
        self._fault = ""
        self._wanted_until_s = 0.0
        self._wanted = threading.Event()
        for work in (self._follow, self._look):
            threading.Thread(target=work, name=f"page {work.__name__}", daemon=True).start()

    def now(self, after: int, known_status: int) -> dict[str, Any]:
        """What has changed since row ``after`` and status ``known_status``.

        age_s: how old the newest row is; None before the first. fault: why the daemon cannot be
        asked, or empty. rows: thinned, their ages in s at ``now_s``, the time of this machine.
        """
        now_s = time.monotonic()
        with self._lock:
            self._wanted_until_s = now_s + WANTED_S
            self._wanted.set()
            new = [row for row in self._rows if row[0] > after or after > self._number]
            status = self._status if self._status_number != known_status else None
            events, twin_event = list(self._events), self._twin_event
            newest_s, fault = self._newest_s, self._fault
            number, status_number = self._number, self._status_number
        step = max(1, math.ceil(len(new) / ANSWER_ROWS_MOST))
        new = new[::-1][::step][::-1]
        return {
            "number": number,
            "now_s": now_s,
            "age_s": None if newest_s is None else round(now_s - newest_s, 3),
            "fault": fault,
            "status_number": status_number,
            "status": status,
            "rows": [{"age_s": round(now_s - at_s, 3), **values} for _, at_s, values in new],
            "events": events if status is not None else None,
            "twin_event": twin_event,
        }

    def state(self) -> tuple[dict[str, Any] | None, str, float | None]:
        """The newest status; why the daemon cannot be asked, or empty; the battery's mean voltage
        over the last two seconds, for it sags for moments."""
        with self._lock:
            last = islice(reversed(self._rows), round(2.0 * ROWS_HZ))
            volts = [values["battery_v"] for _, _, values in last if values.get("battery_v")]
            battery_v = sum(volts) / len(volts) if volts else None
            return self._status, self._fault, battery_v

    # -- two threads: the stream, and the status -------------------------------------------

    def _follow(self) -> None:
        while True:
            self._wanted.wait()
            try:
                past = ask(self._control, "GET", "/events")
                with self._lock:
                    self._events.clear()
                    for event in past:
                        self._take_event(event)
                with contextlib.closing(live(self._control, ROWS_HZ)) as messages:
                    for kind, content in messages:
                        with self._lock:
                            if kind == "samples":
                                self._take_samples(content)
                            elif kind == "event":
                                self._take_event(content)
                        if time.monotonic() > self._wanted_until_s:
                            break
            except GroundStationError:
                pass  # the other thread says why
            self._rest()

    def _look(self) -> None:
        daemon = Client(self._control)
        while True:
            self._wanted.wait()
            try:
                status, fault = daemon.ask("GET", "/status"), ""
            except GroundStationError as error:
                status, fault = None, str(error)
            with self._lock:
                self._fault = fault
                if status is not None:
                    self._status = status
                    self._status_number += 1
            time.sleep(STATUS_S)

    def _rest(self) -> None:
        """Before the stream is looked for again, or until somebody wants it."""
        with self._lock:
            if time.monotonic() > self._wanted_until_s:
                self._wanted.clear()
                return
        time.sleep(RETRY_S)

    def _take_samples(self, content: dict[str, Any]) -> None:
        ticks, tick_s = content["ticks"], content["tick_s"]
        at_s = float(content["at_s"])
        since_s = at_s - (self._newest_s or at_s)
        self._newest_s = at_s
        # rows come in bursts: their own clock says when each was measured, and the one that was
        # on its way for the least time says what that clock shows here
        offset_s = at_s - ticks[-1] * tick_s
        if abs(offset_s - self._offset_s) > OFFSET_MOST_S:
            self._offset_s = offset_s  # another craft, or the same one restarted
        self._offset_s = min(offset_s, self._offset_s + DRIFT * since_s)
        for row in range(len(ticks)):
            row_s = self._offset_s + ticks[row] * tick_s
            self._number += 1
            self._rows.append((self._number, row_s, dict(_shown(content, row))))
        while self._rows and self._rows[0][1] < at_s - KEPT_S:
            self._rows.popleft()

    def _take_event(self, event: dict[str, Any]) -> None:
        self._events.append(event)
        if event["link"] == "twin":
            self._twin_event = event


def _shown(content: dict[str, Any], row: int) -> Iterator[tuple[str, Any]]:
    """A row's values in deg, deg/s, per cent of duty, V: those that the craft tells."""
    for name, field, factor in (
        ("attitude_deg", "attitude_rad", math.degrees(1.0)),
        ("gyro_dps", "gyro_rad_s", math.degrees(1.0)),
        ("motors_pct", "duty", 100.0),
    ):
        if field in content:
            yield name, [None if v is None or math.isnan(v) else round(v * factor, 2)
                         for v in islice(content[field][row], 4)]  # fmt: skip
    if "battery_v" in content:
        yield "battery_v", content["battery_v"][row]
