"""``python -m groundstation.viewer.feeder FD ADDRESS PORT RECORDING LAYOUT``: alone loads rerun.

Reads messages from the SOCK_SEQPACKET socket FD and logs them to the rerun server on PORT of
ADDRESS. It may block or die at any time: the daemon drops, notices and starts another one. All
feeders of one daemon write to the same RECORDING, so that an open viewer simply continues. LAYOUT:
``plain``, or ``twin``, ``tables`` or both joined by a plus.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import sys
import time
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from groundstation.rerun_log.channels import (
    APPLICATION,
    DEVICE_TIME,
    EVENTS,
    PITCH,
    ROLL,
    YAW,
    LiveClock,
)
from groundstation.rerun_log.log import LIVE_WINDOW_S, ViewerLog, pilot_blueprint
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.viewer.messages import (
    MAX_BYTES,
    Acknowledgement,
    decode_message,
    encode_message,
    predictions_in,
    samples_in,
    unpacked,
)

# The live twin as rerun columns: what was measured, what was predicted, and the gap.


TWIN = "/twin"
GAP = f"{TWIN}/gap"
MEASURED, PREDICTED = "measured", "predicted"
ROLE_S = {MEASURED: 1.0, PREDICTED: 2.0}
"""Widths of the lines."""


@dataclass(frozen=True, slots=True)
class Shown:
    """Some of the nine channels, as people read them."""

    entity: str
    columns: slice
    per_si: float
    names: tuple[str, ...]
    colors: tuple[tuple[int, int, int], ...]


GROUPS = (
    Shown(f"{TWIN}/rates", slice(0, 3), 180 / np.pi, ("roll", "pitch", "yaw"), (ROLL, PITCH, YAW)),
    Shown(f"{TWIN}/accelerometer", slice(5, 6), 1 / STANDARD_GRAVITY, ("up",), (YAW,)),
    Shown(
        f"{TWIN}/attitude", slice(6, 9), 180 / np.pi, ("roll", "pitch", "yaw"), (ROLL, PITCH, YAW)
    ),
)
GAPS = (
    "gyro x",
    "gyro y",
    "gyro z",
    "accelerometer x",
    "accelerometer y",
    "accelerometer z",
    "roll",
    "pitch",
    "yaw",
)
GAP_COLORS = (
    ROLL,
    PITCH,
    YAW,
    (255, 167, 38),
    (212, 225, 87),
    (38, 198, 218),
    (240, 150, 150),
    (170, 220, 170),
    (150, 195, 250),
)


class TwinLog:
    """Writes to one rerun stream, on the axis of ``clock``."""

    def __init__(self, stream: rr.RecordingStream, clock: LiveClock) -> None:
        self._stream = stream
        self._clock = clock

    def names(self) -> None:
        """Names and colours of the series: static, sent once."""
        for group in GROUPS:
            for role, width in ROLE_S.items():
                shades = [_shade(color, role) for color in group.colors]
                names = [f"{name}, {role}" for name in group.names]
                lines = rr.SeriesLines(names=names, colors=shades, widths=width)
                self._stream.log(f"{group.entity}/{role}", lines, static=True, strict=True)
        lines = rr.SeriesLines(names=GAPS, colors=GAP_COLORS, widths=2.0)
        self._stream.log(GAP, lines, static=True, strict=True)

    def show(
        self, segment: int, time_s: Array, measured: Array, predicted: Array, gap: Array
    ) -> None:
        """Log (m, 9) SI at device times (m,), and the gap (9,) over all of them."""
        times = self._clock.at_device(segment, time_s)
        if times is None:
            return  # of before a restart
        for group in GROUPS:
            for role, values in ((MEASURED, measured), (PREDICTED, predicted)):
                self._send(f"{group.entity}/{role}", times, values[:, group.columns] * group.per_si)
        if np.isfinite(gap).any():
            self._send(GAP, times[-1:], gap[None])

    def _send(self, entity: str, times: NDArray[np.int64], values: Array) -> None:
        column = rr.TimeColumn(DEVICE_TIME, duration=times.astype("timedelta64[ns]"))
        self._stream.send_columns(
            entity, indexes=[column], columns=rr.Scalars.columns(scalars=values), strict=True
        )


def _shade(color: tuple[int, int, int], role: str) -> tuple[int, int, int]:
    """What was measured is pale, what was predicted in full colour."""
    if role == PREDICTED:
        return color
    r, g, b = ((each + 2 * 255) // 3 for each in color)
    return r, g, b


SERVER_SILENT = 3
"""Exit status: the server does not answer. Starting another feeder would not help."""
FEED_FAILED = 4
"""Exit status: the server answers, but did not take the data."""

ANSWER_S = 1.5
"""With ``IDLE_S`` and a flush less than ``viewer.SILENCE_S``: the feeder reports, the daemon need
not guess."""
CHECK_S = 1.0
START_S = 10.0
IDLE_S = 0.5
_HTTP2_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])


Address = tuple[str, int]


def main(arguments: list[str]) -> NoReturn:
    descriptor, address, port, recording, layout = arguments
    channel = socket.socket(fileno=int(descriptor))
    stream = rr.RecordingStream(APPLICATION, recording_id=recording)
    status = _run(channel, stream, (address, int(port)), recording, layout)
    # At once: a stream that is released, or a normal exit, waits for ever for a server that does
    # not take the data.
    sys.stderr.flush()
    os._exit(status)


def _run(
    channel: socket.socket, stream: rr.RecordingStream, server: Address, recording: str, layout: str
) -> int:
    twin, tables = ("twin" in layout), ("tables" in layout)
    if not _server_starts(server):
        return SERVER_SILENT
    stream.connect_grpc(
        f"rerun+http://{server[0]}:{server[1]}/proxy",
        default_blueprint=pilot_blueprint(window_s=LIVE_WINDOW_S, twin=twin, tables=tables),
    )
    stream.send_recording_name(recording)
    clock = LiveClock()
    log = ViewerLog(stream, clock)
    beside = TwinLog(stream, clock)
    try:
        log.craft()
        if twin:
            beside.names()
        stream.flush(timeout_sec=ANSWER_S)
        channel.send(encode_message(Acknowledgement(0)))
        return _feed(channel, stream, log, beside, server)
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return FEED_FAILED if _server_answers(server) else SERVER_SILENT
    except RuntimeError as error:
        # it takes no data: of rerun 0.41 one viewer that does not read holds up all (the relay
        # drops browsers that do, and cannot see it of native viewers)
        print(f"the rerun server takes no data ({error}); reload the viewers", file=sys.stderr)
        return SERVER_SILENT


def _server_answers(server: Address) -> bool:
    """Whether the gRPC server replies; a stopped process accepts connections and says nothing."""
    try:
        with socket.create_connection(server, ANSWER_S) as connection:
            connection.sendall(_HTTP2_PREFACE)
            return bool(connection.recv(1))
    except OSError:
        return False


def _server_starts(server: Address) -> bool:
    """Wait until the server listens, then for an answer."""
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline:
        with contextlib.suppress(ConnectionRefusedError):
            socket.create_connection(server, ANSWER_S).close()
            return _server_answers(server)
        time.sleep(0.02)
    return False


def _feed(
    channel: socket.socket,
    stream: rr.RecordingStream,
    log: ViewerLog,
    beside: TwinLog,
    server: Address,
) -> int:
    """Log messages until the daemon closes the socket."""
    taken = 0
    next_check = time.monotonic() + CHECK_S
    while True:
        readable, _, _ = select.select([channel], [], [], IDLE_S)
        if readable:
            data = channel.recv(MAX_BYTES)
            if not data:
                stream.flush(timeout_sec=0.5)
                return 0
            rows = 1
            match decode_message(data):
                case "samples", content:
                    batch = samples_in(content)
                    log.samples(batch)
                    rows = len(batch)
                case "event", content:
                    log.entries(EVENTS, [content])
                case "statistics", content:
                    log.statistics([content])
                case "table", content:
                    times_ns = unpacked(content["times_ns"])
                    for column, values in content["columns"].items():
                        log.series([content["name"], column], times_ns, unpacked(values))
                case "twin", content:
                    beside.show(content["segment"], *predictions_in(content))
            taken += rows
        if time.monotonic() >= next_check:
            # flush() alone finds a stopped server only when megabytes have piled up
            if not _server_answers(server):
                return SERVER_SILENT
            stream.flush(timeout_sec=0.5)
            next_check = time.monotonic() + CHECK_S
        with contextlib.suppress(BlockingIOError):
            channel.send(encode_message(Acknowledgement(taken)), socket.MSG_DONTWAIT)


if __name__ == "__main__":
    main(sys.argv[1:])
