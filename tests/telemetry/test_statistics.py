"""The figures of a link against streams whose loss, lateness and clocks are known."""

import numpy as np
import pytest

from groundstation.telemetry.decoder import Decoder, LinkMeter
from groundstation.telemetry.packet import SAMPLE_PERIOD_S
from groundstation.telemetry.samples import RawBatch
from support.packets import COPIES, START_NS, flight

SECOND_NS = 1_000_000_000


def chosen(raw, keep):
    return RawBatch(raw.packets[keep], raw.host_time_ns[keep])


def measured(raw, seconds=1):
    """Statistics after each of ``seconds`` windows of one second."""
    decoder, meter = Decoder(), LinkMeter(START_NS)
    edges = START_NS + np.arange(1, seconds + 1) * SECOND_NS
    places = [0, *np.searchsorted(raw.host_time_ns, edges)]
    windows = []
    for first, last, edge in zip(places, places[1:], edges, strict=False):
        for at in range(first, last, 16):
            meter.add(decoder.decode(chosen(raw, slice(at, min(at + 16, last)))))
        meter.add(decoder.idle(int(edge)))
        windows.append(meter.close_window(int(edge), decoder.counts()))
    return windows


def test_a_perfect_link_loses_nothing_and_brings_every_copy():
    (window,) = measured(flight(0, 500)[0])
    assert window.window_s == pytest.approx(1.0)
    assert window.rate_hz == pytest.approx(500.0)
    assert window.packets_hz == pytest.approx(500.0 * COPIES)
    assert (window.lost, window.loss_pct, window.duplicates) == (0, 0.0, 500 * (COPIES - 1))
    assert window.copies == COPIES
    assert window.time_ns == START_NS + SECOND_NS


def test_loss_is_the_share_of_what_was_sent_and_bursts_are_told_apart():
    raw, _ = flight(0, 500)
    index = np.repeat(np.arange(500), COPIES)
    gone = ((index >= 100) & (index < 110)) | (index == 300)
    (window,) = measured(chosen(raw, ~gone))
    assert (window.lost, window.bursts, window.longest_burst) == (11, 2, 10)
    assert window.loss_pct == pytest.approx(100 * 11 / 500)
    assert window.rate_hz == pytest.approx(489.0)


def test_loss_in_a_window_is_of_that_window_and_the_totals_go_on():
    raw, _ = flight(0, 1000)
    index = np.repeat(np.arange(1000), COPIES)
    first, second = measured(chosen(raw, (index < 100) | (index >= 150)), seconds=2)
    assert (first.loss_pct, second.loss_pct) == (pytest.approx(10.0), 0.0)
    assert (first.lost, second.lost) == (50, 50)
    assert (first.samples, second.samples) == (450, 950)


def test_copies_that_are_lost_lower_the_mean_and_no_sample():
    raw, _ = flight(0, 500)
    copy = np.tile(np.arange(COPIES), 500)
    (window,) = measured(chosen(raw, copy < 2))
    assert window.copies == 2
    assert (window.lost, window.duplicates) == (0, 500)


def test_latency_is_how_much_later_than_the_fastest_and_jitter_its_spread():
    """Half of the samples come 4 ms late, one in fifty 12 ms."""
    raw, _ = flight(0, 1000)
    raw = chosen(raw, slice(None, None, COPIES))
    late_ns = np.where(np.arange(1000) % 2, 400_000, 0)
    late_ns[::25] = 1_500_000
    (_, window) = measured(RawBatch(raw.packets, raw.host_time_ns + late_ns), seconds=2)
    assert window.jitter_ms == pytest.approx(0.4, abs=0.02)
    assert 0.0 <= window.latency_ms <= 0.42
    assert window.latency_p99_ms == pytest.approx(1.5, abs=0.02)


@pytest.mark.parametrize("ppm", [50.0, -120.0, 0.0])
def test_a_device_clock_that_is_fast_is_found_within_5_ppm(ppm):
    """A fast device fits its 2 ms into less of the host's time."""
    seconds = 40
    raw, _ = flight(0, seconds * 500)
    raw = chosen(raw, slice(None, None, COPIES))
    since_ns = raw.host_time_ns - START_NS
    rng = np.random.default_rng(5)
    late_ns = rng.exponential(200_000, len(raw)).astype(np.int64)
    slowed = START_NS + np.rint(since_ns / (1 + ppm * 1e-6)).astype(np.int64)
    host = np.maximum.accumulate(slowed + late_ns)
    windows = measured(RawBatch(raw.packets, host), seconds)
    assert windows[10].clock_ppm is None, "too early to tell"
    assert windows[-1].clock_ppm == pytest.approx(ppm, abs=5.0)


def test_a_window_without_samples_has_no_figures_of_the_way_and_no_loss():
    meter, decoder = LinkMeter(START_NS), Decoder()
    window = meter.close_window(START_NS + SECOND_NS, decoder.counts())
    assert (window.rate_hz, window.packets_hz, window.loss_pct) == (0.0, 0.0, 0.0)
    assert window.latency_ms is window.latency_p99_ms is window.jitter_ms is None
    assert window.copies is window.clock_ppm is None
    assert "latency_ms" not in window.gauges()
    assert window.gauges()["rate_hz"] == 0.0


def test_a_silent_window_does_not_repeat_the_figures_of_the_one_before():
    first, second = measured(flight(0, 500)[0], seconds=2)
    assert first.rate_hz == pytest.approx(500.0)
    assert (second.rate_hz, second.latency_ms) == (0.0, None)
    assert second.samples == first.samples == 500


def test_samples_of_a_source_without_packets_are_counted():
    meter = LinkMeter(START_NS)
    meter.add_samples(flight(0, 250)[1], live=False)
    window = meter.close_window(START_NS + SECOND_NS // 2, Decoder().counts())
    assert window.rate_hz == pytest.approx(1 / SAMPLE_PERIOD_S)
    assert window.latency_ms is None
