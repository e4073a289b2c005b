"""Whatever link a flight came through, what is found from it is the same to the last digit.

Over USB as well where there is a kernel for it: ``tests/usb_vm``.
"""

import asyncio

import pytest

from firmware_sim.serial_port import SerialPort
from groundstation.links.replay import FAST
from groundstation.recording.formats import open_recording
from support.one_flight import flight_and_bench, record, require_equal, results

LINKS = ("stand-in", "replay", "serial")


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """link -> folder with the same flight and the same run of the motor bench."""
    folders = {link: tmp_path_factory.mktemp(link) for link in LINKS}
    flights = flight_and_bench()
    for name, flight in flights.items():
        flown, file = flight.through_stand_in(speed=FAST), f"{name}.mcap"
        record(flown, folders["stand-in"] / file)
        again = flight.replayed(flown, tmp_path_factory.mktemp("replayed") / file)
        record(again[0], folders["replay"] / file, again[1])
    for name, raw in zip(flights, asyncio.run(_down_two_lines(flights.values())), strict=True):
        record(raw, folders["serial"] / f"{name}.mcap")
    return folders


async def _down_two_lines(flights):
    """Both at the same time: each takes as long as it was flown."""
    with SerialPort("pty") as one, SerialPort("pty") as other:
        sent = zip(flights, (one, other), strict=True)
        return await asyncio.gather(*(flight.sent_down(line) for flight, line in sent))


@pytest.fixture(scope="module")
def expected(recordings):
    return results(recordings["stand-in"])


def test_the_stand_in_hides_what_is_found(expected):
    assert [found["name"] for found in expected["discrepancy"]["effects"]] == ["gyro_low_pass"]
    assert expected["motor"]["motor"]["a0"] == pytest.approx(0.862, rel=0.01)


@pytest.mark.parametrize("link", LINKS[1:])
def test_samples_are_the_same_but_for_the_hosts_stamps_through(link, recordings):
    for name in ("flight", "bench"):
        here, there = (
            open_recording(recordings[one] / f"{name}.mcap") for one in ("stand-in", link)
        )
        require_equal(there.samples, here.samples, link)
        assert (here.samples.host_time_ns != there.samples.host_time_ns).any()


def test_models_gains_and_effects_are_the_same_whatever_the_stamps(recordings, expected):
    assert results(recordings["serial"]) == expected
