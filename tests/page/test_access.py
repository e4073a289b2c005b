"""Who is not let in: without the cookie, with a wrong one, from another site, by another name."""

import http.client
import os
import re
import socket
import stat
from contextlib import ExitStack
from urllib.parse import urlsplit

import pytest

from groundstation.page.__main__ import CONNECTIONS_MOST


def request(daemon, method, route, headers=(), body=None):
    """Status, headers and text of an answer; ``Host`` as given, else the page's own."""
    connection = http.client.HTTPConnection("127.0.0.1", daemon.port, timeout=60)
    try:
        connection.request(method, route, body, dict(headers))
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read().decode()
    finally:
        connection.close()


@pytest.fixture(scope="module")
def cookie(flying):
    """Of a browser that was let in."""
    return let_in(flying)


def let_in(daemon):
    route = daemon.address().removeprefix(f"http://127.0.0.1:{daemon.port}")
    status, headers, _ = request(daemon, "GET", route)
    assert (status, headers["Location"]) == (303, "/")
    assert "HttpOnly" in headers["Set-Cookie"]
    assert "samesite=strict" in headers["Set-Cookie"].lower()
    return headers["Set-Cookie"].partition(";")[0]


@pytest.fixture(scope="module")
def marking(flying, cookie):
    """Headers with which the page itself asks for a change."""
    _, _, document = request(flying, "GET", "/", {"Cookie": cookie})
    (token,) = re.findall(r'name="change-token" content="(\w+)"', document)
    return {
        "Cookie": cookie,
        "X-Change-Token": token,
        "Origin": f"http://127.0.0.1:{flying.port}",
    }


ROUTES = [
    "/",
    "/now",
    "/flights",
    "/help/",
    "/file/recording/x",
    "/page.js",
    "/page.css",
    "/do/record/stop",
    "/nothing",
]


@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_without_a_cookie_nothing_is_told(flying, method, route):
    status, _, text = request(flying, method, route)
    assert status == 401
    assert "stand-in" not in text


def test_a_wrong_token_or_cookie_is_refused(flying, cookie):
    assert request(flying, "GET", "/?token=guessed")[0] == 403
    name, _, value = cookie.partition("=")
    for forged in ("", "x", "x.", f"x{value}", f"{value}0", value.replace(".", ".0")):
        assert request(flying, "GET", "/now", {"Cookie": f"{name}={forged}"})[0] == 401
    assert request(flying, "GET", "/now", {"Cookie": cookie})[0] == 200


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1", "[::1]:1"])
def test_another_name_for_this_machine_is_refused(flying, cookie, host):
    """A page whose name server points at 127.0.0.1 has our address and not our name."""
    headers = {"Host": host.format(port=flying.port), "Cookie": cookie}
    for route in ("/", "/now", urlsplit(flying.address()).query.join(("/?", ""))):
        assert request(flying, "GET", route, headers)[0] == 403


def test_a_change_needs_the_page_s_own_origin_and_token(flying, marking):
    def mark(without=(), **changed):
        headers = {key: value for key, value in marking.items() if key not in without}
        headers |= {key.replace("_", "-"): value for key, value in changed.items()}
        return request(flying, "POST", "/do/record/mark", headers, '{"text": "who?"}')[0]

    assert mark() == 200
    assert mark(without=["Origin"]) == 403
    assert mark(without=["X-Change-Token"]) == 403
    assert mark(without=["Cookie"]) == 401
    assert mark(Origin="null") == 403
    assert mark(Origin="http://evil.example") == 403
    assert mark(Origin=f"http://127.0.0.1:{flying.port + 1}") == 403
    assert mark(Origin=f"https://127.0.0.1:{flying.port}") == 403
    assert mark(X_Change_Token="0" * 64) == 403
    assert mark(Cookie=let_in(flying)) == 403  # the token belongs to another browser


def test_only_what_the_page_offers_can_be_asked(flying, marking):
    for route in ("/do/command/acquire", "/do/page/address", "/do/../status"):
        assert request(flying, "POST", route, marking, "{}")[0] == 404
    refused = request(flying, "POST", "/do/record/mark", marking, '{"text": ""}')
    assert refused[0] == 400
    assert request(flying, "POST", "/do/record/mark", marking, "[" * 100)[0] == 400
    assert request(flying, "POST", "/do/record/mark", marking, " " * 70_000)[0] == 413


def test_only_files_that_the_daemon_lists_are_given_out(flying, cookie):
    for route in (
        "/file/recording/control.page",
        "/file/recording/..%2Fcontrol.page",
        "/file/recording/%2Fetc%2Fpasswd",
        "/file/report/..",
        "/file/log/..%2F..",
        "/file/model/nothing",
        "/file/key/x",
        "/page.html",
    ):
        assert request(flying, "GET", route, {"Cookie": cookie})[0] == 404


def test_a_browser_is_told_to_trust_nothing_else(flying, cookie):
    for route in ("/", "/now", "/page.js"):
        _, headers, _ = request(flying, "GET", route, {"Cookie": cookie})
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Cache-Control"] == "no-store"


def test_only_the_owner_can_read_the_key(flying):
    key = flying.socket.with_suffix(".page")
    assert stat.S_IMODE(key.stat().st_mode) == 0o600
    assert key.stat().st_uid == os.getuid()
    for line in flying.page_process().cmdline():
        assert key.read_text().strip() not in line


def test_the_page_is_reached_from_this_machine_only(flying):
    listening = [one for one in flying.page_process().net_connections() if one.status == "LISTEN"]
    assert {one.laddr.ip for one in listening} == {"127.0.0.1"}


def test_who_was_let_in_is_heard_by_a_page_that_was_held_up_while_strangers_came(flying, cookie):
    process = flying.page_process()
    with ExitStack() as open_ones:
        connect = lambda: open_ones.enter_context(  # noqa: E731
            socket.create_connection(("127.0.0.1", flying.port), 60)
        )
        process.suspend()
        try:
            asking = connect()
            head = f"GET /now HTTP/1.1\r\nHost: 127.0.0.1:{flying.port}\r\nCookie: {cookie}\r\n\r\n"
            asking.sendall(head.encode())
            for _ in range(CONNECTIONS_MOST + 30):
                connect()
        finally:
            process.resume()
        assert asking.recv(12) == b"HTTP/1.1 200"
