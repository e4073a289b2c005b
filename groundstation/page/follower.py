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
EVENTS_KEPT = 120

COLUMNS = (
    ("attitude", "attitude_rad", math.degrees(1.0), ("roll", "pitch", "yaw")),
    ("gyro", "gyro_rad_s", math.degrees(1.0), ("x", "y", "z")),
    ("motors", "duty", 100.0, ("M1", "M2", "M3", "M4")),
    ("accelerometer", "accelerometer_m_s2", 1.0, ("x", "y", "z")),
    ("rotors", "rotor_rev_s", 1.0, ("M1", "M2", "M3", "M4")),
    ("battery", "battery_v", 1.0, ("voltage",)),
)
"""Of the page: name, field of the stream, factor into deg, deg/s, per cent and V, parts."""
TELEMETRY = "telemetry"
"""The table of the samples; the craft's log variables have tables of their own names."""

Row = tuple[int, float, list[float | None]]
"""Number, Unix time in s, values."""


class _Table:
    """Rows of the last seconds, at times that never go back.

    The time at which rows are shown glides to a better estimate of the craft's clock: where they
    would go back, they come at half their pace until they are right.
    """

    def __init__(self, columns: list[str]) -> None:
        self.columns = columns
        self.rows: deque[Row] = deque()
        self._shown_s = self._true_s = -math.inf

    def put(self, number: int, time_s: float, values: list[float | None]) -> None:
        step_s = time_s - self._true_s
        self._true_s = time_s
        least_s = self._shown_s + (step_s / 2 if 0.0 < step_s < 1.0 else 1e-3)
        self._shown_s = max(time_s, least_s)
        self.rows.append((number, self._shown_s, values))
        while self.rows[0][1] < self._shown_s - KEPT_S:
            self.rows.popleft()


class Follower:
    """Follows the daemon at ``control`` while somebody asks; safe to ask from any thread."""

    def __init__(self, control: Path) -> None:
        self._control = control
        self._lock = threading.Lock()
        self._tables: dict[str, _Table] = {}
        self._unix_s = time.time() - time.monotonic()  # once: a clock that is set moves nothing
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
        asked, or empty. tables: by name columns and thinned rows, [Unix time in s, values...].
        now_s: Unix time on the same clock.
        """
        now_s = time.monotonic()
        with self._lock:
            self._wanted_until_s = now_s + WANTED_S
            self._wanted.set()
            everything = after > self._number  # of another process
            new = {
                name: (table.columns, [row for row in table.rows if everything or row[0] > after])
                for name, table in self._tables.items()
            }
            status = self._status if self._status_number != known_status else None
            events, twin_event = list(self._events), self._twin_event
            newest_s, fault = self._newest_s, self._fault
            number, status_number = self._number, self._status_number
        return {
            "number": number,
            "now_s": round(now_s + self._unix_s, 3),
            "age_s": None if newest_s is None else round(now_s - newest_s, 3),
            "fault": fault,
            "status_number": status_number,
            "status": status,
            "tables": {
                name: {"columns": columns, "rows": _thinned(rows)}
                for name, (columns, rows) in new.items()
                if rows
            },
            "events": events if status is not None else None,
            "twin_event": twin_event,
        }

    def state(self) -> tuple[dict[str, Any] | None, str, float | None]:
        """The newest status; why the daemon cannot be asked, or empty; the battery's mean voltage
        over the last two seconds, for it sags for moments."""
        with self._lock:
            table = self._tables.get(TELEMETRY)
            volts = [] if table is None else list(_newest(table, "battery.voltage"))
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
                            elif kind == "table":
                                self._take_table(content)
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
        columns, values = _shown(content)
        table = self._table(TELEMETRY, columns)
        for row, tick in enumerate(ticks):
            self._put(table, self._offset_s + tick * tick_s, [column[row] for column in values])

    def _take_table(self, content: dict[str, Any]) -> None:
        """Log variables: on the clock of the samples where there are any."""
        times_s = content["time_s"]
        if not times_s:
            return
        offset_s = self._offset_s
        if abs(content["at_s"] - times_s[-1] - offset_s) > OFFSET_MOST_S:
            offset_s = content["at_s"] - times_s[-1]
        table = self._table(content["name"], list(content["columns"]))
        for time_s, *values in zip(times_s, *content["columns"].values(), strict=True):
            self._put(table, offset_s + time_s, values)

    def _table(self, name: str, columns: list[str]) -> _Table:
        table = self._tables.get(name)
        if table is None or table.columns != columns:
            table = self._tables[name] = _Table(columns)
        return table

    def _put(self, table: _Table, at_s: float, values: list[float | None]) -> None:
        self._number += 1
        table.put(self._number, round(at_s + self._unix_s, 4), values)

    def _take_event(self, event: dict[str, Any]) -> None:
        self._events.append(event)
        if event["link"] == "twin":
            self._twin_event = event


def _thinned(rows: list[Row]) -> list[list[Any]]:
    """As many as one answer holds, the newest among them."""
    step = max(1, math.ceil(len(rows) / ANSWER_ROWS_MOST))
    return [[time_s, *values] for _, time_s, values in rows[::-1][::step][::-1]]


def _newest(table: _Table, column: str) -> Iterator[float]:
    """What a column says of the last two seconds."""
    if column in table.columns:
        place = table.columns.index(column)
        for _, _, values in islice(reversed(table.rows), round(2.0 * ROWS_HZ)):
            value = values[place]
            if value is not None:
                yield value


def _shown(content: dict[str, Any]) -> tuple[list[str], list[list[float | None]]]:
    """Channels that the craft sends and their values, in the units of the page."""
    names: list[str] = []
    columns: list[list[float | None]] = []
    for name, field, factor, parts in COLUMNS:
        if field not in content:
            continue
        rows = content[field]
        for place, part in enumerate(parts):
            names.append(f"{name}.{part}")
            one = [row[place] for row in rows] if len(parts) > 1 else rows
            columns.append([None if v is None else round(v * factor, 3) for v in one])
    return names, columns
