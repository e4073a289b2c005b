"""The USB link through a real kernel: ``guest`` runs inside a virtual machine, once for all."""

import json
import os
import re
import shutil
import sys

import numpy as np
import pytest

from firmware_sim.serial_port import SerialPort
from groundstation.links.replay import FAST
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch
from support import ROOT, virtual_machine
from support.one_flight import (
    BRIDGES,
    OneFlight,
    flight_and_bench,
    record,
    require_equal,
    require_same_on_this_machine,
    results,
)
from support.programs import run_program

TESTS = ROOT / "tests"
GUEST = TESTS / "usb_vm" / "guest"
PATIENCE_S, COMPILING_S = 3600, 900
FLIGHT_S = 100
SOUND_RADIO = "[loss]\ngood_loss = 0.0\n"
LEAST_TESTS = 33
TOLD = r"^(?:unplug seen|descriptors,|CPU while|\| .* \| \d+ \| \d+ \|$).*"
"""What the guest's tests measured, beside the table."""
pytestmark = pytest.mark.timeout(PATIENCE_S + 100)


@pytest.fixture(scope="module")
def flights():
    short = {name: OneFlight(deduplicated) for name, deduplicated in BRIDGES.items()}
    return {**short, **flight_and_bench()}


@pytest.fixture(scope="module")
def guest(flights, tmp_path_factory):
    """What the guest's tests said, and the folder with what they left."""
    if reason := virtual_machine.why_not():
        pytest.skip(f"no virtual machine for USB: {reason}")
    out = tmp_path_factory.mktemp("guest")
    return run_guest(out, flights=flights), out


def show(rows):
    """As they stand in docs/usb.md."""
    print("| reader | frames delivered | lost | CPU | stamps within | latency median, 99 % |")
    print("|---|---|---|---|---|---|")
    for row in rows:
        cells = [row["reader"], f"{row['frames']:,}", f"{row['lost']:,}", f"{row['cpu_pct']:.1f} %"]
        if row["latency_ms"] is not None:
            cells.append(f"{row['stamp_spread_ms']:.2f} ms")
            cells.append("{:.1f}, {:.1f} ms".format(*row["latency_ms"]))
        print(f"| {' | '.join(cells)} |")


def test_every_test_of_the_guest_passes(guest):
    result, _ = guest
    assert result.status == 0, result.output
    passed = re.search(r"^(\d+) passed in", result.output, re.MULTILINE)
    assert passed, result.output
    assert int(passed[1]) >= LEAST_TESTS


def test_the_ring_loses_no_frame_where_plain_reads_lose_many(guest):
    result, out = guest
    rows = table(out)
    show(rows)
    print(*re.findall(TOLD, result.output, re.MULTILINE), sep="\n")
    ring = [row for row in rows if row["reader"].startswith("ring")]
    plain = [row for row in rows if not row["reader"].startswith("ring")]
    assert [row["lost"] for row in ring] == [0, 0]
    assert min(row["frames"] for row in ring) >= 5_000
    assert min(row["lost"] for row in plain) > 0


@pytest.mark.parametrize("bridge", BRIDGES)
def test_one_flight_is_the_same_through_all_four_links(guest, flights, tmp_path, bridge):
    _, out = guest
    flight = flights[bridge]
    with SerialPort("pty") as line:
        samples = require_same_on_this_machine(flight, line, tmp_path / "flight.mcap")
    through_usb, _ = decode_all(through_usb_of(bridge, out))
    require_equal(through_usb, samples, "USB")


def test_models_gains_and_effects_are_the_same_through_usb(guest, flights, tmp_path):
    """Stand-in, replay and serial: ``tests/system/test_run_on_either.py``."""
    _, out = guest
    stand_in, usb = tmp_path / "stand-in", tmp_path / "usb"
    for folder in (stand_in, usb):
        folder.mkdir()
    for name in ("flight", "bench"):
        record(flights[name].through_stand_in(speed=FAST), stand_in / f"{name}.mcap")
        record(through_usb_of(name, out), usb / f"{name}.mcap")
    assert results(usb) == results(stand_in)


def through_usb_of(name, out):
    """What the link in the guest received of a flight."""
    with np.load(out / f"{name} through usb.npz") as received:
        return RawBatch(received["packets"], received["ns"])


def run_guest(out, chosen=".", flights=None):
    """Run the tests in the machine, or those of one file; what they said.

    flights: by name, to be sent over USB from power-on to their end.

    In virtual time (10^9 instructions a second), which the load of this machine cannot touch:
    what is lost there is lost by the program.
    """
    for name, flight in (flights or {}).items():
        np.savez(out / f"{name}.npz", packets=flight.packets, arrival_s=flight.arrival_s)
    (out / "sound_flight.toml").write_text(SOUND_RADIO)
    _compile_for_the_guest(out)
    _leave_byte_code()
    command = [
        # plugins that nothing here uses take longer to load than some tests to run
        "env", "GROUNDSTATION_USB_VM=1", "PYTEST_DISABLE_PLUGIN_AUTOLOAD=1",
        f"PYTHONPATH={GUEST}:{TESTS}:{ROOT}",
        sys.executable, "-m", "pytest", "-q", "-rA", "--durations=15", "-p", "pytest_timeout",
        "-p", "pytest_rerunfailures",
        # the guest's time runs on while it waits for files of a busy host: no limits by it
        "--timeout=0", "-o", "faulthandler_timeout=0", "-p", "no:cacheprovider",
        f"--confcutdir={GUEST}", str(GUEST / chosen),
    ]  # fmt: skip
    return virtual_machine.run(command, out, icount="sleep=off", timeout_s=PATIENCE_S, cwd=ROOT)


def _compile_for_the_guest(out):
    """Fly ``sound_flight.npz``; what that compiled, for a processor as the guest has it, is left in
    ``numba``: the guest itself would take longer than its tests.
    """
    compiled = virtual_machine.cache_folder() / "numba"
    generic = {"NUMBA_CPU_NAME": "generic", "NUMBA_CACHE_DIR": str(compiled)}
    run_program(
        [sys.executable, "-m", "firmware_sim", "--settings", out / "sound_flight.toml",
         "--for", str(FLIGHT_S), "--fast", "-o", out / "sound_flight.npz"],
        # at the lowest priority beside other tests, compiling gets what they leave
        timeout=COMPILING_S, check=True, cwd=ROOT, env={**os.environ, **generic},
    )  # fmt: skip
    shutil.copytree(compiled, out / "numba")


def _leave_byte_code():
    """The guest may not write it: each of its programs would compile all that it imports."""
    run_program(
        [sys.executable, "-m", "compileall", "-q", "groundstation", "firmware_sim",
         TESTS / "support", GUEST],
        timeout=COMPILING_S, check=True, cwd=ROOT,
    )  # fmt: skip


def table(out):
    """What each reader lost and cost, one row each."""
    return [json.loads(line) for line in (out / "table.jsonl").read_text().splitlines()]
