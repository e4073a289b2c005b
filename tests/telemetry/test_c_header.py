"""The C header, compiled by a C compiler and compared with the Python codec."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from groundstation.telemetry import packet as bridge_usb
from groundstation.telemetry.packet import encode, frame_packets
from support.programs import run_program
from support.usb_device import configuration_descriptor, device_descriptor

HEADER = Path(bridge_usb.__file__).with_name("groundstation_telemetry.h").read_text()
GOLDEN = bytes.fromhex(
    "06 24 aa 0c 30 8d c3 98 8b c7 43 fe b5 02 b5 ffb7 fe 4a 0c 1b 1e f3 fe d1 fd c0 f3 80 4f 50 49"
)
"""Row 8517 of the thesis's excerpt, debug 1230000000."""

INCLUDE = '#include "groundstation_telemetry.h"\n#include <stdio.h>\n'
DUMP = "static void dump(const void *p, size_t n) { fwrite(p, 1, n, stdout); }\n"
GOLDEN_PROGRAM = (
    INCLUDE
    + DUMP
    + """
int main(void)
{
    const uint16_t motors[4] = {3376, 3128, 2968, 3192};
    uint8_t frame[GROUNDSTATION_FRAME_BYTES];
    groundstation_packet packet;
    packet.timestamp = (uint16_t)17114118UL;
    packet.battery = 3242;
    groundstation_pack_motors(packet.motors, motors);
    packet.gyro[0] = -445; packet.gyro[1] = 693; packet.gyro[2] = -75;
    packet.accelerometer[0] = -329; packet.accelerometer[1] = 3146;
    packet.accelerometer[2] = 7707;
    packet.angles[0] = -269; packet.angles[1] = -559; packet.angles[2] = -3136;
    packet.debug = 1230000000UL;
    groundstation_frame(frame, &packet);
    dump(&packet, sizeof packet);
    dump(frame, sizeof frame);
    return 0;
}
"""
)
STREAM_PROGRAM = (
    INCLUDE
    + DUMP
    + """
int main(void) /* motors and packet bytes in, packets with those motors and frames out */
{
    uint16_t motors[4];
    groundstation_packet packet;
    uint8_t frame[GROUNDSTATION_FRAME_BYTES];
    while (fread(&packet, sizeof packet, 1, stdin) && fread(motors, sizeof motors, 1, stdin)) {
        groundstation_pack_motors(packet.motors, motors);
        groundstation_frame(frame, &packet);
        dump(&packet, sizeof packet);
        dump(frame, sizeof frame);
    }
    return 0;
}
"""
)
CONSTANTS_PROGRAM = (
    INCLUDE
    + DUMP
    + """
int main(void)
{
    printf("%d %d %lu %04x %04x %d %d %02x %d %04x\\n", GROUNDSTATION_PACKET_BYTES,
           GROUNDSTATION_FRAME_BYTES, GROUNDSTATION_BAUD, GROUNDSTATION_USB_VENDOR_ID,
           GROUNDSTATION_USB_PRODUCT_ID, GROUNDSTATION_USB_INTERFACE,
           GROUNDSTATION_USB_ALTERNATE, GROUNDSTATION_USB_ENDPOINT,
           GROUNDSTATION_USB_FRAME_BYTES, groundstation_crc16((const uint8_t *)"123456789", 9));
    dump(groundstation_usb_device_descriptor, sizeof groundstation_usb_device_descriptor);
    dump(groundstation_usb_configuration_descriptor,
         sizeof groundstation_usb_configuration_descriptor);
    return 0;
}
"""
)
STRICT = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-Wno-unused"]


