"""Who is let in, without a browser: cookies, hosts, origins, one-time addresses."""

import asyncio
import socket

import pytest

from groundstation.errors import NotAuthorisedError
from groundstation.page.app import Access
from groundstation.service.config import PageConfig
from groundstation.service.page import PageService

PORT = 9080
OURS = Access(b"key", PORT)
ORIGIN, HOST = f"http://127.0.0.1:{PORT}", f"127.0.0.1:{PORT}"


def test_a_session_is_one_that_was_given_out_by_this_key():
    cookie = OURS.new_session()
    name, _, signature = cookie.partition(".")
    assert OURS.is_session(cookie)
    assert OURS.new_session() != cookie
    for forged in ("", ".", name, f"{name}.", f"{name}.{signature[:-1]}", f"other.{signature}"):
        assert not OURS.is_session(forged), forged
    assert not Access(b"another", PORT).is_session(cookie)
    assert not OURS.is_session(f"{name}.{OURS.change_token(name)}")  # signed for another purpose


@pytest.mark.parametrize(
    ("host", "known"),
    [
        *((f"{name}:{PORT}", True) for name in ("127.0.0.1", "localhost", "LOCALHOST", "[::1]")),
        *((name, False) for name in ("", "127.0.0.1", "127.0.0.1:1", f"evil.example:{PORT}")),
    ],
)
def test_only_names_of_this_server_are_its_own(host, known):
    assert OURS.knows_host(host) is known


@pytest.mark.parametrize(
    "changed",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": ""},
        {"origin": f"https://{HOST}"},
        {"origin": f"http://evil.example:{PORT}", "host": f"evil.example:{PORT}"},
        {"x-change-token": ""},
        {"x-change-token": OURS.change_token("another browser's cookie")},
    ],
)
def test_a_change_is_asked_for_by_a_page_of_ours_with_the_token_of_its_cookie(changed):
    cookie = OURS.new_session()
    headers = {"origin": ORIGIN, "host": HOST, "x-change-token": OURS.change_token(cookie)}
    assert OURS.may_change(headers, cookie)
    assert not OURS.may_change({**headers, **changed}, cookie)
    assert not OURS.may_change({}, cookie)


@pytest.fixture
def service(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    service = PageService(PageConfig(enabled=True, port=port), tmp_path / "control.sock")
    service.open()
    yield service
    asyncio.run(service.close())


def test_an_address_lets_one_browser_in(service):
    first, second = (service.address().partition("?token=")[2] for _ in range(2))
    for wrong in ("", "guessed", first[:-1]):
        with pytest.raises(NotAuthorisedError, match="never given out"):
            service.admit(wrong)
    service.admit(first)
    with pytest.raises(NotAuthorisedError, match="let a browser in already"):
        service.admit(first)
    service.admit(second)


def test_the_key_of_cookies_is_its_owners_alone_and_outlives_the_daemon(service, tmp_path):
    path = tmp_path / "control.page"
    assert path.stat().st_mode & 0o777 == 0o600
    key = path.read_text()
    asyncio.run(service.close())
    service.open()
    assert path.read_text() == key
    path.chmod(0o644)  # somebody may have read it
    asyncio.run(service.close())
    service.open()
    assert path.read_text() != key
