"""Viewers that stall, come by the dozen, or are pages of a stranger: nobody else's view suffers."""

import asyncio
import contextlib
import http.client
import os
import socket
import sys
import threading

import pytest

from groundstation.viewer import relay
from groundstation.viewer.relay import Relay
from support.programs import run_program
from support.waiting import PATIENCE_S, eventually

pytestmark = pytest.mark.timeout(60)
PIECE = b"telemetry " * 10_000


class Flood:
    """Stands for the rerun server: answers every request with data until the reader leaves."""

    def __init__(self):
        self.requests = []
        self.readers = 0

    async def serve(self, reader, writer):
        self.readers += 1
        self.requests.append(await reader.read(4096))
        writer.write(b"HTTP/1.1 200 OK\r\n\r\n")
        with contextlib.suppress(ConnectionError):
            while True:
                writer.write(PIECE)
                await writer.drain()
                await asyncio.sleep(0.002)
        writer.transport.abort()
        self.readers -= 1


@contextlib.asynccontextmanager
async def relayed():
    """A relay before a flood: its port, and what came through to the flood."""
    flood = Flood()
    beyond = await asyncio.start_server(flood.serve, "127.0.0.1", 0)
    listening = socket.create_server(("127.0.0.1", 0))
    port = listening.getsockname()[1]
    one = Relay(port, beyond.sockets[0].getsockname(), ["http://127.0.0.1:9090"])
    server = await asyncio.start_server(one.serve, sock=listening)
    watching = asyncio.create_task(one.watch())
    try:
        yield port, flood
    finally:
        await eventually(lambda: not (one._clients or flood.readers), "the last client's end")
        watching.cancel()
        server.close()
        beyond.close()


async def ask(port, *lines, host="127.0.0.1"):
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    head = [f"POST /read HTTP/1.1\r\nHost: {host}:{port}", *lines, "\r\n"]
    writer.write("\r\n".join(head).encode())
    return reader, writer


def stalled(port):
    """A browser tab that sleeps: asked, and reads nothing."""
    peer = socket.socket()
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    peer.connect(("127.0.0.1", port))
    peer.sendall(f"POST /read HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
    return peer


@pytest.mark.parametrize("sleepers", [1, 20])
def test_viewers_that_sleep_are_dropped_and_told_and_nobody_waits(sleepers, capfd, monkeypatch):
    monkeypatch.setattr(relay, "STALL_S", 1.0)
    monkeypatch.setattr(relay, "WAITING_MOST", 1 << 40)  # the clock tells, not what waits

    async def session():
        async with relayed() as (port, _):
            sleeping = [stalled(port) for _ in range(sleepers)]
            reader, writer = await ask(port)
            reads, said = 0, ""
            while "dropped" not in said:
                async with asyncio.timeout(PATIENCE_S):
                    assert await reader.read(1 << 16)
                said += capfd.readouterr().err
                reads += 1
            writer.close()
            for peer in sleeping:
                peer.close()
            return reads, said

    reads, said = asyncio.run(session())
    assert reads > 10, "the others read on while it sleeps"
    assert "a viewer was dropped: it took nothing" in said


@pytest.mark.parametrize(
    ("host", "line", "admitted"),
    [
        ("127.0.0.1", "Origin: http://127.0.0.1:9090", True),
        ("localhost", "Accept: */*", True),
        ("127.0.0.1", "Origin: http://evil.example", False),
        ("127.0.0.1", "Origin: null", False),
        ("evil.example", "Accept: */*", False),
        ("127.0.0.1", "Host: evil.example", False),
    ],
)
def test_a_page_of_a_stranger_is_refused(host, line, admitted, capfd):
    async def session():
        async with relayed() as (port, flood):
            reader, writer = await ask(port, line, host=host)
            status = await reader.readline()
            writer.close()
            return status, flood.requests

    status, requests = asyncio.run(session())
    assert (b" 200 " in status, b" 403 " in status) == (admitted, not admitted)
    assert len(requests) == admitted
    assert all(b"\r\nConnection: close\r\n" in head for head in requests)
    assert ("refused" in capfd.readouterr().err) == (not admitted)


ASK = """
import os, socket, sys
"here".encode("idna")  # the library may be out of reach below
os.setgroups([]); os.setgid(65534); os.setuid(65534)
peer = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
try:
    peer.sendall(sys.argv[2].encode().replace(b"|", b"\\r\\n"))
    print(peer.recv(100))
except ConnectionError:
    print(b"")
"""


@pytest.mark.skipif(os.getuid() != 0, reason="becoming another user needs root")
@pytest.mark.parametrize(
    "said", ["POST /read HTTP/1.1|Host: 127.0.0.1:{port}||", "PRI * HTTP/2.0||SM||"]
)
def test_another_user_of_the_machine_neither_sees_nor_writes_into_the_picture(said, capfd):
    async def session():
        async with relayed() as (port, flood):
            words = [sys.executable, "-c", ASK, str(port), said.replace("{port}", str(port))]
            got = await asyncio.to_thread(run_program, words, check=True)
            reader, writer = await ask(port)  # ours is served as before
            assert b" 200 " in await reader.readline()
            writer.close()
            return got.stdout, flood.requests

    got, requests = asyncio.run(session())
    assert got == "b''\n"
    assert len(requests) == 1
    assert "a program of user 65534 asked for the live view and was refused" in (
        capfd.readouterr().err
    )


def test_half_a_request_is_not_waited_for_for_ever(monkeypatch):
    monkeypatch.setattr(relay, "HEAD_S", 0.2)

    async def session():
        async with relayed() as (port, flood):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(b"POST /read HTTP/1.1\r\nHost:")
            with contextlib.suppress(ConnectionError):
                assert await reader.read() == b""
            writer.close()
            return flood.requests

    assert asyncio.run(session()) == []


@contextlib.asynccontextmanager
async def real_view(**options):
    """The real server behind its relay: (viewer, its port, that of its page)."""
    from groundstation.viewer.child import free_port
    from groundstation.viewer.viewer import Viewer, ViewerMode

    port, web_port = free_port("127.0.0.1"), free_port("127.0.0.1")
    viewer = Viewer(ViewerMode.SERVE, port=port, web_port=web_port, **options)
    await viewer.start()
    try:
        await eventually(lambda: viewer.status()["state"] == "serving", "the viewer")
        yield viewer, port, web_port
    finally:
        await viewer.stop()


def test_the_real_view_is_served_through_the_relay_alone():
    async def session():
        async with real_view() as (_, port, web_port):
            return await asyncio.to_thread(look, port, web_port)

    def status(port, origin, method="GET", path="/"):
        peer = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        with contextlib.closing(peer):
            body = b"\0\0\0\0\0" if method == "POST" else None
            kind = {"Content-Type": "application/grpc-web+proto"} if body else {}
            peer.request(method, path, body, headers={"Origin": origin, **kind})
            return peer.getresponse().status

    def look(port, web_port):
        ours = f"http://127.0.0.1:{web_port}"
        read = ("POST", "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages")
        return [
            status(web_port, ours), status(port, ours, *read), status(port, "http://evil", *read)
        ]  # fmt: skip

    assert asyncio.run(session()) == [200, 200, 403]


def native(port):
    """The beginning of what a native viewer says: HTTP/2, and a request for all messages."""

    def frame(kind, flags, stream, body):
        head = len(body).to_bytes(3, "big") + bytes([kind, flags]) + stream.to_bytes(4, "big")
        return head + body

    def field(name, value):
        return bytes([*name, len(value)]) + value

    path = b"/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"
    head = b"\x83\x86" + field([0x04], path) + field([0x01], b"127.0.0.1")
    head += field([0x0F, 0x10], b"application/grpc") + field([0x00, 2, *b"te"], b"trailers")
    peer = socket.create_connection(("127.0.0.1", port), timeout=20)
    peer.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + frame(4, 0, 0, b""))
    peer.sendall(frame(1, 4, 1, head) + frame(0, 1, 1, bytes(5)))
    return peer


