"""What the relay answers itself: rerun's page with our script, and how old browsers' rows are."""

import asyncio
import json

import pytest

from groundstation.viewer.relay import WebPage

RERUNS = (
    b'<html><link rel="icon" href="favicon.ico"><link href="https://fonts.example/css" rel='
    b'"stylesheet" /><body><canvas></canvas></body></html>'
)


async def rerun(reader, writer):
    """Stands for rerun's web server."""
    await reader.readuntil(b"\r\n\r\n")
    writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(RERUNS) + RERUNS)
    writer.close()


def asked(request, body=b"", viewers=1, page=None):
    """The answer's status line, fields and body; None where rerun's server is to answer."""

    async def session():
        there = await asyncio.start_server(rerun, "127.0.0.1", 0)
        ours = page or WebPage(("127.0.0.1", 0), 9876)
        ours._upstream = there.sockets[0].getsockname()
        reader = asyncio.StreamReader()
        reader.feed_data(body)
        reader.feed_eof()
        head = f"{request} HTTP/1.1\r\nContent-Length: {len(body)}\r\n\r\n"
        answer = await ours.answer(head.encode(), reader, viewers)
        there.close()
        return answer

    answer = asyncio.run(session())
    if answer is None:
        return None
    head, _, content = answer.partition(b"\r\n\r\n")
    return head.decode(), content


def test_the_page_asks_no_other_host_and_has_our_script():
    head, page = asked("GET /?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A9876%2Fproxy")
    assert b"https://" not in page
    assert b'<script src="live.js"' in page
    assert b"favicon.ico" in page
    assert f"Content-Length: {len(page)}\r\n" in head
    policy = next(line for line in head.split("\r\n") if line.startswith("Content-Security-Policy"))
    assert "http://127.0.0.1:9876" in policy
    assert "https:" not in policy
    assert "*" not in policy


def test_the_rest_is_reruns():
    assert asked("GET /re_viewer_bg.wasm") is None
    assert asked("GET /live.jsx") is None
    assert asked("POST /other", b"1.0") is None


def test_the_slowest_browser_counts_until_it_tells_nothing(monkeypatch):
    page = WebPage(("127.0.0.1", 0), 9876)
    for who, age in (("one", b"0.4"), ("other", b"7.5")):
        _, content = asked(f"POST /behind?{who}", age, viewers=2, page=page)
        assert json.loads(content) == {"connected": True}
    assert page.behind_s == 7.5
    monkeypatch.setattr("groundstation.viewer.relay.TOLD_S", -1.0)
    assert page.behind_s == 0.0


def test_a_browser_whose_connection_was_dropped_is_told():
    page = WebPage(("127.0.0.1", 0), 9876)
    _, content = asked("POST /behind?one", b"12.0", viewers=0, page=page)
    assert json.loads(content) == {"connected": False}


@pytest.mark.parametrize("body", [b"", b"nan", b"soon", b"\xff"])
def test_an_age_that_is_none_is_refused(body):
    page = WebPage(("127.0.0.1", 0), 9876)
    head, _ = asked("POST /behind?one", body, page=page)
    assert "400" in head
    assert page.behind_s == 0.0


def test_no_more_browsers_are_remembered_than_may_connect():
    page = WebPage(("127.0.0.1", 0), 9876)
    for number in range(200):
        asked(f"POST /behind?{number}", b"1.0", page=page)
    assert len(page._told) <= 64
