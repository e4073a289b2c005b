"""The serial link on real pseudo-terminals: the contract, damage, and ports that come and go."""

import asyncio
import grp
import os
import sys
import threading
import time

import numpy as np
import pytest

from firmware_sim.serial_port import SerialPort
from firmware_sim.settings import Loss, StandInSettings
from groundstation.background import left_running
from groundstation.errors import BadInputError, LinkError, LinkLostError
from groundstation.links import serial as serial_module
from groundstation.links.base import LinkState
from groundstation.links.factory import make_link
from groundstation.links.serial import SerialLink
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.packet import BAUD, frame_packets
from groundstation.telemetry.packet import SERIAL_FRAME_BYTES as FRAME_BYTES
from support.crafts import SerialCraft
from support.links import LinkContract, joined, listen, packets_read, read_span
from support.one_flight import BRIDGES, OneFlight, require_same_on_this_machine
from support.packets import flight
from support.programs import run_program
from support.waiting import PATIENCE_S, eventually

SOUND = Loss(good_loss=0.0)


def packets_of(rows, first=0):
    return flight(first, rows)[0].packets


@pytest.fixture
def line():
    with SerialPort("pty") as port:
        yield port


class SerialContract(LinkContract):
    settings = StandInSettings(loss=SOUND)
    bad = (
        ("serial:{tmp_path}", {}, "is no serial port"),
        ("serial:/dev/null", {}, "is no serial port"),
        ("serial:/dev/ttyS0@0", {}, "greater than 0"),
        ("serial:", {}, "serial:PORT"),
    )

    @pytest.fixture
    def link(self):
        with SerialCraft(self.settings) as craft:
            yield make_link(f"serial:{craft.path}", speed=1.0, stand_in={})

    def open_wrongly(self, name, options):
        async def session():
            async with make_link(name, speed=1.0, stand_in=options):
                pass

        asyncio.run(session())


class TestSerial(SerialContract):
    pass


class TestSerialThatFiltersCopies(SerialContract):
    """The bridge of the thesis forwards each packet once."""

    settings = StandInSettings(loss=SOUND, bridge_dedup=True)
    copies = 1


@pytest.mark.parametrize("bridge", BRIDGES)
def test_one_flight_is_the_same_through_stand_in_replay_and_serial(tmp_path, line, bridge):
    """Through USB as well where there is a kernel for it: ``tests/usb_vm``."""
    require_same_on_this_machine(OneFlight(BRIDGES[bridge]), line, tmp_path / "flight.mcap")


def test_two_thousand_packets_a_second_lose_nothing():
    with SerialCraft(StandInSettings(loss=SOUND)) as craft:

        async def session():
            async with SerialLink(craft.path) as link:
                return joined(await read_span(link, 3_000_000_000)), link.damaged

        raw, damaged = asyncio.run(session())
        samples, counts = decode_all(raw)
        assert craft.port.dropped == 0
    assert damaged == 0
    assert counts.lost == 0
    assert (samples.copies[1:-1] == 4).all()
    assert samples.time_s[-1] - samples.time_s[0] > 2.9


def test_a_loop_that_was_blocked_loses_nothing():
    """What waits in the kernel is late, and whole."""
    with SerialCraft(StandInSettings(loss=SOUND)) as craft:

        async def session():
            async with SerialLink(craft.path) as link:
                batches = []
                for _ in range(4):
                    batches += await read_span(link, 100_000_000)
                    time.sleep(0.1)
                return joined(batches + await read_span(link))

        raw = asyncio.run(session())
    samples, counts = decode_all(raw)
    assert counts.lost == 0
    assert counts.restarts == 0
    assert (samples.copies[1:-1] == 4).all()


async def test_stamps_are_those_of_the_reads_not_of_the_batch(line):
    async with SerialLink(line.path) as link:
        reads = []
        clock = link.clock
        link.clock = lambda: reads.append(clock()) or reads[-1]
        batches, sent = [], packets_of(8)
        async with asyncio.timeout(PATIENCE_S):
            while len(reads) < 2 * len(batches) + 4:  # several reads in some batch
                before = len(reads)
                line.send(sent)
                while len(reads) == before:
                    await asyncio.sleep(0)
        batch = await link.read()
    assert len(batch) == 4 * 32
    assert sorted(set(batch.host_time_ns.tolist())) == reads[:4]


async def test_a_packet_cut_in_two_reads_has_the_stamp_of_the_second(line):
    stream = frame_packets(packets_of(1))
    half = FRAME_BYTES // 2

    async with SerialLink(line.path) as link:
        os.write(line._fd, stream[:half])
        assert await link.read() is None
        between = link.clock()
        os.write(line._fd, stream[half:])
        batch = await packets_read(link, 4)
    np.testing.assert_array_equal(batch.packets, packets_of(1))
    assert (batch.host_time_ns >= between).all()


