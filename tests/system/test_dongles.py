"""Two programs, one dongle: the second ends with one line, and the first goes on.

The programs and the kernel are real; no dongle need be plugged in, for whoever waits for one has
it. Dongles of other tests, or of whoever runs them, have other numbers.
"""

import os
import signal
import subprocess
import sys
from contextlib import closing

import pytest

from groundstation.cli.devices import craft_in_reach
from groundstation.errors import GroundStationError, TakenError
from groundstation.links.command import LOOKED_THROUGH, ways_of
from groundstation.service.client import ask
from groundstation.service.craft_links import Dongles
from support.daemons import Daemon
from support.programs import Program

DONGLE = os.getpid()
"""The names are the machine's: every process that runs tests has numbers of its own."""
BEYOND = DONGLE + 10_000_000
FIRST, BESIDE = f"radio://{DONGLE}/80/2M/E7E7E7E7E7", f"radio://{DONGLE}/90/1M"
OTHER = f"radio://{BEYOND}/80/2M"
HOLDS = """
import sys
from groundstation.links.command import ways_of
from groundstation.service.craft_links import Dongles
dongles = Dongles()
dongles.take(ways_of(sys.argv[1:]))
print(flush=True)
sys.stdin.read()
"""


@pytest.fixture
def first(tmp_path):
    with Daemon(tmp_path / "first", "--link", FIRST) as daemon:
        daemon.status_when(lambda status: status["link"]["state"] == "opening", "it waits")
        yield daemon


@pytest.mark.parametrize("links", [("--link", FIRST), ("--link", "usb", "--command", BESIDE)])
def test_the_second_daemon_ends_with_one_line_and_the_first_goes_on(first, tmp_path, links):
    with Daemon(tmp_path / "second", *links) as second:
        assert second.wait() == 1
    said = second.stderr.strip()
    before, _, after = said.partition(f" is in use by process {first.process.pid} (")
    assert before == f"groundstation: {links[-1]}: dongle {DONGLE}"
    assert after.endswith("groundstation run); end it, or take another dongle")
    assert second.stdout == ""
    assert not second.files()
    assert first.status()["link"]["state"] == "opening"
    assert not any("process" in event["text"] for event in first.ask("GET", "/events"))


def test_a_dongle_is_free_when_its_holder_was_killed(first, tmp_path):
    first.stop(signal.SIGKILL)
    with Daemon(tmp_path / "next", "--link", FIRST) as following:
        following.status_when(lambda status: status["link"]["state"] == "opening", "it waits")


def test_a_daemon_with_another_link_may_not_go_over_to_it(first, tmp_path):
    with Daemon(tmp_path / "second", "--link", OTHER) as second:
        second.status_when(lambda status: status["link"]["state"] == "opening", "it waits")
        with pytest.raises(GroundStationError, match=f"dongle {DONGLE} is in use by process"):
            ask(second.socket, "POST", "/link", {"name": FIRST})
        assert second.status()["link"]["name"] == OTHER


def test_links_that_were_left_are_free_again():
    with closing(Dongles()) as ours, closing(Dongles()) as theirs:
        ours.take(ways_of([FIRST]))
        ours.take(ways_of([BESIDE, OTHER]))
        ours.keep([BESIDE, OTHER])  # one dongle carries both
        with pytest.raises(TakenError, match=f"dongle {DONGLE}"):
            theirs.take(ways_of([FIRST, OTHER]))
        ours.keep([OTHER])
        theirs.take(ways_of([FIRST, "udp://127.0.0.1:1", "serial:/dev/ttyS0", "stand-in"]))
        with pytest.raises(TakenError, match=f"dongle {BEYOND}"):
            theirs.take(ways_of([FIRST, OTHER]))
        ours.close()
        ours.close()
        theirs.take(ways_of([FIRST, OTHER]))


def test_letting_go_takes_nothing_whoever_has_it():
    with closing(Dongles()) as ours, closing(Dongles()) as theirs:
        ours.take(ways_of([FIRST]))
        theirs.take(ways_of([OTHER]))
        ours.keep([FIRST, OTHER])  # of a link that is in use and was never held
        with pytest.raises(TakenError, match=f"dongle {DONGLE}"):
            theirs.take(ways_of([FIRST]))
        with pytest.raises(TakenError, match=f"dongle {BEYOND}"):
            ours.take(ways_of([OTHER]))


def test_craft_are_not_looked_for_with_a_dongle_that_another_program_flies_with():
    dongle, _ = LOOKED_THROUGH
    with Program(
        [sys.executable, "-c", HOLDS, dongle],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as holder:
        holder.stdout.readline()
        found, why = craft_in_reach([{"name": "1915:7777"}])
    assert found == []
    assert f"dongle 0 is in use by process {holder.pid}" in why
