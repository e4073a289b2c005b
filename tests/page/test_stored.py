"""The page's buttons that store gains on the craft and clear them, without a browser."""

import asyncio
import json

from groundstation.page.app import Access, page_app
from support.crafts import served
from support.daemons import Daemon
from support.page_requests import PORT, asked, browser

GAIN = "pid_rate.roll_kp"


def test_gains_are_stored_and_cleared_and_shown_beside_those_that_fly(tmp_path):
    access = Access(b"key", PORT)
    with (
        served(craft="crazyflie21", plant="reduced") as craft,
        Daemon(tmp_path, "--link", craft.uri, "--no-record") as daemon,
    ):
        daemon.status_when(
            lambda status: status["command"] and status["command"]["state"] == "connected",
            "the craft is there",
        )
        app = page_app(daemon.socket, access, None)

        def page(method, path, body=None):
            status, content = asyncio.run(asked(app, method, path, browser(access), body))
            assert status == 200, content
            return json.loads(content)

        shown = page("GET", "/parameters")
        assert shown["stores"]
        assert shown["stored"] == {}
        page("POST", "/parameters", {"values": {GAIN: 61.0}})
        shown = page("POST", "/parameters/stored", {"clear": False})
        assert shown["stored"] == craft.craft.stored == {GAIN: 61.0}
        assert page("GET", "/parameters")["stored"] == {GAIN: 61.0}
        shown = page("POST", "/parameters/stored", {"clear": True})
        assert shown["stored"] == craft.craft.stored == {}
        assert shown["values"][GAIN] == 61.0
