"""The software craft's bridge as docs/hardware.md has users try it: ``tests/support/usbip.py``,
plugged into this machine's kernel, or attached to it by the real ``usbip`` tool."""

import asyncio
import contextlib
import os
import signal
import subprocess
import sys

from emulated_bridge import OUT, open_when_there, read_until_lost

from groundstation.links.usb import UsbLink
from groundstation.telemetry.decoder import decode_all
from support import usbip as program
from support.links import joined, read_span

PORT = 3240
SPAN_NS = 1_000_000_000


@contextlib.contextmanager
def craft(where):
    """The software craft behind a sound radio; what it says at its end is for the test."""
    settings = OUT / "sound_flight.toml"
    with subprocess.Popen(
        [sys.executable, program.__file__, where, "--settings", settings],
        stdout=subprocess.PIPE, text=True,
        env={**os.environ, "NUMBA_CPU_NAME": "generic", "NUMBA_CACHE_DIR": str(OUT / "numba")},
    ) as process:  # fmt: skip
        try:
            assert process.stdout.readline() == f"USB bridge on {where}\n"
            yield process
        finally:
            process.kill()


def usbip(*arguments):
    done = subprocess.run(["usbip", *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done
    return done.stdout


async def read_whole(link):
    """A second of telemetry, of which nothing may be missing."""
    await open_when_there(link)
    samples, counts = decode_all(joined(await read_span(link, SPAN_NS)))
    assert counts.lost == 0
    assert len(samples) > 450
    assert (samples.copies[1:-1] == 4).all()
    assert link.counts.lost == 0


def test_the_usbip_tool_lists_attaches_detaches_and_attaches_again():
    async def session():
        link = UsbLink()
        assert "0483:5741" in usbip("list", "-r", "127.0.0.1")
        for _ in range(2):
            usbip("attach", "-r", "127.0.0.1", "-b", "1-1")
            await read_whole(link)
            (port,) = [line for line in usbip("port").splitlines() if line.startswith("Port")]
            usbip("detach", "-p", port.split()[1].rstrip(":"))
            await read_until_lost(link)
            await link.close()

    with craft(f"127.0.0.1:{PORT}") as process:
        asyncio.run(session())
        process.send_signal(signal.SIGINT)
        assert process.wait() == 0


def test_the_craft_plugs_itself_into_this_machine_and_out_again():
    async def session(process):
        link = UsbLink()
        await read_whole(link)
        process.send_signal(signal.SIGINT)
        await read_until_lost(link)
        await link.close()

    with craft("vhci") as process:
        asyncio.run(session(process))
        assert process.wait() == 0
