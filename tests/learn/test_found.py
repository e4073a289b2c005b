"""What a search found, read from its report."""

import msgspec
import pytest

from groundstation.discrepancy.proof import NotShown
from groundstation.identification.likelihood.motion import KEYS
from groundstation.learn.story import found_line, known_errors, named_effects, read_found
from support.findings import NAME, findings, proof, report


@pytest.fixture
def written(tmp_path):
    """A function that writes a report with other parts and reads it back."""
    found = findings()
    whole = report(found, proof(found))

    def read(**parts):
        path = tmp_path / "found1.json"
        path.write_bytes(msgspec.json.encode(msgspec.structs.replace(whole, **parts)))
        return read_found(path)

    return read


def test_what_flights_cannot_show_at_all_is_as_little_known_as_before_them(written):
    unseen = NotShown("ground_effect", "gain", None, 0.25, "", "take off and land")
    known = known_errors(written(not_shown=[unseen], effects=[]))
    assert known["ground_effect.gain"] == KEYS["ground_effect.gain"].worth
    assert known["dead_time.delay_s"] < KEYS["dead_time.delay_s"].worth


def test_what_is_found_is_named_with_its_numbers_and_what_it_could_also_be(written):
    found = written()
    assert [one.name for one in named_effects(found)] == [NAME]
    line = found_line(found)
    assert f"named: {NAME} (moment 15 ± 0.2 rad/s^2 per m/s)" in line
    assert f"{NAME} could also be rate_damping" in line
