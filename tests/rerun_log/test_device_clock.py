from __future__ import annotations

import numpy as np

from groundstation.rerun_log.channels import LiveClock, RecordedClock

SECOND_NS = 10**9


def test_device_time_is_ticks_times_their_length(wobble):
    samples = wobble(100)
    times = LiveClock().advance(samples)
    np.testing.assert_allclose(times, samples.ticks * (73e-6 / 72) * 1e9, atol=0.5)


def test_slicing_a_stream_changes_no_time(flight):
    whole = LiveClock().advance(flight.samples)
    clock = LiveClock()
    sliced = [clock.advance(flight.samples[at : at + 37]) for at in range(0, 4000, 37)]
    np.testing.assert_array_equal(np.concatenate(sliced), whole)


def test_after_a_restart_time_goes_on_by_the_silence_the_host_saw(flight):
    times = LiveClock().advance(flight.samples)
    assert (np.diff(times) > 0).all()
    silence_ns = np.diff(flight.samples.host_time_ns)[2499]
    assert times[2500] - times[2499] == silence_ns == 1_502_000_000


def test_a_source_that_starts_later_keeps_its_own_time(wobble):
    clock = LiveClock()
    clock.advance(wobble(10))
    later = wobble(10)
    later.ticks[:] += 10**9
    later.segment[:] = 1
    np.testing.assert_array_equal(clock.advance(later), np.rint(later.time_s * 1e9))


def test_an_event_before_the_first_sample_is_at_zero():
    assert LiveClock().at_host(np.array([12345])) == [0]


def test_a_live_event_lies_as_far_behind_the_newest_sample_as_the_host_says(wobble):
    samples = wobble(10)
    clock = LiveClock()
    newest = clock.advance(samples)[-1]
    at = clock.at_host(samples.host_time_ns[-1:] + SECOND_NS)
    assert at == [newest + SECOND_NS]


def test_a_recorded_event_lies_between_its_neighbours_even_across_a_restart(flight):
    clock = RecordedClock(flight.samples)
    times = clock.advance(flight.samples)
    hosts = flight.samples.host_time_ns
    np.testing.assert_array_equal(clock.at_host(hosts), times)
    inside_the_gap = clock.at_host(hosts[2499:2500] + SECOND_NS)
    assert times[2499] < inside_the_gap[0] < times[2500]
    assert clock.at_host(hosts[:1] - SECOND_NS) == [times[0] - SECOND_NS]
