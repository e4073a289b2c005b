"""The live view against real processes: the real feeder and the real rerun server."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import os
import signal
import socket
import subprocess
import sys
from dataclasses import replace
from urllib.parse import parse_qs, urlsplit

import numpy as np
import psutil
import pytest

from groundstation.errors import BadInputError, GroundStationError, TakenError
from groundstation.links.command import LinkEvent
from groundstation.rerun_log.channels import GROUPS, rerun_program, scaled
from groundstation.telemetry.decoder import Decoder, LinkMeter
from groundstation.telemetry.samples import LogTable, SampleBatch
from groundstation.viewer.viewer import Viewer, ViewerMode
from support.programs import Program, run_program
from support.viewer import SCALARS, TEXT, column
from support.waiting import eventually

PATIENCE_S = 60
FEEDER, SERVER = "groundstation.viewer.feeder", "--serve-web"
RELAY = "groundstation.viewer.relay"


def child(marker, parent=None):
    """The running child process with this word on its command line."""
    for process in psutil.Process(parent).children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if (
                marker in process.cmdline()
                and "groundstation.viewer.leash" not in process.cmdline()
            ):
                return process
    return None


class Session:
    """A viewer on free ports, with what it said, and samples that flow while one waits."""

    def __init__(self, free_port, wobble, mode=ViewerMode.SERVE):
        self.said = []
        self.port, self.web_port = free_port(), free_port()
        self.viewer = Viewer(
            mode,
            port=self.port,
            web_port=self.web_port,
            on_event=lambda kind, text: self.said.append((kind, text)),
        )
        self._wobble = wobble
        self.shown = 0

    async def __aenter__(self):
        await self.viewer.start()
        return self

    async def __aexit__(self, *_):
        await self.viewer.stop()

    def show(self, rows):
        self.viewer.samples(self._wobble(rows, self.shown))
        self.shown += rows

    async def serving(self):
        await eventually(lambda: self.viewer.status()["state"] == "serving", "serving")

    async def flow_until(self, condition, what):
        def step():
            self.show(5)
            return condition()

        await eventually(step, what)

    def balance(self):
        status = self.viewer.status()
        return status["sent"] + status["dropped"]


RISING = np.array([1.0, 2.0, 3.0])


@pytest.fixture
def session(free_port, wobble):
    return lambda mode=ViewerMode.SERVE: Session(free_port, wobble, mode)


async def test_what_another_viewer_saves_is_what_was_streamed(session, wobble, tmp_path, free_port):
    saved = tmp_path / "saved.rrd"

    def complete(path):
        with contextlib.suppress(OSError, RuntimeError, ValueError):
            shown = column(path, SCALARS)
            return len(shown.get("/telemetry/rates", ())) == 1000 and "/link/loss_pct" in shown
        return False

    with contextlib.ExitStack() as programs:
        async with session() as s:
            await s.serving()
            s.viewer.note(LinkEvent(int(wobble(1).host_time_ns[0]), "usb", "lost", "gone"))
            for _ in range(100):
                s.show(10)
            times_ns = wobble(3).host_time_ns
            s.viewer.note(LogTable("log", times_ns, times_ns * 1e-9, {"pm.state": RISING}))
            quiet = LinkMeter(0).close_window(
                int(wobble(1, 999).host_time_ns[0]), Decoder().counts()
            )
            s.viewer.note(replace(quiet, loss_pct=1.5, rate_hz=498.0))
            # a viewer that comes late gets everything from the server's buffer
            command = [
                rerun_program(), f"rerun+http://127.0.0.1:{s.port}/proxy", "--save", saved,
                "--bind", "127.0.0.1", "--port", str(free_port()),
            ]  # fmt: skip
            other = programs.enter_context(
                Program(command, stderr=subprocess.DEVNULL, env={**os.environ, "CI": "1"})
            )
            await eventually(lambda: s.viewer.status()["sent"] == 1003, "everything sent")
            await eventually(lambda: complete(saved), "everything saved")
            assert s.viewer.status()["dropped"] == 0
        # the other viewer finishes its file when the server is gone; a signal would tear it
        other.wait(PATIENCE_S)
    shown, said = column(saved, SCALARS), column(saved, TEXT)
    expected = SampleBatch.concatenate([wobble(10, first) for first in range(0, 1000, 10)])
    check_timelines(saved, expected)
    for group in GROUPS:
        values = scaled(group, getattr(expected, group.column)).reshape(1000, -1)
        if not np.isnan(values).all():
            np.testing.assert_array_equal(shown[group.entity], values, group.entity)
    assert said["/events"].tolist() == [["usb: gone"]]
    assert shown["/link/loss_pct"].tolist() == [[1.5]]
    assert shown["/tables/log/pm.state"][:, 0].tolist() == RISING.tolist()


def check_timelines(path, samples):
    from rerun.chunk import RrdReader

    times = {}
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == "/telemetry/attitude" and not chunk.is_static:
            batch = chunk.to_record_batch()
            for name in ("device_time", "host_time"):
                times.setdefault(name, []).append(batch[name].to_numpy(zero_copy_only=False))
    times = {name: np.concatenate(parts) for name, parts in times.items()}
    order = np.argsort(times["device_time"])
    np.testing.assert_array_equal(
        times["device_time"][order], np.rint(samples.time_s * 1e9).astype("timedelta64[ns]")
    )
    np.testing.assert_array_equal(
        times["host_time"][order], samples.host_time_ns.astype("datetime64[ns]")
    )


async def test_the_printed_address_opens_on_the_stream_and_only_this_machine_can(session):
    async with session() as s:
        await s.serving()
        web, command = s.viewer.status()["urls"]
        address = urlsplit(web)
        stream = f"rerun+http://127.0.0.1:{s.port}/proxy"
        assert parse_qs(address.query)["url"] == [stream]
        assert command.endswith(f"--connect {stream}")
        page = http.client.HTTPConnection(address.hostname, address.port, timeout=PATIENCE_S)
        page.request("GET", f"/?{address.query}")
        assert b"rerun" in page.getresponse().read().lower()
        page.close()
        for marker in (SERVER, RELAY):
            listening = child(marker).net_connections("inet")
            places = {c.laddr.ip for c in listening if c.status == "LISTEN"}
            assert places
            assert all(place.startswith("127.") for place in places)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
async def test_a_relay_that_dies_or_stalls_is_replaced_and_samples_flow_again(session, how):
    """The others: ``tests/system/test_live_view.py``."""

    async with session() as s:
        await s.serving()
        await s.flow_until(lambda: s.viewer.status()["sent"] > 500, "the first samples")
        process = child(RELAY)
        process.send_signal(how)
        await s.flow_until(lambda: s.viewer.status()["restarts"] >= 1, "noticed")
        await s.flow_until(lambda: s.viewer.status()["state"] == "serving", "serving again")
        sent = s.viewer.status()["sent"]
        await s.flow_until(lambda: s.viewer.status()["sent"] > sent + 500, "samples again")
        assert not process.is_running()
        assert [kind for kind, _ in s.said][:2] == ["viewer", "fault"]
    assert s.balance() <= s.shown <= s.balance() + 2000  # the rest still waited at the end


async def test_a_stalled_feeder_costs_samples_but_neither_time_nor_memory(session, wobble):
    batch = wobble(500)

    async with session() as s:
        await s.serving()
        child(FEEDER).send_signal(signal.SIGSTOP)
        memory = psutil.Process().memory_info().rss
        for _ in range(2000):  # an hour's worth before anybody notices
            for _ in range(2):
                s.viewer.samples(batch)
            await asyncio.sleep(0)
        await eventually(lambda: s.viewer.status()["restarts"] == 1, "noticed")
        assert psutil.Process().memory_info().rss - memory < 20e6
        status = s.viewer.status()
        assert status["dropped"] >= 2_000_000 - 4000
        assert status["sent"] + status["dropped"] <= 2_000_000


async def test_a_stopped_viewer_on_the_stream_hurts_nobody(session, free_port, tmp_path):
    with contextlib.ExitStack() as programs:
        async with session() as s:
            await s.serving()
            command = [
                rerun_program(), f"rerun+http://127.0.0.1:{s.port}/proxy",
                "--save", tmp_path / "other.rrd", "--bind", "127.0.0.1", "--port", str(free_port()),
            ]  # fmt: skip
            other = programs.enter_context(
                Program(command, stderr=subprocess.DEVNULL, env={**os.environ, "CI": "1"})
            )
            await s.flow_until(
                lambda: (
                    (tmp_path / "other.rrd").exists()
                    and (tmp_path / "other.rrd").stat().st_size > 100_000
                ),
                "the other viewer receives",
            )
            await s.flow_until(lambda: s.viewer.status()["viewers"] == 1, "it is counted")
            other.send_signal(signal.SIGSTOP)
            server = child(SERVER)
            await s.flow_until(
                lambda: s.viewer.status()["behind_s"] >= 1.5, "how far it is behind is told"
            )

            def push():
                s.show(1000)
                return s.viewer.status()["sent"] > 150_000

            await eventually(push, "the samples of five minutes sent past the stopped viewer")
            assert s.viewer.status()["restarts"] == 0
            assert server.memory_info().rss < 400e6


async def test_stop_ends_every_child_even_stopped_ones(session):
    async with session() as s:
        await s.serving()
        s.show(100)
        children = [child(FEEDER), child(SERVER)]
        for process in children:
            process.send_signal(signal.SIGSTOP)
    assert not [process for process in children if process.is_running()]
    assert s.viewer.status()["state"] == "off"
    assert s.viewer.status()["sent"] == 100  # what waited was handed over
    await s.viewer.stop()


async def test_it_can_be_started_again_on_the_same_ports(session):
    s = session()
    for _ in range(2):
        async with s:
            await s.serving()
            s.show(10)


async def test_stopping_before_it_serves_leaves_nothing(session):
    before = psutil.Process().children(recursive=True)  # other tests' helpers

    async with session():
        await eventually(lambda: child("groundstation.viewer.feeder"), "the feeder starts")
    assert psutil.Process().children(recursive=True) == before


@pytest.mark.parametrize("which", ["port", "web_port"])
def test_a_taken_port_is_named(session, which):
    async def start():
        s = session()
        with socket.create_server(("127.0.0.1", getattr(s, which))):
            with pytest.raises(TakenError, match=rf"port {getattr(s, which)} is taken"):
                await s.viewer.start()
            assert s.viewer.status()["state"] == "off"

    asyncio.run(start())


def test_a_missing_rerun_program_is_one_clear_line(session, monkeypatch, tmp_path):
    monkeypatch.setenv("RERUN_CLI_PATH", str(tmp_path / "rerun"))
    with pytest.raises(GroundStationError, match="rerun program is missing"):
        asyncio.run(session().viewer.start())


async def test_a_program_that_cannot_serve_is_retried_reported_and_costs_nothing_else(
    session, monkeypatch, tmp_path
):
    broken = tmp_path / "rerun"
    broken.write_text("#!/bin/sh\necho 'no such flag' >&2\nexit 2\n")
    broken.chmod(0o755)
    monkeypatch.setenv("RERUN_CLI_PATH", str(broken))
    monkeypatch.setattr("groundstation.viewer.viewer.BACK_OFF_S", (0.05, 0.1))

    async with session() as s:
        await s.flow_until(lambda: s.viewer.status()["state"] == "failed", "given up hope")
        assert s.viewer.status()["restarts"] == 3
        await s.flow_until(lambda: s.viewer.status()["dropped"] > 0, "drops are counted")
        monkeypatch.delenv("RERUN_CLI_PATH")
        await s.flow_until(lambda: s.viewer.status()["state"] == "serving", "it recovers")
    assert (
        "fault",
        "the rerun server ended: no such flag; starting it again in 0.05 s",
    ) in s.said


def test_without_a_display_spawn_says_what_to_do_instead(session, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(BadInputError, match="--viewer serve"):
        asyncio.run(session(ViewerMode.SPAWN).viewer.start())


async def test_a_window_that_cannot_open_is_reported_and_serving_goes_on(session, monkeypatch):
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("DISPLAY", ":987")

    async with session(ViewerMode.SPAWN) as s:
        await eventually(lambda: len(s.said) == 2, "the window ends")
        assert s.viewer.status()["state"] == "serving"
    (_, serving), (kind, text) = s.said
    assert serving.startswith("serving at http://127.0.0.1:")
    assert kind == "fault"
    assert text.startswith("the viewer window ended: ")


async def test_off_means_off(session, wobble):
    before = psutil.Process().children()

    async with session(ViewerMode.OFF) as s:
        s.viewer.samples(wobble(10))
        s.viewer.note(LinkMeter(0).close_window(1, Decoder().counts()))
        assert s.viewer.status() == {
            "state": "off", "sent": 0, "dropped": 0, "restarts": 0, "urls": [],
            "viewers": 0, "behind_s": 0.0,
        }  # fmt: skip
        assert psutil.Process().children() == before


def test_the_daemons_process_never_loads_rerun():
    code = (
        "import sys, groundstation.viewer.viewer\n"
        "sys.exit(any(name.startswith('rerun') for name in sys.modules))"
    )
    assert run_program([sys.executable, "-c", code]).returncode == 0
