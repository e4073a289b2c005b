"""Whether real flights show what they must: the judgement, and the command that ends with it."""

import sys

import pytest

from bench.real import acceptance
from support.programs import run_program

CASE = {
    "constants": {"c0": 1.5e-3, "c1": 1.5e-3, "c2": 1e-4, "thrust_per_mass": 2.2e-5},
    "stderr": {"c0": 3e-5, "c1": 3e-5, "c2": None, "thrust_per_mass": 1e-8},
    "validation": {f"gyro_{axis}_fit_percent_50ms": 85.0 for axis in ("roll", "pitch", "yaw")},
}
REFERENCE = {"per_constant": 1.0, "roll": {"gain": 1.5e-3}, "pitch": {"gain": 1.5e-3}}
FOUND = {
    "gap": {"before": 4.0, "after": 1.5},
    "channels": {"gyro_x": {"before": 2.0, "after": 1.0}},
    "where": [{"channel": "gyro x"}],
    "effects": {
        "rotor_acceleration_torque": {"rotor_inertia_kg_m2": {"value": 5e-8}},
        "velocity_moment": {"moment": {"value": 25.0}},
    },
}
LOADED = {**FOUND, "effects": {**FOUND["effects"], "mass_change": {"percent": {"value": 17.0}}}}


def failing(lines):
    return [text for passed, text in lines if not passed]


def test_flights_that_show_what_they_must_fail_nowhere():
    assert not failing(acceptance.constants("a", CASE, REFERENCE))
    assert not failing(acceptance.predictions("a", CASE, {"roll": 0.95}, measured=True))
    assert not failing(acceptance.agreement("set", [CASE, CASE]))
    assert not failing(acceptance.findings("a", "brushless", FOUND))
    assert not failing(acceptance.payload(LOADED, FOUND))


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            acceptance.constants("a", CASE, {**REFERENCE, "roll": {"gain": 1.1e-3}}),
            "c0 is 1.36 of the reference",
        ),
        (acceptance.predictions("a", CASE, {"roll": 0.8}, measured=True), "18 Hz 0.80"),
        (
            acceptance.agreement(
                "s", [CASE, {**CASE, "constants": {**CASE["constants"], "thrust_per_mass": 2.3e-5}}]
            ),
            "thrust_per_mass of disjoint flights 4.5 % apart",
        ),
        (acceptance.findings("a", "x", {**FOUND, "gap": {"after": 2.3}}), "gap after naming 2.30"),
        (
            acceptance.findings(
                "a", "x", {**FOUND, "channels": {"yaw": {"before": 1.0, "after": 1.1}}}
            ),
            "worse channels: yaw",
        ),
        (
            acceptance.findings("a", "brushless", {**FOUND, "effects": {}}),
            "rotor_acceleration_torque is named",
        ),
        (acceptance.payload(FOUND, FOUND), "mass_change nan %"),
        (
            acceptance.payload(
                {**LOADED, "effects": {**LOADED["effects"], "gyro_bias": {}}}, FOUND
            ),
            "other new names: gyro_bias",
        ),
    ],
)
def test_what_is_missing_is_said_with_its_number(lines, said):
    assert any(said in text for text in failing(lines))


def test_a_folder_without_flights_fails(tmp_path):
    command = [sys.executable, "-m", "bench.real", str(tmp_path), "accept"]
    ended = run_program([*command, "--results", str(tmp_path / "results")])
    assert ended.returncode == 1
    assert "none of the sets" in ended.stdout
