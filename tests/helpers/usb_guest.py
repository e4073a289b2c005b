"""Runs the tests of ``tests/usb_vm/guest`` inside the virtual machine."""

import json
import subprocess
import sys
from pathlib import Path

import virtual_machine

PROJECT = Path(__file__).parents[2]
HELPERS = Path(__file__).parent
GUEST = PROJECT / "tests" / "usb_vm" / "guest"
PATIENCE_S = 1500
FLIGHTS = {"flight": (200, ""), "filtered": (60, "bridge_dedup = true\n")}


def run_guest(out, chosen="."):
    """Run the tests in the machine, or those of one file; what they said.

    In virtual time (10^9 instructions a second), which the load of this machine cannot touch:
    what is lost there is lost by the program.
    """
    for name, (seconds, settings) in FLIGHTS.items():
        sound = out / f"{name}.toml"
        sound.write_text(f"{settings}[loss]\ngood_loss = 0.0\n")
        subprocess.run(
            [sys.executable, "-m", "firmware_sim", "--settings", sound, "--for", str(seconds),
             "--fast", "-o", out / f"{name}.npz"],
            check=True, cwd=PROJECT,
        )  # fmt: skip
    command = [
        # plugins that nothing here uses take longer to load than some tests to run
        "env", "GROUNDSTATION_USB_VM=1", "PYTEST_DISABLE_PLUGIN_AUTOLOAD=1",
        f"PYTHONPATH={GUEST}:{HELPERS}",
        sys.executable, "-m", "pytest", "-q", "-rA", "--durations=15", "-p", "pytest_timeout",
        "--timeout=0", "-p", "no:cacheprovider", f"--confcutdir={GUEST}", str(GUEST / chosen),
    ]  # fmt: skip
    return virtual_machine.run(command, out, icount="sleep=off", timeout_s=PATIENCE_S, cwd=PROJECT)


def table(out):
    """What each reader lost and cost, one row each."""
    return [json.loads(line) for line in (out / "table.jsonl").read_text().splitlines()]
