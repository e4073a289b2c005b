"""The relay before the rerun server: what it knows of viewers."""

import asyncio
import socket

from groundstation.viewer.relay import Relay, _Progress
from support.waiting import eventually

PIECE = bytes(20_000)


def test_the_age_of_the_oldest_byte_that_was_not_read_is_never_told_too_small():
    progress = _Progress()
    progress._looked_s = 100.0
    assert progress.behind_s(100.5, 0) == 0.0
    progress.written = 1000
    assert progress.behind_s(101.0, 1000) == 0.5  # it may have come just after the last look
    progress.written = 3000
    assert progress.behind_s(101.5, 2500) == 1.0
    assert progress.behind_s(102.0, 2000) == 1.0  # the first thousand is read
    assert progress.behind_s(102.5, 0) == 0.0


async def test_a_viewer_that_reads_nothing_is_behind_and_one_that_catches_up_is_live():
    async def upstream(reader, writer):
        await reader.readuntil(b"\r\n\r\n")
        try:
            while not (writer.is_closing() or ended.is_set()):
                writer.write(PIECE)
                await asyncio.sleep(0.05)
        finally:
            writer.transport.abort()
            gone.set()

    ended, gone = asyncio.Event(), asyncio.Event()

    there = await asyncio.start_server(upstream, "127.0.0.1", 0)
    listening = socket.create_server(("127.0.0.1", 0))
    port = listening.getsockname()[1]
    relay = Relay(port, there.sockets[0].getsockname(), [])
    server = await asyncio.start_server(relay.serve, sock=listening)
    watching = asyncio.create_task(relay.watch())
    loop = asyncio.get_running_loop()
    with socket.create_connection(("127.0.0.1", port)) as viewer:
        viewer.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
        viewer.setblocking(False)
        await eventually(lambda: relay.viewers == 1)
        began_s = loop.time()
        # what it has not read waits in the kernel: nothing of it in the relay
        await eventually(lambda: relay.behind_s >= 2.0)
        assert relay.behind_s <= loop.time() - began_s + 1.5

        async def read():
            while True:
                await loop.sock_recv(viewer, 1 << 20)

        reading = asyncio.create_task(read())
        await eventually(lambda: relay.behind_s <= 0.5)
        reading.cancel()
    await eventually(lambda: relay.viewers == 0)
    ended.set()
    await gone.wait()
    watching.cancel()
    server.close()
    there.close()
