"""The report holds what the account says, draws every figure, and is one file."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.arx import identify_arx
from groundstation.identification.body import identify_body
from groundstation.identification.estimate import liveliest
from groundstation.identification.motor.workflow import identify_motor
from groundstation.identification.report import report
from groundstation.identification.runs import runs_of
from support.flights import recorded

VEHICLE = BUILT_IN["crazyflie1"]
MODEL = vehicle_model(VEHICLE)
FILES = {"recordings": [{"file": "<flight>.csv", "sha256": "ab" * 32}], "held_out": "last third"}


@pytest.fixture(scope="module")
def pages():
    """kind -> (what was identified, its page as text)."""
    flight = runs_of(recorded(36.0, plant="reduced", seed=81)[0], "flight")
    bench = runs_of(
        recorded(16.0, plant="reduced", seed=82, program="motor_bench", supply_v=3.7)[0], "bench"
    )
    found = {
        "motor": identify_motor(bench, [], MODEL, VEHICLE),
        "body": identify_body(flight, [], MODEL, VEHICLE, ("dead_time",)),
        "arx": identify_arx(flight, [], MODEL, VEHICLE, channel="gyro", decimate=4),
    }
    return {
        kind: (one, report(one.model, {**one.account, **FILES}, one.evidence).html())
        for kind, one in found.items()
    }


@pytest.mark.parametrize(("kind", "figures"), [("motor", 6), ("body", 13), ("arx", 10)])
def test_each_figure_is_drawn(pages, kind, figures):
    _, text = pages[kind]
    drawings = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert len(drawings) == figures
    for one in drawings:
        root = ElementTree.fromstring(one)
        assert len(list(root.iter("{http://www.w3.org/2000/svg}path"))) > 5


@pytest.mark.parametrize("kind", ["motor", "body", "arx"])
def test_names_of_files_are_text_and_nothing_is_fetched(pages, kind):
    _, text = pages[kind]
    assert "&lt;flight&gt;.csv" in text
    assert "<script" not in text
    assert not re.search(r"(?:src|href)=\"https?:", text)


@pytest.mark.parametrize("kind", ["motor", "body"])
def test_every_parameter_stands_there_with_its_interval(pages, kind):
    found, text = pages[kind]
    (estimates,) = found.evidence.estimates.values()
    for name, value, (low, high) in zip(
        estimates.names, estimates.values, estimates.interval(), strict=True
    ):
        row = re.search(rf"<tr><td>{re.escape(name)}</td>(.*?)</tr>", text).group(1)
        for number in (value, low, high):
            assert f">{number:.4g}<" in row


def test_arx_coefficients_have_units_and_not_the_motors_meanings(pages):
    found, text = pages["arx"]  # of rates, a row in 8 ms
    roll = found.model.arx["roll"]
    table = text[text.index("Parameters: roll") :]
    first_b = re.search(r"<tr><td>b1</td>(.*?)</tr>", table).group(1)
    assert "rad/s per (rev/s)²" in first_b
    assert f"rate by u&#x27; {8 * roll.nk} ms before" in first_b
    assert "slowing down of a motor" not in text


def test_the_first_line_says_what_the_fit_is_good_for_and_the_second_what_to_do(pages):
    for kind, words in (("motor", "good enough for body fits"), ("body", "Good enough to design")):
        _, text = pages[kind]
        first = re.search(r'<div class="verdict \w+">(.*?)</div>', text).group(1)
        assert words in first
        assert "%" in first
        assert text.index("<strong>Next:</strong>") < text.index("<h2")


def test_arx_tables_of_all_axes_and_the_step_responses_are_there(pages):
    found, text = pages["arx"]
    for axis in ("roll", "pitch", "yaw"):
        assert f"Structures: {axis}" in text
        assert found.account["axes"][axis]["chosen"] in text
    steps = found.evidence.steps
    assert {step.axis for step in steps} == {"roll", "pitch", "yaw"}
    assert sum(step.chosen for step in steps) == 3


def test_what_the_recordings_became_before_the_fit_is_drawn(pages):
    for kind, words in (
        ("motor", ("left out as missed or doubled passages", "Armature voltage")),
        ("body", ("Armature voltages", "Speeds of the rotors", "Roll and, dashed, its torque")),
    ):
        after = pages[kind][1].partition("Before the fit</h2>")[2]
        assert all(one in after for one in words)


def test_warnings_come_first(pages):
    _, text = pages["body"]
    assert text.index("taken as exact") < text.index(">Parameters</h2>")


def test_what_is_drawn_is_where_the_channel_moves_not_where_it_shakes():
    time = np.arange(5000) * 0.002
    shaking = 3.0 * np.sin(2 * np.pi * 240 * time) * (time < 4)
    moving = 1.0 * np.sin(2 * np.pi * 2 * time) * (time > 7)
    rows = liveliest(shaking + moving, 0.002, 2.0)
    assert 0.002 * rows.start >= 6.5
    assert rows.stop - rows.start == 1000
