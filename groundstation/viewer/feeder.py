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
from typing import NoReturn

import numpy as np
import rerun as rr

from groundstation.rerun_log.blueprint import LIVE_WINDOW_S, pilot_blueprint
from groundstation.rerun_log.channels import APPLICATION, EVENTS
from groundstation.rerun_log.device_clock import LiveClock
from groundstation.rerun_log.log import ViewerLog
from groundstation.viewer.messages import (
    MAX_BYTES,
    Acknowledgement,
    EventMessage,
    SamplesMessage,
    StatisticsMessage,
    TableMessage,
    TwinMessage,
    decode_message,
    encode_message,
)
from groundstation.viewer.twin_log import TwinLog

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
            match decode_message(data):
                case SamplesMessage() as message:
                    log.samples(message.batch())
                    taken += message.rows
                case EventMessage(entry):
                    log.entries(EVENTS, [entry])
                    taken += 1
                case StatisticsMessage(entry):
                    log.statistics([entry])
                    taken += 1
                case TableMessage() as message:
                    times_ns = np.frombuffer(message.times_ns, np.int64)
                    for column, values in message.columns.items():
                        log.series([message.name, column], times_ns, np.frombuffer(values))
                    taken += 1
                case TwinMessage() as message:
                    beside.show(message.segment, *message.arrays())
                    taken += 1
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
