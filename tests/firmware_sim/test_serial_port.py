"""The stand-in on a serial line."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys

import numpy as np
import pytest
import serial

from firmware_sim.__main__ import main
from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.serial_port import QUEUE_FRAMES, SerialPort
from groundstation.telemetry.packet import SERIAL_FRAME_BYTES as FRAME_BYTES
from groundstation.telemetry.packet import Deframer, frame_packets
from support.programs import Program

PACKETS = np.arange(40 * 32, dtype=np.uint32).reshape(40, 32).astype(np.uint8)


def received(port, size):
    """``size`` bytes from an open pyserial port."""
    data = port.read(size)
    assert len(data) == size
    return data


@pytest.fixture
def line():
    with SerialPort("pty") as port:
        yield port


def opened(path):
    return serial.Serial(str(path), 2_000_000, timeout=20)


def test_a_reader_gets_each_packet_as_a_frame(line):
    with opened(line.path) as reader:
        line.send(PACKETS)
        assert received(reader, 40 * FRAME_BYTES) == frame_packets(PACKETS)
    assert (line.unheard, line.dropped) == (0, 0)


def test_the_terminal_passes_every_byte_as_it_is(line):
    """No echo, no line ends, no control characters, from the first byte on."""
    every = np.arange(256 * 32, dtype=np.uint32).reshape(-1, 32) // 32
    packets = every.astype(np.uint8)
    fd = os.open(line.path, os.O_RDWR | os.O_NOCTTY)  # sets nothing up itself
    try:
        line.send(packets)
        data = b""
        while len(data) < len(packets) * FRAME_BYTES:
            data += os.read(fd, 65536)
        assert data == frame_packets(packets)
    finally:
        os.close(fd)


def test_without_a_reader_nothing_is_kept_for_later(line):
    line.send(PACKETS)
    assert line.unheard == 40
    with opened(line.path) as reader:
        line.send(PACKETS[:1])
        assert received(reader, FRAME_BYTES) == frame_packets(PACKETS[:1])
    line.send(PACKETS)
    assert (line.unheard, line.dropped) == (80, 0)


def test_a_reader_that_does_not_read_costs_whole_packets_and_they_are_counted(line):
    with opened(line.path) as reader:
        sent = 0
        while line.dropped == 0:
            line.send(PACKETS)
            sent += 40
        line.send(PACKETS)
        sent += 40
        deframer, got = Deframer(), 0
        reader.timeout = 0
        while select.select([reader.fileno()], [], [], 0.05)[0] or line._queue:
            got += len(deframer.feed(reader.read(65536)))
            line.send(PACKETS[:0])
        assert deframer.damaged == 0
        assert got == sent - line.dropped


def test_a_burst_larger_than_the_queue_passes_as_far_as_the_line_takes_it(line):
    burst = np.tile(PACKETS[:1], (QUEUE_FRAMES + 100, 1))
    with opened(line.path) as reader:
        line.send(burst)
        assert len(line._queue) > 0
        reader.timeout = 0.05
        deframer, got = Deframer(), 0
        while got < len(burst):
            got += len(deframer.feed(reader.read(65536)))
            line.send(PACKETS[:0])
    assert (line.dropped, deframer.damaged) == (0, 0)


def test_what_a_reader_writes_does_not_block_the_bridge(line):
    with opened(line.path) as reader:
        for _ in range(200):
            reader.write(b"hello" * 100)
            line.send(PACKETS[:1])
        assert received(reader, 200 * FRAME_BYTES)


def test_a_link_names_the_terminal_and_goes_with_it(tmp_path):
    name = tmp_path / "craft"
    with SerialPort(f"pty:{name}") as line:
        assert line.path == str(name)
        assert os.readlink(name).startswith("/dev/pts/")
        with opened(name) as reader:
            line.send(PACKETS)
            assert received(reader, FRAME_BYTES)
        line.close()
        line.close()
    assert not name.is_symlink()


def test_a_link_left_behind_by_a_killed_run_is_replaced_and_a_file_is_not(tmp_path):
    name = tmp_path / "craft"
    name.symlink_to("/dev/pts/nowhere")
    with SerialPort(f"pty:{name}") as line, opened(name):
        assert os.path.exists(line.path)
    name.write_text("precious")
    with pytest.raises(ValueError, match="exists and is no link"):
        SerialPort(f"pty:{name}")
    assert name.read_text() == "precious"


def test_a_port_is_used_as_it_is_and_its_end_is_told():
    """The other end of a terminal stands for a cable."""
    master, slave = os.openpty()
    path = os.ttyname(slave)
    with SerialPort(path) as line:
        os.close(slave)
        line.send(PACKETS)
        data = b""
        while len(data) < 40 * FRAME_BYTES:
            data += os.read(master, 65536)
        assert data == frame_packets(PACKETS)
        os.close(master)
        with pytest.raises(OSError, match="gone") as gone:
            line.send(PACKETS)
        assert gone.value.filename == path


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("/dev/ttyNOWHERE", "/dev/ttyNOWHERE: No such file"),
        ("/dev/null", "/dev/null: is no serial port"),
        ("/dev/ttyS0@0", "greater than 0"),
        ("pty:/nowhere/craft", "/nowhere/craft: No such file"),
    ],
)
def test_a_line_that_cannot_be_used_is_one_line_and_status_1(capsys, where, message):
    assert main(["--for", "1", "--serial", where]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_line_runs_in_real_time_only(capsys):
    assert main(["--for", "1", "--fast", "--serial", "pty"]) == 1
    assert "real time" in capsys.readouterr().err


def test_the_program_sends_the_flight_of_its_seed(tmp_path):
    name = tmp_path / "craft"
    with Program(
        [sys.executable, "-m", "firmware_sim", "--serial", f"pty:{name}", "--seed", "4"],
        stdout=subprocess.PIPE,
        text=True,
    ) as child:
        assert child.stdout.readline() == f"telemetry on serial:{name}\n"
        with opened(name) as reader:
            deframer = Deframer()
            got = np.concatenate([deframer.feed(reader.read(4000)) for _ in range(10)])
        child.send_signal(signal.SIGINT)
        assert "packets while nobody listened, 0 dropped" in child.stdout.read()
        assert child.wait(60) == 0
    assert not name.is_symlink()
    assert len(got) > 1000
    flown, _ = StandIn(StandInSettings(seed=4)).advance(60.0)
    stream, found = flown.tobytes(), got.tobytes()
    assert stream.find(found) % 32 == 0