async def test_damage_on_the_line_costs_its_frames_and_is_told(line):
    stream = frame_packets(packets_of(50))
    spoilt = bytearray(stream)
    spoilt[40 * FRAME_BYTES + 7] ^= 0x40
    spoilt[80 * FRAME_BYTES + 9] ^= 0x01
    link = SerialLink(line.path)
    events = listen(link)

    async with link:
        os.write(line._fd, bytes(spoilt))
        batch, damaged = await packets_read(link, 198), link.damaged
    expected = np.delete(packets_of(50), [40, 80], axis=0)
    np.testing.assert_array_equal(batch.packets, expected)
    assert damaged >= 2
    (fault,) = [event for event in events if event.kind == "fault"]
    assert "damaged frames skipped" in fault.text
    assert fault.details == {"damaged": damaged}


async def test_damage_in_the_last_moment_before_silence_is_told_too(line, monkeypatch):
    monkeypatch.setattr(serial_module, "REPORT_S", 0.05)
    frames = bytearray(frame_packets(packets_of(50)))
    half = 100 * FRAME_BYTES
    frames[40 * FRAME_BYTES + 7] ^= 0x40
    frames[half + 40 * FRAME_BYTES + 7] ^= 0x40
    link = SerialLink(line.path)
    events = listen(link)

    def faults():
        return [event for event in events if event.kind == "fault"]

    async with link:
        for part in (frames[:half], frames[half:]):
            os.write(line._fd, bytes(part))
            await packets_read(link, 99)
        await eventually(lambda: len(faults()) >= 2)  # nothing more comes, nobody reads
        damaged = link.damaged
    assert damaged >= 2
    assert len(faults()) == 2
    assert faults()[-1].details == {"damaged": damaged}


async def test_a_stream_at_another_speed_is_said_to_be_no_telemetry(line):
    link = SerialLink(line.path)
    events = listen(link)

    async with link:
        os.write(line._fd, np.random.default_rng(0).bytes(8000))
        found = await link.read()
    assert found is None
    (fault,) = [event for event in events if event.kind == "fault"]
    assert "check the bridge's baud rate" in fault.text
    assert str(BAUD) in fault.text


async def test_what_waits_for_a_reader_that_does_not_come_is_bounded_and_counted(line, monkeypatch):
    monkeypatch.setattr(serial_module, "MOST_WAITING_BYTES", 3000)
    link = SerialLink(line.path)
    events = listen(link)

    async with link:
        for number in range(100):
            before = link._received_bytes
            line.send(packets_of(8, first=8 * number))
            async with asyncio.timeout(PATIENCE_S):
                while link._received_bytes < before + 32 * FRAME_BYTES:
                    await asyncio.sleep(0)
        assert link._waiting_bytes <= 3000
        batch = await link.read()
        dropped, received = link.dropped_bytes, link._received_bytes
    assert received == 3200 * FRAME_BYTES
    assert dropped >= received - 3000 - 32 * FRAME_BYTES
    np.testing.assert_array_equal(batch.packets, packets_of(800)[-len(batch) :])
    assert "not read in time" in next(event for event in events if event.kind == "fault").text


async def test_a_port_that_hangs_up_delivers_what_it_had_and_is_lost(line):
    link = SerialLink(line.path)
    events = listen(link)

    async with link:
        line.send(packets_of(5))
        await eventually(lambda: link._waiting)
        line.close()
        got = await packets_read(link, 20)
        for _ in range(2):
            with pytest.raises(LinkLostError, match="has gone"):
                await link.read()
            assert link.state is LinkState.LOST
    np.testing.assert_array_equal(got.packets, packets_of(5))
    assert [event.kind for event in events] == ["opening", "streaming", "lost", "closed"]
    assert "\n" not in events[2].text


async def test_a_port_that_hangs_up_during_silence_is_lost_at_once(line):
    link = SerialLink(line.path)
    link.silence_s = PATIENCE_S

    async with link:
        reading = asyncio.create_task(link.read())
        await asyncio.sleep(0)
        line.close()
        with pytest.raises(LinkLostError):
            await reading


async def test_a_terminal_under_the_same_name_again_streams_again(tmp_path):
    name = tmp_path / "craft"
    link = SerialLink(str(name))

    for first in (0, 1000):
        with SerialPort(f"pty:{name}") as port:
            async with link:
                port.send(packets_of(5, first=first))
                got = await packets_read(link, 20)
                np.testing.assert_array_equal(got.packets, packets_of(5, first=first))
        with pytest.raises(LinkError, match="is not there"):
            await link.open()


