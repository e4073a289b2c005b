"""A fleet as the viewer shows it: made rows in, the file read back, the real viewer asked."""

import numpy as np
import pytest
from rerun.chunk import RrdReader

from groundstation.errors import BadInputError
from groundstation.fleet.findings import DRAWN, drawn_crafts, findings_of
from groundstation.fleet.flight_fit import COLUMNS as FIT_COLUMNS
from groundstation.fleet.flight_fit import QUANTITIES
from groundstation.fleet.report import More, report
from groundstation.fleet.rrd import write_rrd
from groundstation.viewer.screenshot import hidden_viewer, software_driver

FLIGHTS, SINCE = 12, 7


def made(crafts):
    """A fleet of which the third craft has 10 % less thrust per mass since flight ``SINCE``."""
    random = np.random.default_rng(3)
    recordings, fits = [], {}
    for craft in range(crafts):
        for flight in range(FLIGHTS):
            address = f"/flights/cf{craft:02d}/{flight:02d}.mcap"
            begun = f"2026-03-{flight + 1:02d}T10:00:00+00:00"
            recordings.append({"address": address, "craft": f"cf{craft:02d}", "begun": begun})
            fit = dict.fromkeys(FIT_COLUMNS) | {"address": address}
            for name in QUANTITIES:
                fit[name] = random.normal(1.0, 0.01)
                fit[f"{name}_stderr"] = 0.01
            if craft == 2 and flight + 1 >= SINCE:
                fit["thrust_per_mass"] *= 0.9
            fits[address] = fit
    return findings_of(recordings, fits)


EFFECTS = {
    "cf01": {
        "reason": None, "parameters": ["dead_time.seconds"], "values": [0.008], "units": ["s"],
        "gap_before": 4.0, "gap_after": 1.1,
    },
    "cf02": {"reason": "too few rows"},
}  # fmt: skip


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("rrd") / "fleet.rrd"
    write_rrd(made(5), EFFECTS, "ours", path)
    return path


def columns(path):
    """Entity -> its rows of data."""
    reader, found = RrdReader(path), {}
    (recording,) = reader.recordings()
    for chunk in reader.stream(store=recording):
        found.setdefault(chunk.entity_path, []).append(chunk.to_record_batch())
    return found


def test_every_craft_s_trend_is_in_percent_of_the_fleet_s_middle(written):
    found = columns(written)
    trends = {name: rows for name, rows in found.items() if name.startswith("/trends/")}
    assert len(trends) == 5 * len(QUANTITIES)
    (values,) = (
        batch["Scalars:scalars"].flatten().to_numpy()
        for batch in trends["/trends/thrust_per_mass/cf02"]
        if "Scalars:scalars" in batch.schema.names
    )
    assert len(values) == FLIGHTS
    assert values[: SINCE - 1].mean() == pytest.approx(0.0, abs=2.0)
    assert values[SINCE - 1 :].mean() == pytest.approx(-10.0, abs=2.0)


def test_findings_and_effects_are_told_in_words(written):
    found = columns(written)
    (text,) = (batch["TextDocument:text"].flatten().to_pylist()[0] for batch in found["/found"])
    assert "cf02: thrust per mass" in text
    assert f"flight {SINCE} of {FLIGHTS}" in text
    assert "| cf01 | dead_time.seconds 0.008 s | 4.00 → 1.10 |" in text
    told = [batch["TextLog:text"].flatten().to_pylist() for batch in found["/events"]]
    assert any("thrust per mass" in line for lines in told for line in lines)


def test_of_many_crafts_those_with_findings_are_drawn():
    fleet = made(DRAWN + 10)
    crafts = drawn_crafts(fleet)
    assert len(crafts) == DRAWN
    assert "cf02" in crafts
    assert {one.craft for one in fleet.findings} <= set(crafts)
    page = report(fleet, [], {}, "ours", More({}, {}, {}, {})).html()
    assert f"{DRAWN} of {DRAWN + 10} crafts, those with findings first" in page
    assert {f"cf{k:02d}" for k in range(DRAWN + 10) if f"<td>cf{k:02d}</td>" in page} == set(crafts)


def test_a_file_that_is_there_is_left_alone(tmp_path):
    path = tmp_path / "fleet.rrd"
    path.write_text("precious")
    with pytest.raises(BadInputError, match="exists"):
        write_rrd(made(4), {}, "ours", path)
    assert path.read_text() == "precious"


@pytest.mark.screenshot
@pytest.mark.skipif(
    software_driver() is None,
    reason="no software Vulkan driver: apt-get install mesa-vulkan-drivers libvulkan1",
)
def test_the_viewer_shows_it_without_complaint(written):
    with hidden_viewer(written) as viewer:
        names = viewer.views()
    assert {"What was found", "Crafts by quantities", "Since when"} <= set(names)
    assert "thrust per mass (% from the middle)" in names
