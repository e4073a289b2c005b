"""The parts of ``firmware/`` without hardware, compiled for this machine, and chips of software.

The radio chips know of an nRF24L01+ what its product specification 1.0 says of the commands and
registers that a telemetry link needs.
"""

import ctypes
import functools
import shutil
import tempfile
from pathlib import Path

import pytest

from support.programs import run_program

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
U8, U16, U32, I16 = ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_int16
TRANSFER = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.POINTER(U8), ctypes.POINTER(U8), ctypes.c_uint8
)
ENABLE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_bool)
WAIT = ctypes.CFUNCTYPE(None, ctypes.c_void_p, U32)


class Bus(ctypes.Structure):
    _fields_ = (
        ("transfer", TRANSFER), ("enable", ENABLE), ("wait_us", WAIT), ("board", ctypes.c_void_p),
    )  # fmt: skip


class Air(ctypes.Structure):
    _fields_ = (("channel", U8), ("address", U8 * 5))


class Sample(ctypes.Structure):
    _fields_ = (
        ("ticks", U16), ("battery_v", ctypes.c_float), ("motor_ratio", U16 * 4),
        ("gyro", I16 * 3), ("accelerometer", I16 * 3),
        ("roll_deg", ctypes.c_float), ("pitch_deg", ctypes.c_float), ("yaw_deg", ctypes.c_float),
        ("debug", U32),
    )  # fmt: skip


class Sender(ctypes.Structure):
    _fields_ = (
        ("packets", (U32 * 8) * 2), ("latest", U8), ("published", U8), ("seen", U8),
        ("copies", U8), ("next_register", U8), ("ticks", U16),
    )  # fmt: skip


class BladeTimer(ctypes.Structure):
    _fields_ = (("half_turn", U32), ("last", U32), ("seen", U8))


class Queue(ctypes.Structure):
    _fields_ = (
        ("packets", (U8 * 32) * 32), ("written", U32), ("read", U32), ("newest", U8 * 32),
        ("has_newest", ctypes.c_bool), ("forward_copies", ctypes.c_bool),
        ("copies_left_out", U32), ("dropped", U32),
    )  # fmt: skip


class UsbControl(ctypes.Structure):
    _fields_ = (
        ("address", U8), ("configuration", U8), ("alternate", U8), ("serial", ctypes.c_char * 25),
        ("answer", U8 * 64),
    )  # fmt: skip


@functools.cache
def firmware():
    """The library, made by ``firmware/Makefile`` once a process."""
    for program in ("make", "cc"):
        if shutil.which(program) is None:
            pytest.skip(f"no {program} on this machine")
    with tempfile.TemporaryDirectory(prefix="groundstation-tests-") as build:
        run_program(["make", "-s", "-C", FIRMWARE, f"BUILD={build}", "host"], check=True)
        library = ctypes.CDLL(str(Path(build, "libfirmware.so")))
    for name in ("sender_tick", "nrf24_receive", "nrf24_is_set"):
        getattr(library, name).restype = ctypes.c_bool
    library.queue_take_frame.restype = U8
    return library


def octets(data):
    return (U8 * len(data))(*data)


def packed(sample):
    """The packet of a sample, as the craft would send it."""
    packet = (U8 * 32)()
    firmware().sender_pack(packet, ctypes.byref(sample))
    return bytes(packet)


AFTER_RESET = {0: 0x08, 1: 0x3F, 2: 0x03, 3: 0x03, 4: 0x03, 5: 0x02, 6: 0x0E}


