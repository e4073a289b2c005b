"""Batteries of the stand-in, flown until they were low: what one tells of the next."""

import numpy as np
import pytest

from firmware_sim.craft import StandIn
from firmware_sim.settings import StandInSettings
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.discharge import LOW_V, WINDOW_S, Discharge, left_s
from groundstation.telemetry.samples import RawBatch


def flown(**settings):
    """Volts of a battery from its charge until it is low."""
    craft, battery = StandIn(StandInSettings(copies=1, **settings)), Discharge()
    at_s = 0.0
    while not battery.is_low:
        at_s += 8.0
        assert at_s < 600
        packets, arrival_s = craft.advance(at_s)
        samples, *_ = decode_all(RawBatch(packets, (arrival_s * 1e9).astype(np.int64)))
        assert not battery.feed(samples)
    return battery.volts


@pytest.fixture(scope="module")
def full():
    return flown(seed=1, charge=0.6)


def test_a_battery_lasts_as_long_as_the_one_before_it_says(full):
    other = flown(seed=2, charge=0.4, program="hover")
    assert other[0] < full[0] - 0.05
    for seen in range(4, len(other), 5):
        left = (len(other) - seen) * WINDOW_S
        least, most = left_s(other[:seen], [full])
        assert least <= left <= most
        assert most - least <= 90


def test_without_a_battery_to_compare_with_nothing_is_said(full):
    assert left_s(full, []) is None
    assert left_s(full[:2], [full]) is None
    assert left_s([4.3] * 5, [full]) is None  # fuller than any before it
    assert left_s([LOW_V - 0.3] * 5, [full]) == (0.0, 0.0)


def test_another_battery_is_noticed_by_its_voltage_also_after_a_rest():
    battery = Discharge()
    samples, *_ = hover(3.6)
    assert not battery.feed(samples)
    assert len(battery.volts) == 2
    recovered, *_ = hover(3.68)
    assert not battery.feed(recovered)
    fresh, *_ = hover(3.9)
    assert battery.feed(fresh)
    assert battery.volts == pytest.approx([3.9, 3.9], abs=0.01)
    assert battery.flown_s == pytest.approx(10.0, abs=0.2)
    standing, *_ = hover(4.1, duty=0)
    assert not battery.feed(standing)


def hover(volts, duty=2400):
    """Ten seconds and a bit of packets at one voltage."""
    from groundstation.telemetry.packet import encode

    rows = 5020
    ticks = np.arange(rows) * 144000 // 73
    zeros = np.zeros((rows, 3), np.int16)
    packets = encode(
        ticks, np.full(rows, round(volts * 1e3)), np.full((rows, 4), duty), zeros, zeros, zeros,
        np.zeros(rows, np.uint32),
    )  # fmt: skip
    return decode_all(RawBatch(packets, np.arange(rows, dtype=np.int64) * 2_000_000))
