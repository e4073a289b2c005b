"""Runs the tests of ``tests/usb_vm/guest`` inside the virtual machine."""

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np

from support import virtual_machine
from support.programs import run_program

PROJECT = Path(__file__).parents[2]
TESTS = PROJECT / "tests"
GUEST = TESTS / "usb_vm" / "guest"
PATIENCE_S = 3600
COMPILING_S = 900
FLIGHT_S = 100
SOUND_RADIO = "[loss]\ngood_loss = 0.0\n"


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
        f"PYTHONPATH={GUEST}:{TESTS}:{PROJECT}",
        sys.executable, "-m", "pytest", "-q", "-rA", "--durations=15", "-p", "pytest_timeout",
        "-p", "pytest_rerunfailures",
        # the guest's time runs on while it waits for files of a busy host: no limits by it
        "--timeout=0", "-o", "faulthandler_timeout=0", "-p", "no:cacheprovider",
        f"--confcutdir={GUEST}", str(GUEST / chosen),
    ]  # fmt: skip
    return virtual_machine.run(command, out, icount="sleep=off", timeout_s=PATIENCE_S, cwd=PROJECT)


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
        timeout=COMPILING_S, check=True, cwd=PROJECT, env={**os.environ, **generic},
    )  # fmt: skip
    shutil.copytree(compiled, out / "numba")


def _leave_byte_code():
    """The guest may not write it: each of its programs would compile all that it imports."""
    run_program(
        [sys.executable, "-m", "compileall", "-q", "groundstation", "firmware_sim",
         TESTS / "support", GUEST],
        timeout=COMPILING_S, check=True, cwd=PROJECT,
    )  # fmt: skip


def table(out):
    """What each reader lost and cost, one row each."""
    return [json.loads(line) for line in (out / "table.jsonl").read_text().splitlines()]