async def test_a_hundred_connections_leave_no_descriptor_behind(tmp_path):
    name = tmp_path / "craft"
    link = SerialLink(str(name))

    async def connect():
        with SerialPort(f"pty:{name}") as port:
            async with link:
                port.send(packets_of(5))
                await packets_read(link, 20)
                port.close()
                with pytest.raises(LinkLostError):
                    await link.read()

    await connect()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(100):
        await connect()
    assert len(os.listdir("/proc/self/fd")) == before


async def test_what_was_sent_while_nobody_listened_is_not_taken_for_the_present(line):
    async with SerialLink(line.path) as link:
        line.send(packets_of(5))
        await packets_read(link, 20)
    line.send(packets_of(5, first=500))
    async with SerialLink(line.path) as link:
        line.send(packets_of(5, first=1000))
        got = await packets_read(link, 20)
    np.testing.assert_array_equal(got.packets, packets_of(5, first=1000))
    assert line.unheard == 20


async def test_a_port_that_another_reader_has_is_refused(line):
    async with SerialLink(line.path):
        with pytest.raises(LinkError, match="in use by another program") as refused:
            await SerialLink(line.path).open()
        assert not isinstance(refused.value, BadInputError)


@pytest.mark.parametrize(
    ("group", "advice"), [(1, "sudo usermod -aG {name} $USER"), (0, "udev rule")]
)
def test_a_port_without_permission_tells_what_to_do(line, group, advice):
    if os.geteuid() != 0:
        pytest.skip("only root can become a user without permission")
    os.chmod(line.path, 0o600)
    os.chown(line.path, -1, group)
    program = (
        "import asyncio, sys\n"
        "from groundstation.links.serial import SerialLink\n"
        "link = SerialLink(sys.argv[1])\n"
        "import serial, os\n"
        "os.setgid(65534); os.setuid(65534)\n"
        "asyncio.run(link.open())\n"
    )
    result = run_program([sys.executable, "-c", program, line.path])
    last = result.stderr.strip().splitlines()[-1]
    assert "LinkError" in last
    assert "permission denied" in last
    assert advice.format(name=grp.getgrgid(group).gr_name) in last


@pytest.mark.parametrize(
    ("address", "port", "baud"),
    [
        ("/dev/ttyACM0", "/dev/ttyACM0", 2_000_000),
        ("/dev/ttyUSB0@921600", "/dev/ttyUSB0", 921_600),
        ("/dev/serial/by-id/usb-a@b", "/dev/serial/by-id/usb-a@b", 2_000_000),
    ],
)
def test_an_address_is_a_port_and_perhaps_a_speed(address, port, baud):
    link = SerialLink(address)
    assert (link.port, link.baud) == (port, baud)
    assert link.name == f"serial:{address}"


async def test_the_speed_that_was_asked_for_is_set(line):
    import termios

    async with SerialLink(f"{line.path}@921600") as link:
        found = termios.tcgetattr(link._serial.fileno())[4]
    assert found == termios.B921600


def test_a_name_too_strange_for_a_path_is_refused_in_one_line():
    with pytest.raises(BadInputError) as refused:
        asyncio.run(SerialLink("/dev/tty\0S").open())
    assert "\n" not in str(refused.value)


async def test_a_port_that_hangs_while_it_opens_is_told_of_and_tried_by_one_thread_only(
    line, tmp_path, monkeypatch
):
    """A wedged adapter: its driver holds whoever opens it, here a pipe without a writer does."""
    gate, opened = tmp_path / "gate", []
    os.mkfifo(gate)

    def open_slowly(port, baud):
        with open(gate, "rb"):
            opened.append(open_port(port, baud))
        return opened[-1]

    open_port = serial_module._open_port
    monkeypatch.setattr(serial_module, "_open_port", open_slowly)
    monkeypatch.setattr(serial_module, "OPEN_S", 0.2)

    link = SerialLink(line.path)
    for tried in (link, link, SerialLink(line.path)):
        with pytest.raises(LinkError, match="does not answer"):
            await tried.open()
    waiting = [one for one in threading.enumerate() if line.path in one.name]
    assert len(waiting) == 1
    gate.open("wb").close()  # the driver comes back
    async with asyncio.timeout(PATIENCE_S):
        while left_running(f"opening {line.path}") or opened[0].is_open:
            await asyncio.sleep(0.01)
    monkeypatch.setattr(serial_module, "_open_port", open_port)
    async with link:
        assert link.state is LinkState.OPENING
