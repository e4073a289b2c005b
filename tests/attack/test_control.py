"""The control API under attack by whoever may talk to it."""

import pytest

from groundstation.errors import GroundStationError
from groundstation.service.client import ask
from groundstation.service.config import Config, LinkConfig, RecordingConfig
from support.worlds import serve

pytestmark = pytest.mark.timeout(60)


@pytest.fixture
def config(tmp_path):
    """A daemon that waits for a device: attacks need no craft."""
    return Config(
        link=LinkConfig(name="serial:/dev/nope"),
        recording=RecordingConfig(folder=str(tmp_path / "sessions")),
    )


def test_a_mark_nested_without_end_is_refused_and_events_go_on(tmp_path, config):
    path = tmp_path / "control.sock"

    def conversation(station):
        ask(path, "POST", "/record/start")
        details = {}
        for _ in range(480):
            details = {"a": details}
        with pytest.raises(GroundStationError, match="nested deeper"):
            ask(path, "POST", "/record/mark", {"text": "deep", "details": details})
        ask(path, "POST", "/record/mark", {"text": "flat", "details": {"a": {"b": [1]}}})
        return ask(path, "GET", "/events"), station.journal.faults

    events, faults = serve(config, path, conversation)
    assert [event["text"] for event in events if event["kind"] == "mark"] == ["flat"]
    assert faults == 0