class Chip:
    """An nRF24L01+ on its SPI bus. ``bus`` is what the driver is given."""

    def __init__(self, *, miso=True):
        self.bus = Bus(TRANSFER(self._transfer), ENABLE(self._enable), WAIT(self._wait), None)
        self.miso = miso
        self.hear = lambda air, payload: None
        self.us = 0
        self.power_down()

    def power_down(self):
        """The supply drops: every register is as after a reset, the queues are empty."""
        self.registers = dict(AFTER_RESET)
        self.addresses = {0x0A: b"\xe7" * 5, 0x10: b"\xe7" * 5}
        self.waiting, self.received, self.high = [], [], False

    @property
    def interrupt(self):
        """The IRQ pin, which a received packet pulls low unless CONFIG masks it."""
        return bool(self.registers.get(7, 0) & 0x40) and not self.registers[0] & 0x40

    def air_of(self, address):
        """What must agree between two chips: channel, rate, address, checksum, acknowledgement."""
        names = (5, 6, 4, 1)
        return (*(self.registers.get(name, 0) for name in names), self.registers[0] & 0x0C, address)

    def take(self, air, payload):
        """What is on the air: kept by a powered receiver that listens to just that."""
        listens = self.registers[0] & 0x03 == 0x03 and self.high and self.registers.get(2, 0) & 1
        if not listens or air != self.air_of(self.addresses[0x0A]):
            return
        if self.registers.get(0x11, 0) == len(payload) and len(self.received) < 3:
            self.received.append(payload)
            self.registers[7] = self.registers.get(7, 0) | 0x40

    def _transfer(self, _board, out, into, size):
        data = bytes(out[:size])
        reply = self._answer(data).ljust(size, b"\0")[:size]
        if into and self.miso:
            for at, byte in enumerate(reply):
                into[at] = byte

    def _answer(self, data):
        command, rest = data[0], data[1:]
        status = self.registers.get(7, 0) | 0x0E
        reply = b""
        if command < 0x20:
            empty = 0x10 | (not self.received)
            reply = bytes([empty if command == 0x17 else self.registers.get(command, 0)])
        elif command < 0x40:
            self._write(command & 0x1F, rest)
        elif command == 0x61 and self.received:
            reply = self.received.pop(0)
        elif command == 0xA0 and len(self.waiting) < 3:
            self.waiting.append(rest)
        elif command == 0xE1:
            self.waiting = []
        elif command == 0xE2:
            self.received = []
        return bytes([status]) + reply

    def _write(self, register, data):
        if register in self.addresses:
            self.addresses[register] = data
        elif register == 7:
            self.registers[7] = self.registers.get(7, 0) & ~data[0]
        else:
            self.registers[register] = data[0]

    def _enable(self, _board, high):
        self.high, self.us = high, 0

    def _wait(self, _board, us):
        self.us += us
        if self.high and self.us >= 10 and self.registers[0] & 0x03 == 0x02 and self.waiting:
            self.hear(self.air_of(self.addresses[0x10]), self.waiting.pop(0))


class Craft:
    """``craft/sender.c`` on a chip without MISO."""

    def __init__(self):
        self.chip = Chip(miso=False)
        self.air = Air(60, octets(b"1LTSG"))
        self.sender = Sender()
        firmware().nrf24_start_transmitter(ctypes.byref(self.chip.bus), ctypes.byref(self.air))
        firmware().sender_init(ctypes.byref(self.sender))

    def publish(self, sample):
        firmware().sender_publish(ctypes.byref(self.sender), ctypes.byref(sample))

    def tick(self):
        """500 us pass; whether a packet was sent."""
        return firmware().sender_tick(
            ctypes.byref(self.sender), ctypes.byref(self.chip.bus), ctypes.byref(self.air)
        )


class Bridge:
    """``bridge/queue.c`` behind a receiving chip."""

    def __init__(self, forward_copies=True):
        self.chip = Chip()
        self.air = Air(60, octets(b"1LTSG"))
        self.queue = Queue()
        self.start()
        firmware().queue_init(ctypes.byref(self.queue), ctypes.c_bool(forward_copies))

    def start(self):
        firmware().nrf24_start_receiver(ctypes.byref(self.chip.bus), ctypes.byref(self.air))

    def is_set(self):
        return firmware().nrf24_is_set(ctypes.byref(self.chip.bus), ctypes.byref(self.air))

    def receive(self):
        """The interrupt: all that the radio holds, into the queue."""
        packet = (U8 * 32)()
        while firmware().nrf24_receive(ctypes.byref(self.chip.bus), packet):
            self.put(bytes(packet))

    def put(self, packet):
        firmware().queue_put(ctypes.byref(self.queue), octets(packet))

    def frame(self):
        """What the next USB frame carries."""
        frame = (U8 * 64)()
        return bytes(frame[: firmware().queue_take_frame(ctypes.byref(self.queue), frame)])
