"""Another user of the machine who was here first: false sockets, links, lock files, ports."""

import asyncio
import contextlib
import http.client
import os
import socket
import subprocess
import sys
import time

import pytest

from groundstation.errors import BadInputError, GroundStationError
from groundstation.service import client, control
from groundstation.service.api import permitted_link
from groundstation.service.client import ask
from groundstation.service.config import Config, LinkConfig, RecordingConfig
from groundstation.service.control import ControlServer
from groundstation.service.control_socket import ControlPort, ControlSocket
from groundstation.service.station import Station
from support.programs import Program

pytestmark = pytest.mark.timeout(60)


@pytest.mark.skipif(os.getuid() != 0, reason="becoming another user needs root")
def test_a_client_believes_no_socket_of_another_user(tmp_path, monkeypatch):
    folder = tmp_path / "shared"
    folder.mkdir()
    folder.chmod(0o777)
    for parent in folder.parents:
        if parent.is_relative_to("/tmp") and parent != parent.parent:
            parent.chmod(parent.stat().st_mode | 0o711)
    code = (
        "import os, socket, sys\n"
        "os.setgroups([]); os.setgid(65534); os.setuid(65534)\n"
        "s = socket.socket(socket.AF_UNIX); s.bind(sys.argv[1]); s.listen()\n"
        "os.chmod(sys.argv[1], 0o777); print('ready', flush=True)\n"
        "c, _ = s.accept(); c.recv(1000)\n"
        "c.sendall(b'HTTP/1.1 200 OK\\r\\nContent-Length: 2\\r\\n\\r\\n{}'); c.recv(1)\n"
    )
    path = folder / "control.sock"
    monkeypatch.setattr(client, "shared_folder", lambda: folder)
    with Program([sys.executable, "-c", code, path], stdout=subprocess.PIPE) as impostor:
        assert impostor.stdout.readline()
        with pytest.raises(GroundStationError, match="belongs to user 65534"):
            ask(path, "GET", "/status")


def test_a_lock_file_is_never_somebody_elses(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("4711")  # as a lock file holds
    (tmp_path / "a.lock").symlink_to(victim)
    (tmp_path / "b.lock").write_text("precious too")
    os.mkfifo(tmp_path / "c.lock")
    for name in "abc":
        with pytest.raises(GroundStationError):
            ControlSocket(tmp_path / f"{name}.sock")
    assert victim.read_text() == "4711"
    assert (tmp_path / "b.lock").read_text() == "precious too"
    for _ in range(2):  # one that a daemon left behind is no hindrance
        ControlSocket(tmp_path / "d.sock").close()


@pytest.mark.parametrize("speed", ["", "@115200"])
def test_a_request_reaches_no_port_by_way_of_a_folder_for_all(tmp_path, speed):
    link = f"/dev/shm/groundstation-attack-{os.getpid()}"
    os.symlink(tmp_path / "elsewhere", link)
    try:
        for name in (link, "/dev/../" + link, "/dev/shm/regular", "/proc/self/root" + link):
            with pytest.raises(BadInputError, match="not a device in /dev"):
                permitted_link(f"serial:{name}{speed}", tmp_path)
    finally:
        os.unlink(link)
    assert permitted_link(f"serial:/dev/ttyACM0{speed}", tmp_path) == f"serial:/dev/ttyACM0{speed}"


@pytest.fixture
def ported(tmp_path):
    """Runs a conversation with the TCP port of a daemon that waits for a device."""

    def run(conversation):
        async def session():
            config = Config(
                link=LinkConfig(name="serial:/dev/nope"),
                recording=RecordingConfig(folder=str(tmp_path / "s"), enabled=False),
            )
            station = Station(config)
            control = ControlSocket(tmp_path / "c.sock")
            port = ControlPort(0, tmp_path / "c.token")
            server = ControlServer(station, control, port)
            await server.start()
            running = asyncio.create_task(station.run())
            try:
                await station.receiver.tried.wait()
                return await asyncio.to_thread(conversation, station, port)
            finally:
                station.stop()
                await running
                await server.stop()
                port.close()
                control.close()

        return asyncio.run(session())

    return run


def request(peer, token):
    """One request with a token on a connection: its status."""
    peer.request("GET", "/status", headers={"Authorization": f"Bearer {token}"})
    with peer.getresponse() as response:
        response.read()
        return response.status


def test_an_answer_on_the_port_is_sent_at_once(ported):
    def conversation(station, port):
        peer = http.client.HTTPConnection("127.0.0.1", port.port, timeout=10)
        with contextlib.closing(peer):
            took = []
            for _ in range(12):
                began_s = time.monotonic()
                assert request(peer, port.token) == 200
                took.append(time.monotonic() - began_s)
            return min(took[2:])

    assert ported(conversation) < 0.03


def strangers(port, count, words):
    """Connections without a token, left open."""
    peers = [socket.create_connection(("127.0.0.1", port.port), 10) for _ in range(count)]
    for peer in peers:
        with contextlib.suppress(OSError):
            peer.sendall(words)
    return peers


@pytest.mark.parametrize(
    "words",
    [b"", b"GET /status HTTP/1.1\r\nHost:", b"GET /status HTTP/1.1\r\nHost: x\r\n\r\n"],
    ids=["silent", "half a request", "no token"],
)
def test_strangers_cannot_keep_the_authorised_from_the_port(ported, words):
    def conversation(station, port):
        peers = []
        answers = []
        for _ in range(2):
            peers += strangers(port, 70, words)
            peer = http.client.HTTPConnection("127.0.0.1", port.port, timeout=10)
            with contextlib.closing(peer):
                answers.append(request(peer, port.token))
        for peer in peers:
            peer.close()
        return answers, station.turned_away

    answers, turned_away = ported(conversation)
    assert answers == [200] * 2
    assert turned_away > 0


def test_guessing_is_counted_and_slow(ported, monkeypatch):
    monkeypatch.setattr(control, "FAILURES_BURST", 3.0)
    monkeypatch.setattr(control, "FAILURES_HZ", 0.1)
    monkeypatch.setattr(control, "FAILURE_S", 0.2)

    def guess(port):
        peer = http.client.HTTPConnection("127.0.0.1", port.port, timeout=10)
        with contextlib.closing(peer):
            return request(peer, "wrong")

    def conversation(station, port):
        began_s = time.monotonic()
        answers = [guess(port) for _ in range(8)]
        return answers, time.monotonic() - began_s, station.turned_away

    answers, took_s, turned_away = ported(conversation)
    assert answers == [401] * 8
    assert took_s >= 5 * 0.2
    assert turned_away == 8
