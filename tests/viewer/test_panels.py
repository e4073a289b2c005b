"""What a fit was made of, as a file for the viewer."""

import numpy as np
import pytest

from groundstation.errors import BadInputError
from groundstation.identification.fit_record import Evidence, Panel, Trace
from groundstation.viewer.panels import write_panels
from support.rrd import SCALARS, column

TIME_S = 0.002 * np.arange(5000)


class Prepared:
    def panels(self):
        half = np.where(np.arange(5000) % 10, 2.0, np.nan)
        return [Panel("Half periods (ms)", TIME_S, {"kept": half, "left out": 4.0 - half}, True)]


def test_every_series_is_in_the_file_without_what_is_not_known(tmp_path):
    trace = Trace("roll rate", "deg/s", TIME_S, np.sin(TIME_S), np.cos(TIME_S), "20 ms ahead")
    panels = Evidence(traces=[trace], preparation=Prepared()).panels()
    assert panels[1].title == "Roll rate (deg/s), held out"
    write_panels(panels, "# body of flight.mcap", tmp_path / "body.rrd")
    found = column(tmp_path / "body.rrd", SCALARS)
    assert len(found["/panels/0/kept"]) == 4500
    np.testing.assert_array_equal(found["/panels/1/measured"][:, 0], np.sin(TIME_S))
    np.testing.assert_array_equal(found["/panels/1/modelled"][:, 0], np.cos(TIME_S))
    with pytest.raises(BadInputError):
        write_panels(panels, "", tmp_path / "body.rrd")
