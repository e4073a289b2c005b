"""The control API on a real socket, with a real station behind it."""

import os
import socket
import stat
import threading
from http.client import HTTPResponse

import pytest

from groundstation.errors import GroundStationError, TakenError
from groundstation.service.client import Client, ask
from groundstation.service.config import Config, ControlSocket, LinkConfig, RecordingConfig
from support import worlds


@pytest.fixture
def path(tmp_path):
    return tmp_path / "runtime" / "control.sock"


@pytest.fixture
def serve(tmp_path, path):
    """Runs a function against the API of a flying station, off its loop; what it gave."""

    config = Config(
        link=LinkConfig(name="stand-in"),
        recording=RecordingConfig(folder=str(tmp_path / "sessions"), enabled=False),
    )
    return lambda conversation: worlds.serve(config, path, lambda _: conversation())


def test_the_socket_and_its_folder_are_its_owners_alone(path):
    before = os.umask(0)
    try:
        control = ControlSocket(path)
    finally:
        assert os.umask(before) == 0, "the mask of the process is left as it was"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    control.close()
    assert not path.exists()


def test_a_socket_that_is_held_is_named_with_its_holder(path):
    control = ControlSocket(path)
    with pytest.raises(TakenError, match=rf"{path} is taken .*process {os.getpid()}\)"):
        ControlSocket(path)
    assert path.exists()
    control.close()
    ControlSocket(path).close()


def test_a_socket_left_behind_is_replaced(path):
    path.parent.mkdir()
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    assert path.exists()
    ControlSocket(path).close()


def test_a_file_that_is_no_socket_is_left_alone(path):
    path.parent.mkdir()
    path.write_text("precious")
    with pytest.raises(GroundStationError, match="is not a socket"):
        ControlSocket(path)
    assert path.read_text() == "precious"


def test_a_path_too_long_for_a_socket_is_refused_with_what_to_do(tmp_path):
    with pytest.raises(GroundStationError, match="GROUNDSTATION_SOCKET"):
        ControlSocket(tmp_path / ("long" * 40))


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "occupied").write_text("a file")
    with pytest.raises(GroundStationError, match="occupied"):
        ControlSocket(tmp_path / "occupied" / "control.sock")


def test_every_route_answers(serve, path):
    def conversation():
        started = ask(path, "POST", "/record/start")
        stopped = ask(path, "POST", "/record/stop")
        return ask(path, "GET", "/status"), ask(path, "GET", "/events"), started, stopped

    status, events, started, stopped = serve(conversation)
    assert status["link"]["name"] == "stand-in"
    assert status["recording"]["file"] == started["file"] == stopped["file"]
    assert (started["state"], stopped["state"]) == ("recording", "finished")
    kinds = [event["kind"] for event in events]
    assert kinds[0] == "opening"
    assert kinds.count("recording") == 2


def test_a_refusal_reaches_the_one_who_asked(serve, path):
    def conversation():
        with pytest.raises(GroundStationError, match="nothing is being recorded"):
            ask(path, "POST", "/record/stop")
        ask(path, "POST", "/record/start")
        with pytest.raises(GroundStationError, match="already recording"):
            ask(path, "POST", "/record/start")
        return ask(path, "GET", "/status")["recording"]["state"]

    assert serve(conversation) == "recording"


@pytest.mark.parametrize(
    ("method", "route", "says"),
    [
        ("GET", "/nowhere", "Not Found"),
        ("GET", "/record/start", "Method Not Allowed"),
        ("POST", "/status", "Method Not Allowed"),
    ],
)
def test_what_does_not_exist_is_an_error_in_one_line(serve, path, method, route, says):
    def conversation():
        with pytest.raises(GroundStationError) as refused:
            ask(path, method, route)
        return str(refused.value)

    assert serve(conversation) == f"{method} {route}: {says}; see GET /openapi.json"


def test_many_askers_at_once_all_get_an_answer(serve, path):
    def conversation():
        answers = []
        askers = [
            threading.Thread(target=lambda: answers.append(ask(path, "GET", "/status")))
            for _ in range(12)
        ]
        for asker in askers:
            asker.start()
        for asker in askers:
            asker.join()
        return answers

    assert len(serve(conversation)) == 12


def test_a_peer_that_hangs_up_early_or_talks_nonsense_hurts_nobody(serve, path):
    def conversation():
        for words in (b"", b"GET /stat", b"\x00\xff\x13\x37\r\n\r\n"):
            with socket.socket(socket.AF_UNIX) as peer:
                peer.connect(str(path))
                peer.sendall(words)
        return ask(path, "GET", "/status")["link"]["name"]

    assert serve(conversation) == "stand-in"


def test_without_a_daemon_the_asker_is_told_how_to_start_one(path):
    with pytest.raises(GroundStationError, match="start one with 'groundstation run'"):
        ask(path, "GET", "/status")
    path.parent.mkdir()
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    with pytest.raises(GroundStationError, match="no groundstation is running"):
        ask(path, "GET", "/status")


def test_ctrl_c_that_comes_while_an_answer_is_closed_is_not_dropped(serve, path, monkeypatch):
    """Python drops what a stream's finaliser raises: a motor bench would not hear it."""

    def interrupted(response):
        monkeypatch.undo()
        raise KeyboardInterrupt

    def conversation():
        with Client(path) as client:
            client.ask("GET", "/status")
            monkeypatch.setattr(HTTPResponse, "close", interrupted)
            with pytest.raises(KeyboardInterrupt):
                client.ask("GET", "/status")

    serve(conversation)


def test_what_a_web_page_asks_is_refused_though_a_port_leads_here(serve, path):
    def conversation():
        with socket.socket(socket.AF_UNIX) as asking:
            asking.settimeout(20)
            asking.connect(str(path))
            asking.sendall(
                b"POST /command/stop HTTP/1.1\r\nHost: 127.0.0.1:8000\r\n"
                b"Origin: https://elsewhere.example\r\nContent-Length: 0\r\n\r\n"
            )
            answer = HTTPResponse(asking)
            answer.begin()
            return answer.status, answer.read()

    status, text = serve(conversation)
    assert status == 403
    assert b"web pages" in text