@pytest.fixture
def compiled(tmp_path):
    """Compiles a program against the header; gives what it answers to bytes."""
    (tmp_path / "groundstation_telemetry.h").write_text(HEADER)

    def build(program, compiler="cc", standard="c99"):
        if shutil.which(compiler) is None:
            pytest.skip(f"no {compiler} on this machine")
        source = tmp_path / ("program.cpp" if "++" in standard else "program.c")
        source.write_text(program)
        binary = tmp_path / "program"
        command = [compiler, f"-std={standard}", *STRICT, "-o", str(binary), str(source)]
        result = run_program(command)
        assert result.returncode == 0, result.stderr
        return lambda data=b"": run_program([binary], input=data, text=False, check=True).stdout

    return build


@pytest.mark.parametrize(
    ("compiler", "standard"), [("cc", "c99"), ("cc", "c17"), ("c++", "c++11"), ("c++", "c++20")]
)
def test_the_golden_packet_comes_out_of_c(compiled, compiler, standard):
    out = compiled(GOLDEN_PROGRAM, compiler, standard)()
    assert out[:32] == GOLDEN
    assert out[32:] == frame_packets(np.frombuffer(GOLDEN, np.uint8).reshape(1, 32))


def test_any_packet_and_its_frame_are_those_of_the_codec(compiled):
    rng = np.random.default_rng(0)
    n = 2000
    motors = rng.integers(0, 4096, (n, 4))
    zeros = rng.integers(0, 2, (n, 1))  # half of the packets are nearly empty
    packets = encode(
        rng.integers(0, 65536, n) * zeros[:, 0],
        rng.integers(0, 6000, n) * zeros[:, 0],
        motors,
        rng.integers(-32768, 32768, (n, 3)) * zeros,
        rng.integers(-32768, 32768, (n, 3)) * zeros,
        rng.integers(-32768, 32768, (n, 3)),
        rng.integers(0, 1 << 32, n) * zeros[:, 0],
    )
    blank = packets.copy()
    blank[:, 4:10] = 0xA5
    words = motors.astype("<u2").view(np.uint8).reshape(n, 8)
    out = compiled(STREAM_PROGRAM)(np.hstack([blank, words]).tobytes())
    rows = np.frombuffer(out, np.uint8).reshape(n, 32 + 36)
    np.testing.assert_array_equal(rows[:, :32], packets)
    assert rows[:, 32:].tobytes() == frame_packets(packets)


def test_constants_and_descriptors_are_those_of_the_package(compiled):
    line, _, descriptors = compiled(CONSTANTS_PROGRAM)().partition(b"\n")
    assert line == b"32 36 2000000 0483 5741 0 1 81 64 29b1"
    assert descriptors == device_descriptor() + configuration_descriptor()


def test_the_descriptors_say_what_a_host_expects():
    """Read by the rules of USB 2.0, chapter 9."""
    device, data = device_descriptor(), configuration_descriptor()
    assert (device[0], device[1], len(device)) == (18, 1, 18)
    assert device[8:12] == bytes([0x83, 0x04, 0x41, 0x57])
    assert int.from_bytes(data[2:4], "little") == len(data)
    parts = []
    while data:
        parts.append(data[: data[0]])
        data = data[data[0] :]
    kinds = [part[1] for part in parts]
    assert kinds == [2, 4, 4, 5]
    _, idle, active, endpoint = parts
    assert (idle[2], idle[3], idle[4]) == (0, 0, 0)
    assert (active[2], active[3], active[4], active[5]) == (0, 1, 1, 0xFF)
    assert (endpoint[2], endpoint[3] & 3) == (0x81, 1)
    assert int.from_bytes(endpoint[4:6], "little") == 64
    assert endpoint[6] == 1


def test_a_layout_that_differs_does_not_compile(tmp_path):
    if shutil.which("cc") is None:
        pytest.skip("no cc on this machine")
    text = HEADER.replace("uint16_t battery;", "uint32_t battery;")
    (tmp_path / "groundstation_telemetry.h").write_text(text)
    result = run_program(
        ["cc", "-fsyntax-only", "-x", "c", "-"],
        input=INCLUDE,
        cwd=tmp_path,
        env={"PATH": "/usr/bin:/bin", "CPATH": str(tmp_path)},
    )
    assert result.returncode != 0
    assert "negative" in result.stderr
