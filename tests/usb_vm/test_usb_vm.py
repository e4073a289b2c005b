"""The USB link through a real kernel: ``guest`` runs inside a virtual machine."""

import re

import pytest
import virtual_machine
from usb_guest import PATIENCE_S, run_guest, table

LEAST_TESTS = 38


def show(rows):
    print(f"{'reader':<66}{'frames':>8}{'lost':>7}{'CPU %':>8}{'stamps ms':>11}{'latency ms':>14}")
    for row in rows:
        spread = "-" if row["stamp_spread_ms"] is None else f"{row['stamp_spread_ms']:.3f}"
        latency = "-" if row["latency_ms"] is None else "{:.1f}, {:.1f}".format(*row["latency_ms"])
        print(
            f"{row['reader']:<66}{row['frames']:>8}{row['lost']:>7}{row['cpu_pct']:>8.1f}"
            f"{spread:>11}{latency:>14}"
        )


@pytest.mark.timeout(PATIENCE_S + 100)
def test_the_link_passes_every_test_of_the_guest_and_loses_nothing(tmp_path):
    if reason := virtual_machine.why_not():
        pytest.skip(f"no virtual machine for USB: {reason}")
    result = run_guest(tmp_path)
    assert result.status == 0, result.output
    passed = re.search(r"^(\d+) passed in", result.output, re.MULTILINE)
    assert passed, result.output
    assert int(passed[1]) >= LEAST_TESTS
    told = r"^(?:unplug seen|descriptors,|CPU while).*"
    print("\n".join(re.findall(told, result.output, re.MULTILINE)))
    rows = table(tmp_path)
    show(rows)
    ring = [row for row in rows if row["reader"].startswith("ring")]
    plain = [row for row in rows if not row["reader"].startswith("ring")]
    assert [row["lost"] for row in ring] == [0, 0]
    assert min(row["frames"] for row in ring) >= 20_000
    assert min(row["lost"] for row in plain) > 0
