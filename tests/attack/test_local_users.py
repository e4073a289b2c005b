"""Another user of the machine who was here first: false sockets, links, lock files, ports."""

import os
import subprocess
import sys

import pytest

from groundstation.errors import BadInputError, GroundStationError
from groundstation.service import client
from groundstation.service.client import ask
from groundstation.service.config import ControlSocket
from groundstation.service.control import permitted_link
from support.daemons import in_process
from support.programs import Program, free_port

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


def test_a_log_file_says_where_the_page_is_and_lets_nobody_in(tmp_path):
    address = f"http://127.0.0.1:{free_port()}"
    port = f"page.port={address.rpartition(':')[2]}"
    options = ("--page", "--no-record", "--for", 0, "--set", port)
    ended = in_process("run", *options, socket_path=tmp_path / "control.sock", cwd=tmp_path)
    said = ended.stdout + ended.stderr
    assert f"page       {address}\n" in said
    assert "groundstation page" in said
    assert "token" not in said
