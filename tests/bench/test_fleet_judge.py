"""The judge of sealed fleets: made lines in, counts out."""

from bench.fleet.judge import named, table

ROTOR = {"craft": "cf01", "kind": "rotor", "since": 6, "size": -0.05, "rotor": 3}


def finding(craft, quantity, flight, kind="change"):
    return {
        "craft": craft, "quantity": quantity, "flight": flight, "kind": kind, "text": f"of {craft}"
    }  # fmt: skip


def test_a_fault_is_named_by_its_craft_its_quantity_and_its_date():
    assert named(ROTOR, [finding("cf01", "rotor_3", 7)]) == 1
    assert named(ROTOR, [finding("cf02", "rotor_3", 6)]) is None
    assert named(ROTOR, [finding("cf01", "rotor_1", 6)]) is None
    assert named(ROTOR, [finding("cf01", "rotor_3", 1, "differs")]) is None


def test_a_fault_named_too_late_and_a_craft_wronged_are_counted():
    late = {"case": "ill:0", "truth": [ROTOR], "findings": [finding("cf01", "rotor_3", 12)]}
    wrong = {"case": "sound:0", "truth": [], "findings": [finding("cf02", "c0", 5)]}
    said = table([{**late, "tests": 80}, {**wrong, "tests": 80}])
    assert "| rotor | 1 | 0 | 0 |" in said
    assert "Fleets without faults: 1, 80 tests; with a false finding: 1." in said
    assert "sound:0: of cf02" in said