def exactly(peer, count):
    data = b""
    while len(data) < count:
        if not (part := peer.recv(count - len(data))):
            raise ConnectionResetError
        data += part
    return data


def answered(peer, ended):
    """A viewer that lives: reads frames and answers each ping, until ``ended`` or it is dropped;
    the kinds of the frames."""
    kinds = []
    while not ended.is_set():
        head = exactly(peer, 9)
        body = exactly(peer, int.from_bytes(head[:3], "big"))
        kinds.append(head[3])
        if head[3] == 6 and not head[4]:
            peer.sendall(head[:4] + b"\x01" + head[5:] + body)
    return kinds


def test_a_native_viewer_that_has_stopped_is_dropped_and_one_that_lives_is_not():
    """Through the real server: SIGSTOP, a hung connection, a laptop that was closed."""
    told, ended = [], threading.Event()

    async def session():
        async with real_view(on_event=lambda kind, text: told.append(text)) as (viewer, port, _):
            with native(port) as stopped, native(port) as living:
                reading = asyncio.create_task(asyncio.to_thread(answered, living, ended))
                await eventually(lambda: any("dropped" in text for text in told), "a dropped one")
                ended.set()
                kinds = await reading
                with pytest.raises(ConnectionResetError):
                    exactly(stopped, 1 << 30)
            return kinds, viewer.status()["restarts"]

    kinds, restarts = asyncio.run(session())
    assert [text for text in told if "dropped" in text] == [
        "a viewer was dropped: it does not answer; reload it"
    ]
    assert {0, 1, 6} <= set(kinds), "messages, their head, pings"
    assert 7 not in kinds, "the server never hangs up"
    assert restarts == 0


def test_a_server_that_takes_no_data_is_begun_anew_and_not_only_its_feed(monkeypatch, capsys):
    """What a native viewer that hangs does to rerun: it answers, and takes nothing more."""
    import rerun as rr

    from groundstation.viewer import feeder, viewer

    class Full(rr.RecordingStream):
        def connect_grpc(self, *_, **__):
            pass

        def flush(self, *_, **__):
            raise RuntimeError("Flush timed out - not all log messages were sent")

    monkeypatch.setattr(feeder, "_server_starts", lambda server: True)
    monkeypatch.setattr(feeder, "_server_answers", lambda server: True)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        stream = Full("test", recording_id="live")
        status = feeder._run(theirs, stream, ("127.0.0.1", 9), "live", "")
    assert status == viewer._SERVER_SILENT
    assert "takes no data" in capsys.readouterr().err
