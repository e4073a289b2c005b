"""What the control API bears: strangers, floods, nonsense, clients that hang or never read."""

import os
import socket
import sys
import threading
import time

import psutil
import pytest

from groundstation.errors import GroundStationError
from groundstation.service import client as connections
from groundstation.service import control
from groundstation.service.client import Client, ask, live
from groundstation.service.config import Config, RecordingConfig
from groundstation.service.control import BODY_MOST
from groundstation.service.stream import CLIENTS_MOST, ROWS_MOST
from support.programs import run_program
from support.waiting import until


@pytest.fixture
def serve(tmp_path, path):
    """Runs a conversation against the API of a flying station."""
    from support.worlds import serve as serving

    config = Config(recording=RecordingConfig(folder=str(tmp_path / "sessions"), enabled=False))
    return lambda conversation: serving(config, path, conversation)


def connect(path):
    peer = socket.socket(socket.AF_UNIX)
    peer.settimeout(10)
    peer.connect(str(path))
    return peer


def answer(path, words):
    """What comes back for some bytes, until the daemon closes or is done."""
    with connect(path) as peer:
        peer.sendall(words)
        return peer.recv(65536)


def is_refused(client):
    try:
        client.ask("GET", "/status")
    except GroundStationError as error:
        return "requests a second" in str(error)
    return False


def held():
    """Descriptors, threads and memory. asyncio's pool of threads is bounded, and fills when it
    likes: its threads do not count."""
    process = psutil.Process()
    pool = sum(one.name.startswith("asyncio_") for one in threading.enumerate())
    return process.num_fds(), process.num_threads() - pool, process.memory_info().rss


@pytest.mark.skipif(os.getuid() != 0, reason="becoming another user needs root")
def test_another_user_cannot_reach_the_socket(serve, path):
    code = (
        "import os, socket, sys\n"
        "os.setgroups([]); os.setgid(65534); os.setuid(65534)\n"
        "try: socket.socket(socket.AF_UNIX).connect(sys.argv[1])\n"
        "except PermissionError: print('refused')\n"
    )
    for folder in path.parents:
        if folder.is_relative_to("/tmp") and folder != folder.parent:
            folder.chmod(folder.stat().st_mode | 0o711)  # so that the socket alone refuses

    def conversation(station):
        return run_program([sys.executable, "-c", code, str(path)])

    result = serve(conversation)
    assert result.stdout == "refused\n", result.stderr


def test_a_request_that_is_too_large_is_refused(serve, path):
    def conversation(station):
        with pytest.raises(GroundStationError, match=f"longer than {BODY_MOST} bytes"):
            ask(path, "POST", "/record/mark", {"text": "x" * BODY_MOST})
        with pytest.raises(GroundStationError, match="text"):
            ask(path, "POST", "/record/mark", {"text": "x" * 2000})
        head = b"GET /status HTTP/1.1\r\nHost: x\r\nX: " + b"y" * connections.HEAD_MOST * 2
        assert answer(path, head).startswith(b"HTTP/1.1 400")
        return ask(path, "GET", "/status")["faults"]

    assert serve(conversation) == 0


def test_a_flood_is_refused_and_soon_over(serve, path, monkeypatch):
    monkeypatch.setattr(control, "REQUESTS_BURST", 30.0)
    monkeypatch.setattr(control, "REQUESTS_HZ", 5.0)

    def conversation(station):
        refused = 0
        with Client(path) as client:
            for _ in range(80):
                refused += is_refused(client)
            time.sleep(0.4)
            client.ask("GET", "/status")
        return refused

    assert serve(conversation) > 20


def test_one_who_never_finishes_a_request_is_cut_off(serve, path, monkeypatch):
    monkeypatch.setattr(connections, "REQUEST_S", 0.3)

    def conversation(station):
        for words in (b"", b"GET /status HTTP/1.1\r\nHost", b"POST /link HTTP/1.1\r\n"
                      b"Host: x\r\nContent-Length: 100\r\n\r\n{"):  # fmt: skip
            assert answer(path, words) == b""

    serve(conversation)


