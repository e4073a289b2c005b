"""The thrust curve of a firmware, measured in flight: releases differ by a third."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_sim.releases import curve_of
from groundstation.cli.learn import FastPlace
from groundstation.control.firmwares import PLATFORMS, firmware_of_model, flown_curve
from groundstation.dynamics.model import Model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.learn.planning import HOVER, Limits, flight_of
from groundstation.recording.formats import open_for_analysis


def flown(tmp_path, craft, release):
    settings = tmp_path / "craft.toml"
    settings.write_text(f'plant = "faithful"\ncraft = "{craft}"\nrelease = "{release}"\n')
    file = tmp_path / "flight.mcap"
    plan = flight_of(HOVER, "", Limits(), 1)
    assert FastPlace(str(settings), 0.5, 1.0).fly(plan, file, seed=1).aborted == ""
    return open_for_analysis(file)


def truth(craft, release, volts):
    """Volts a unit, from the release's own curve."""
    curve = curve_of(craft, release)
    return 0.02 / (curve.command(volts + 0.01) - curve.command(volts - 0.01))


@pytest.mark.parametrize(
    ("craft", "release"),
    [("crazyflie21", one) for one in ("2024.10", "2025.09", "2025.12", "2026.08")]
    + [("brushless", "2026.04")],
)
def test_its_steepness_at_hover_is_that_of_the_release(tmp_path, craft, release):
    recording = flown(tmp_path, craft, release)
    curve = flown_curve([recording], PLATFORMS[craft])
    samples = recording.samples
    flies = samples.duty.min(axis=1) > 0.3 if craft == "crazyflie21" else samples.duty[:, 0] > 0.2
    volts = float(np.median((samples.duty.mean(axis=1) * samples.battery_v)[flies]))
    measured = replace(PLATFORMS[craft], curve=curve).volts_per_thrust(volts)
    assert measured == pytest.approx(truth(craft, release, volts), rel=0.04)


def test_a_flight_without_the_controllers_thrust_tells_none(tmp_path):
    recording = flown(tmp_path, "crazyflie21", "2026.08")
    assert flown_curve([replace(recording, tables={})], PLATFORMS["crazyflie21"]) is None


def test_a_design_reckons_with_the_flown_one():
    curve = (-0.01, 0.05, -0.02, 0.006)
    model = Model(vehicle="crazyflie21", motor=BUILT_IN["crazyflie21"].motor, firmware_curve=curve)
    assert firmware_of_model(model).curve == curve
    plain = Model(vehicle="crazyflie21", motor=BUILT_IN["crazyflie21"].motor)
    assert firmware_of_model(plain).curve == PLATFORMS["crazyflie21"].curve
