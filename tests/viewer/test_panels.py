"""What a fit was made of, as a file for the viewer."""

import numpy as np
import pytest
from rerun.chunk import RrdReader

from groundstation.errors import BadInputError
from groundstation.identification.fit_record import Evidence, Panel, Trace
from groundstation.viewer.panels import write_panels

TIME_S = 0.002 * np.arange(5000)


def entities(path):
    found = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if "Scalars:scalars" in batch.schema.names:
            values = batch.column("Scalars:scalars").flatten().to_numpy()
            found.setdefault(str(chunk.entity_path), []).append(values)
    return {name: np.concatenate(parts) for name, parts in found.items()}


class Prepared:
    def panels(self):
        half = np.where(np.arange(5000) % 10, 2.0, np.nan)
        return [Panel("Half periods (ms)", TIME_S, {"kept": half, "left out": 4.0 - half}, True)]


def test_every_series_is_in_the_file_without_what_is_not_known(tmp_path):
    trace = Trace("roll rate", "deg/s", TIME_S, np.sin(TIME_S), np.cos(TIME_S), "20 ms ahead")
    panels = Evidence(traces=[trace], preparation=Prepared()).panels()
    assert panels[1].title == "Roll rate (deg/s), held out"
    write_panels(panels, "# body of flight.mcap", tmp_path / "body.rrd")
    found = entities(tmp_path / "body.rrd")
    assert len(found["/panels/0/kept"]) == 4500
    np.testing.assert_array_equal(found["/panels/1/measured"], np.sin(TIME_S))
    np.testing.assert_array_equal(found["/panels/1/modelled"], np.cos(TIME_S))
    with pytest.raises(BadInputError):
        write_panels(panels, "", tmp_path / "body.rrd")
