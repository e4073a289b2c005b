"""What goes wrong before the first row of a stock craft: one line that says what to do."""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import subprocess
import sys
import traceback
from pathlib import Path

import pytest
from usb.core import USBError

from groundstation.errors import BadInputError, LinkError
from groundstation.links.crazyflie import CrazyflieTelemetry
from groundstation.links.crazyflie_connection import Connection, _explained
from support.crafts import served
from support.programs import free_port, run_program

GYRO = (("gyro.x", "float"),)


def opened(link: CrazyflieTelemetry) -> None:
    async def session() -> None:
        async with link:
            pass

    asyncio.run(session())


@pytest.mark.skipif(sys.platform != "linux", reason="libusb of Linux")
def test_without_a_dongle_one_line_says_so() -> None:
    """This machine's own bus; a dongle in use looks alike to the library."""
    with pytest.raises(LinkError, match=r"no Crazyradio is plugged in|no craft") as refusal:
        opened(CrazyflieTelemetry("radio://0/80/2M/E7E7E7E7E7"))
    assert "\n" not in str(refusal.value)


def as_cflib_says_it(error: Exception) -> str:
    """Its radio driver gives what libusb raised with the whole traceback."""
    try:
        raise error
    except Exception:
        return f"Couldn't load link driver: {traceback.format_exc()}"


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (USBError("Access denied (insufficient permissions)", -3, errno.EACCES), "install udev"),
        (USBError("Resource busy", -6, errno.EBUSY), "the dongle is in use by another program"),
        (Exception("Cannot find a Crazyradio Dongle"), "no Crazyradio is plugged in, or it is in"),
        (Exception("Could not open usb://0"), "no Crazyflie is on the cable, it is off, or"),
        (socket.gaierror(-2, "Name or service not known"), "no such host"),
    ],
)
def test_what_libusb_raises_of_a_dongle_is_one_line_that_says_what_to_do(
    error: Exception, told: str
) -> None:
    """What a second daemon on one dongle, and a user whom udev does not let in, read."""
    line = _explained(as_cflib_says_it(error))
    assert told in line
    assert "\n" not in line
    assert "Traceback" not in line
    assert "Exception" not in line


def test_the_rule_that_is_named_lets_every_dongle_in() -> None:
    program = Path(sys.executable).with_name("groundstation")
    rule = run_program([program, "install", "udev", "--print"], timeout=60).stdout
    for vendor, product in (("1915", "7777"), ("35f0", "bad2"), ("0483", "5740")):
        assert any(vendor in line and product in line for line in rule.splitlines())


def test_a_craft_that_is_off_or_a_wrong_port_is_one_line_and_nothing_else_is_printed(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    uri = f"udp://127.0.0.1:{free_port()}"
    with pytest.raises(LinkError, match="refused: nothing serves there") as refusal:
        opened(CrazyflieTelemetry(uri))
    assert "\n" not in str(refusal.value)
    assert logging.getLogger("cflib").handlers, "what it warns of would be printed as a last resort"
    assert capfd.readouterr().err == ""


def test_a_variable_that_the_firmware_does_not_list_is_named_with_its_neighbours() -> None:
    with (
        served(craft="crazyflie21", plant="reduced") as craft,
        pytest.raises(BadInputError, match=r"--log pm\.vbatt: .* near are pm\.vbat"),
    ):
        opened(CrazyflieTelemetry(craft.uri, wanted=["pm.vbatt"]))


async def test_more_than_a_craft_can_log_is_refused_in_one_line() -> None:
    with served(craft="crazyflie21", plant="reduced") as craft:
        connection = Connection(craft.uri)
        await connection.open()
        try:
            with pytest.raises(BadInputError, match=r"16 blocks .* fewer with --log") as refusal:
                await connection.blocks.start([GYRO] * 17, 100, lambda *packet: None)
            assert "\n" not in str(refusal.value)
        finally:
            await connection.close()


def test_without_cflib_the_hint_names_this_programs_extra() -> None:
    script = (
        "import sys; sys.modules['cflib'] = None; sys.modules['cflib.crtp'] = None\n"
        "from groundstation.links.factory import make_link\n"
        "make_link('udp://127.0.0.1:1', speed=1.0, stand_in={})\n"
    )
    done = run_program([sys.executable, "-c", script], timeout=60)
    assert isinstance(done, subprocess.CompletedProcess)
    said = done.stderr.splitlines()[-1]
    assert "needs cflib: install it with pip install 'crazyflie-groundstation[radio]'" in said


async def test_a_library_that_locks_itself_up_holds_nobody_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It keeps its lock while it tells of a craft that vanished under a packet."""
    monkeypatch.setattr("groundstation.links.crazyflie_connection.CLOSE_S", 0.3)

    with served(craft="crazyflie21", plant="reduced") as craft:
        connection = Connection(craft.uri)
        await connection.open()
        await connection.blocks.start([GYRO], 10, lambda *packet: None)
        lock = connection.craft._send_lock
        lock.acquire()
        try:
            async with asyncio.timeout(20):
                await connection.close()
            assert not connection.is_open
        finally:
            lock.release()


async def test_a_craft_that_a_ping_finds_gone_is_told_of() -> None:
    """cflib's own ping waits for itself then, and said nothing to anybody."""
    told: list[str] = []

    with served(craft="crazyflie21", plant="reduced") as craft:
        connection = Connection(craft.uri)
        connection.on_lost.append(told.append)
        await connection.open()
        connection.craft.link.pause()  # else the thread that receives may find it first
        asyncio.run_coroutine_threadsafe(craft.server.close(), craft.loop).result(10)
        async with asyncio.timeout(20):
            while not told:
                await asyncio.sleep(0.05)
            await connection.close()
    assert told == ["refused: nothing serves there"]