def test_there_is_a_limit_to_connections_and_room_afterwards(serve, path, monkeypatch):
    monkeypatch.setattr(control, "CONNECTIONS_MOST", 5)

    def conversation(station):
        silent = [connect(path) for _ in range(8)]
        assert ask(path, "GET", "/status")["link"]["name"] == "stand-in", "they make room"
        peers = [connect(path) for _ in range(5)]
        for peer in peers:
            peer.sendall(b"GET /stream HTTP/1.1\r\nHost: x\r\n\r\n")
        until(lambda: len(station.stream) == 5, "all five hold a place")
        for one in silent:
            one.close()
        with pytest.raises(GroundStationError, match=r"503|reset|closed|Broken"):
            ask(path, "GET", "/status")
        for peer in peers:
            peer.close()
        time.sleep(0.2)
        return ask(path, "GET", "/status")["link"]["name"]

    assert serve(conversation) == "stand-in"


def test_a_stream_client_that_never_reads_costs_its_own_data_only(serve, path, monkeypatch):
    monkeypatch.setattr(connections, "STALL_S", 1.0)

    def conversation(station):
        deaf = connect(path)
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.sendall(b"GET /stream HTTP/1.1\r\nHost: x\r\n\r\n")
        until(lambda: len(station.stream) == 1, "it is subscribed")
        (subscriber,) = station.stream._subscribers
        before = until(lambda: ask(path, "GET", "/status")["statistics"], "statistics")
        until(lambda: len(station.stream) == 0, "it is cut off")
        assert subscriber._rows <= ROWS_MOST
        deaf.close()
        after = until(
            lambda: (
                (now := ask(path, "GET", "/status")["statistics"])["samples"] > before["samples"]
                and now
            ),
            "more samples",
        )
        assert after["lost"] == before["lost"] == 0

    serve(conversation)


def test_a_slow_stream_client_loses_the_oldest_and_is_told_how_much(serve, path):
    def conversation(station):
        slow = live(path)
        next(slow)
        batch = station.newest.batch
        for _ in range(3 * ROWS_MOST // len(batch)):
            station._loop.call_soon_threadsafe(station.stream.samples, batch)
        until(lambda: station.stream.dropped > 0, "something is dropped")
        slow.close()
        for kind, content in live(path):
            if kind == "samples":
                return content["dropped"], station.stream.dropped
        return None

    fresh, all_of_them = serve(conversation)
    assert fresh == 0
    assert all_of_them > ROWS_MOST


def test_only_so_many_can_listen(serve, path):
    def conversation(station):
        streams = [live(path) for _ in range(CLIENTS_MOST)]
        for stream in streams:
            next(stream)
        with pytest.raises(GroundStationError, match="read the stream already"):
            next(live(path))
        for stream in streams:
            stream.close()
        until(lambda: len(station.stream) == 0, "they have left")

    serve(conversation)


def test_thousands_of_malformed_requests_leave_memory_and_descriptors_flat(serve, path):
    nonsense = (
        b"",
        b"\x00\xff\x13\x37\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b'POST /link HTTP/1.1\r\nHost: x\r\nContent-Length: 7\r\n\r\n{"a":}}',
        b"POST /link HTTP/1.1\r\nHost: x\r\nContent-Length: -1\r\n\r\n",
        b"POST /record/mark HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
        b"POST /command/setpoint HTTP/1.1\r\nHost: x\r\nContent-Length: 2\r\n\r\n[]",
        b"GET /%00/../../etc/passwd HTTP/1.1\r\nHost: x\r\n\r\n",
        b"GET /status HTTP/1.1\r\nHost: x\r\n\r\n" * 20,
    )

    def attack(times):
        for number in range(times):
            try:
                with connect(path) as peer:
                    peer.sendall(nonsense[number % len(nonsense)])
                    if number % 3:
                        peer.shutdown(socket.SHUT_WR)
                        peer.recv(4096)
            except (ConnectionError, TimeoutError):
                pass

    def conversation(station):
        attack(600)
        time.sleep(0.3)
        before = held()
        attack(2400)
        until(lambda: held()[0] <= before[0] + 2, "descriptors are given back")
        after = held()
        grown = (after[2] - before[2]) / 1e6
        print(f"3000 malformed requests: {grown:+.1f} MB, descriptors {before[0]} -> {after[0]}")
        assert grown < 5
        assert after[1] <= before[1] + 1
        time.sleep(0.5)  # the flood has used up the rate of requests
        return ask(path, "GET", "/status")["faults"]

    assert serve(conversation) == 0
