"""The USB link through a real kernel: ``guest`` runs inside a virtual machine, once for all."""

import re

import numpy as np
import pytest
import virtual_machine
from one_flight import BRIDGES, OneFlight, require_equal
from usb_guest import PATIENCE_S, run_guest, table

from firmware_sim.serial_port import SerialPort
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch

LEAST_TESTS = 43
TOLD = r"^(?:unplug seen|descriptors,|CPU while|\| .* \| \d+ \| \d+ \|$).*"
"""What the guest's tests measured, beside the table."""
pytestmark = pytest.mark.timeout(PATIENCE_S + 100)


@pytest.fixture(scope="module")
def flights():
    return {name: OneFlight(deduplicated) for name, deduplicated in BRIDGES.items()}


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
    assert min(row["frames"] for row in ring) >= 20_000
    assert min(row["lost"] for row in plain) > 0


@pytest.mark.parametrize("bridge", BRIDGES)
def test_one_flight_is_the_same_through_all_four_links(guest, flights, tmp_path, bridge):
    _, out = guest
    flight = flights[bridge]
    flown = flight.through_stand_in()
    through_stand_in, counts = decode_all(flown)
    assert counts.lost > 0
    assert len(through_stand_in) > 900
    through_replay = flight.through_replay(flown, tmp_path / "flight.mcap")
    require_equal(through_replay, through_stand_in, "replay")
    with SerialPort("pty") as line:
        require_equal(flight.through_serial(line), through_stand_in, "serial")
    with np.load(out / f"{bridge} through usb.npz") as received:
        through_usb, _ = decode_all(RawBatch(received["packets"], received["ns"]))
    require_equal(through_usb, through_stand_in, "USB")
