"""The images for the target: they link, fit their chips and begin as a Cortex-M starts."""

import re
import shutil
import struct

import pytest

from support.firmware import FIRMWARE
from support.programs import run_program

RAM, FLASH = 0x20000000, 0x08000000


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    if shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip("no arm-none-eabi-gcc (Debian: gcc-arm-none-eabi, libnewlib-arm-none-eabi)")
    folder = tmp_path_factory.mktemp("firmware")
    done = run_program(["make", "-C", FIRMWARE, f"BUILD={folder}"], check=True)
    sizes = re.findall(r"^ +(\d+)\t +(\d+)\t +(\d+).*/(\w+)\.elf$", done.stdout, re.M)
    for text, data, bss, name in sizes:
        print(f"{name}: {int(text) + int(data)} bytes of flash, {int(data) + int(bss)} of memory")
    return folder, {name: (int(t) + int(d), int(d) + int(b)) for t, d, b, name in sizes}


@pytest.mark.parametrize(
    ("image", "ram", "irq", "handler"),
    [
        ("bridge", 128 << 10, 67, "usb_interrupt"),
        ("bridge", 128 << 10, 7, "radio_interrupt"),
        ("link_test", 20 << 10, 29, "telemetry_send_interrupt"),
        ("link_test", 20 << 10, 6, "telemetry_blade_interrupt"),
    ],
)
def test_an_image_begins_with_the_stack_the_reset_and_its_interrupts(
    built, image, ram, irq, handler
):
    folder, _ = built
    listed = run_program(["arm-none-eabi-nm", folder / f"{image}.elf"], check=True).stdout
    address = {name: int(at, 16) for at, name in re.findall(r"^(\w+) \w (\w+)$", listed, re.M)}
    data = (folder / f"{image}.bin").read_bytes()
    words = struct.unpack_from("<98I" if image == "bridge" else "<59I", data)
    assert words[0] == RAM + ram
    assert words[1] == address["start_reset"] | 1
    assert words[16 + irq] == address[handler] | 1
    assert FLASH <= address["main"] < FLASH + len(data)


def test_the_images_are_small_beside_their_chips(built):
    _, sizes = built
    for image, flash, memory in (
        ("bridge", 1 << 20, 128 << 10),
        ("link_test", 128 << 10, 20 << 10),
    ):
        used_flash, used_memory = sizes[image]
        assert 1000 < used_flash < flash / 10
        assert 0 < used_memory < memory / 10


def test_a_craft_links_the_telemetry_without_anything_but_the_c_library(built):
    folder, _ = built
    listed = run_program(["arm-none-eabi-nm", folder / "libtelemetry.a"], check=True).stdout
    wanted = set(re.findall(r"^ +U (\w+)$", listed, re.M))
    defined = set(re.findall(r"^\w+ [TDBR] (\w+)$", listed, re.M))
    from_elsewhere = {name for name in wanted - defined if not name.startswith("__aeabi_")}
    assert from_elsewhere <= {"memcpy", "memset", "memcmp"}
