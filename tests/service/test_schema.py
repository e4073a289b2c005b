"""The API's schema is true, and whatever it allows or forbids is answered and survived."""

import http.client
import json
import socket
import time

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.links.command import LinkEvent
from groundstation.recording.mcap_scan import CatalogueEntry
from groundstation.service.client import Client
from groundstation.service.config import Config, RecordingConfig
from groundstation.service.requests import HealthStatus, Status
from support.worlds import serve

EXPECTED = {200, 400, 403, 404, 405, 409, 413, 429, 503}
NUMBERS = st.one_of(
    st.floats(-1e6, 1e6), st.integers(-(2**70), 2**70), st.sampled_from([0, -0.0, 1e308, 5e-324])
)
TEXTS = st.one_of(
    st.text(max_size=80),
    st.sampled_from(["", "../..", "replay:../../etc/passwd", "serial:/etc/passwd", "usb:", "\0"]),
)
ANYTHING = st.recursive(
    st.one_of(st.none(), st.booleans(), NUMBERS, TEXTS),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(TEXTS, inner, max_size=4)),
    max_leaves=12,
)


def valid(schema, components):
    """A strategy for what ``schema`` allows."""
    if "$ref" in schema:
        return valid(components[schema["$ref"].rsplit("/", 1)[-1]], components)
    if "anyOf" in schema:
        return st.one_of(*(valid(each, components) for each in schema["anyOf"]))
    kind = schema.get("type")
    if kind == "object" and "properties" in schema:
        required = set(schema.get("required", ()))
        fields = {name: valid(each, components) for name, each in schema["properties"].items()}
        return st.fixed_dictionaries(
            {name: each for name, each in fields.items() if name in required},
            optional={name: each for name, each in fields.items() if name not in required},
        )
    if kind == "object":
        content = schema.get("additionalProperties") or {}
        inner = valid(content, components) if content else ANYTHING
        return st.dictionaries(TEXTS, inner, min_size=schema.get("minProperties", 0), max_size=4)
    if kind == "string":
        low, high = schema.get("minLength", 0), min(schema.get("maxLength", 60), 60)
        return st.one_of(st.text(min_size=low, max_size=high), TEXTS)
    if kind == "integer":
        return st.integers(-10, 70000)
    if kind == "number":
        return NUMBERS
    return ANYTHING


class Api:
    """The daemon's API as its schema describes it."""

    def __init__(self, path):
        self.path = path
        with Client(path) as client:
            self.schema = client.ask("GET", "/openapi.json")
        self.components = self.schema["components"]["schemas"]
        self.operations = [
            (method.upper(), route, described)
            for route, methods in self.schema["paths"].items()
            for method, described in methods.items()
            if route != "/stream"
        ]

    def body(self, described):
        content = described["requestBody"]["content"]["application/json"]["schema"]
        return valid(content, self.components)

    def send(self, method, route, body=b""):
        """Status and decoded answer of one request with whatever body."""
        connection = http.client.HTTPConnection("localhost", timeout=20)
        connection.sock = socket.socket(socket.AF_UNIX)
        connection.sock.settimeout(20)
        connection.sock.connect(str(self.path))
        try:
            connection.request(method, route, body, {"Content-Type": "application/json"})
            answer = connection.getresponse()
            content = answer.read()
            is_json = answer.headers.get_content_type() == "application/json"
            has_json = is_json and method != "HEAD"  # which has the headers only
            return answer.status, json.loads(content) if has_json else content
        finally:
            connection.close()


@pytest.fixture
def fuzz(tmp_path, monkeypatch):
    """Runs a conversation with the API of a station on its stand-in; the station afterwards."""
    from groundstation.service import control

    monkeypatch.setattr(control, "REQUESTS_HZ", 1e6)
    monkeypatch.setattr(control, "REQUESTS_BURST", 1e6)

    def fuzzing(conversation):
        path = tmp_path / "control.sock"
        config = Config(
            recording=RecordingConfig(folder=str(tmp_path / "sessions"), low_space_mb=0)
        )

        def talk(station):
            conversation(Api(path))
            told = [event.text for event in station.journal.events if event.kind == "fault"]
            assert station.journal.faults == 0, told
            assert station.receiver.state.value == "streaming"
            assert station.receiver.link.name == "stand-in"
            assert station.commander.setpoints == 0

        serve(config, path, talk)
        return tmp_path

    return fuzzing


def answers_as_described(api, method, route, described):
    bodies = api.body(described) if "requestBody" in described else st.just(None)

    @settings(max_examples=12, database=None)
    @given(bodies)
    def check(body):
        status, answer = api.send(method, route, b"" if body is None else json.dumps(body).encode())
        assert status in EXPECTED
        assert str(status) in described["responses"], (method, route, status, answer)
        if status not in (200, 503):
            assert list(answer) == ["error"]

    check()


def test_the_answers_are_of_the_types_that_make_the_schema(fuzz):
    """Strictly: a key that the schema does not know is a mistake too."""
    kinds = {"/status": Status, "/events": list[LinkEvent], "/recordings": list[CatalogueEntry],
             "/health": HealthStatus}  # fmt: skip

    def conversation(api):
        time.sleep(1.2)  # statistics are there after a second
        for route, kind in kinds.items():
            _, answer = api.send("GET", route)
            assert answer
            msgspec.convert(answer, kind)
        assert api.send("GET", "/status")[1]["statistics"] is not None

    fuzz(conversation)


def test_whatever_the_schema_allows_is_answered_as_it_says(fuzz):
    def conversation(api):
        for method, route, described in api.operations:
            answers_as_described(api, method, route, described)

    folder = fuzz(conversation)
    outside = {path.name for path in folder.iterdir()}
    assert outside == {"sessions", "control.lock"}, "nothing was written elsewhere"


def test_whatever_else_is_sent_is_refused_in_words(fuzz):
    bodies = st.one_of(
        st.binary(max_size=200), ANYTHING.map(lambda value: json.dumps(value).encode())
    )

    def conversation(api):
        posts = [(m, r) for m, r, described in api.operations if "requestBody" in described]

        @settings(max_examples=75, database=None)
        @given(st.sampled_from(posts), bodies)
        def check(post, body):
            status, answer = api.send(*post, body)
            assert status in {400, 403, 409, 413}, (post, body, answer)
            assert answer["error"]

        check()

    fuzz(conversation)


def test_whatever_path_or_method_is_asked_for_ends_in_an_answer(fuzz):
    parts = st.text("abc/.%20?&=#~\u00e9", max_size=30)

    def conversation(api):
        @settings(max_examples=50, database=None)
        @given(st.sampled_from(["GET", "POST", "PUT", "DELETE", "HEAD", "OPTIONS", "BREW"]), parts)
        def check(method, rest):
            from urllib.parse import quote

            status, answer = api.send(method, "/" + quote(rest, safe="/.%?&=~"))
            assert status in EXPECTED
            if status in (404, 405) and method != "HEAD":
                assert list(answer) == ["error"]

        check()

    fuzz(conversation)
