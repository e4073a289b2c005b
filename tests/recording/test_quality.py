import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from groundstation.recording.csv_file import read_csv, write_table_csv
from groundstation.recording.formats import open_recording
from groundstation.recording.microsd import read_microsd
from groundstation.recording.quality import GAPS_LISTED, inspect_recording
from groundstation.recording.session import Recording
from groundstation.telemetry.packet import SAMPLE_TICKS
from groundstation.telemetry.samples import RawBatch, empty_samples, row_steps
from support import RECORDINGS
from support.packets import flight, packet_recording, packet_recordings

DESIGN_KEYS = {
    *("samples", "raw_packets", "duration_s", "rate_hz", "lost_samples", "gaps", "duplicates"),
    *("link", "segments", "verdict"),
}


def grid(rows):
    """Ticks of samples number ``rows`` on the 2 ms grid."""
    return np.rint(np.asarray(rows) * SAMPLE_TICKS).astype(np.int64)


def test_a_clean_recording_is_good_and_says_how_long_and_how_fast():
    report = inspect_recording(packet_recording(grid(np.arange(1000))))
    assert report.keys() >= DESIGN_KEYS
    assert report["samples"] == report["raw_packets"] == 1000
    assert report["duration_s"] == pytest.approx(2.0, abs=1e-5)
    assert report["rate_hz"] == pytest.approx(500.0, abs=0.01)
    assert report["lost_samples"] == report["duplicates"] == 0
    assert report["gaps"] == []
    assert report["segments"] == 1
    assert report["verdict"] == "good: 2 s at 500 Hz, nothing lost"


def test_the_real_excerpt_is_good():
    report = inspect_recording(read_csv(RECORDINGS / "thesis_excerpt.csv"))
    assert report["verdict"] == "good: 0.05 s at 500 Hz, nothing lost"
    assert report["ranges"]["battery"]["min"] == pytest.approx(3.235)
    assert report["ranges"]["pitch"] == {
        "unit": "deg",
        "min": pytest.approx(4.79),
        "max": pytest.approx(6.04),
        "mean": pytest.approx(5.662, abs=1e-3),
    }
    assert report["missing"] == ["rotor_1", "rotor_2", "rotor_3", "rotor_4"]


def test_the_real_microsd_log_is_measured_by_its_own_period():
    report = inspect_recording(read_microsd(RECORDINGS / "microsd_log16"))
    assert report["kind"] == report["link"] == "microsd"
    assert report["raw_packets"] == 0
    assert report["rate_hz"] == pytest.approx(1009.73, abs=0.01)
    assert report["period_s"] == pytest.approx(0.000988)
    assert report["lost_samples"] == 5
    assert report["gap_count"] == 3
    assert {"battery", "roll", "pitch", "yaw"} <= set(report["missing"])
    assert report["tables"] == {"fixedFrequency": 47182}
    assert report["verdict"].startswith("usable, with faults: the motors' duty is not known")


def test_the_same_samples_as_a_table_are_judged_alike(tmp_path):
    recording = packet_recording(grid([*range(300), *range(306, 600)]))
    write_table_csv(recording, tmp_path / "table.csv")
    direct, table = (
        inspect_recording(recording),
        inspect_recording(read_csv(tmp_path / "table.csv")),
    )
    assert table["lost_samples"] == direct["lost_samples"] == 6
    assert table["rate_hz"] == pytest.approx(direct["rate_hz"], rel=1e-3)
    assert table["ranges"] == direct["ranges"]
    assert table["verdict"].split(":")[0] == direct["verdict"].split(":")[0]


@given(st.sets(st.integers(1, 396), max_size=300))
def test_whatever_is_missing_is_counted_and_placed(missing):
    """Loss before the first or after the last sample cannot be seen."""
    kept = np.array([row for row in range(400) if row not in missing])
    assume(np.mean(np.diff(kept) == 1) > 0.02)
    report = inspect_recording(packet_recording(grid(kept)))
    assert report["lost_samples"] == len(missing)
    assert sum(gap["lost"] for gap in report["gaps"]) == len(missing)
    steps = np.diff(kept)
    assert report["gap_count"] == len(report["gaps"]) == np.count_nonzero(steps > 1)
    starts = [gap["start_s"] for gap in report["gaps"]]
    assert starts == pytest.approx(kept[:-1][steps > 1] * 0.002, abs=2e-6)
    assert [gap["duration_s"] for gap in report["gaps"]] == pytest.approx(
        steps[steps > 1] * 0.002, abs=2e-6
    )
    assert report["duration_s"] == pytest.approx(0.8, abs=1e-5)


def test_a_restart_is_not_a_gap_and_its_pause_not_part_of_the_duration():
    ticks = np.concatenate([grid(np.arange(500)) + 10**9, grid(np.arange(500))])
    recording = packet_recording(ticks, segment=np.repeat([0, 1], 500))
    report = inspect_recording(recording)
    assert report["segments"] == 2
    assert report["lost_samples"] == 0
    assert report["duration_s"] == pytest.approx(2.0, abs=1e-5)
    assert report["verdict"] == "usable, with faults: restarts of the device: 1"


def test_a_gap_in_a_later_segment_counts_from_that_segment_s_start():
    ticks = np.concatenate([grid(np.arange(50)) + 10**9, grid([*range(20), *range(25, 50)])])
    report = inspect_recording(packet_recording(ticks, segment=[0] * 50 + [1] * 45))
    assert [(gap["segment"], gap["lost"]) for gap in report["gaps"]] == [(1, 5)]
    assert report["gaps"][0]["start_s"] == pytest.approx(0.038, abs=2e-6)


def test_only_the_longest_gaps_are_listed_but_all_are_counted():
    rows = np.concatenate([np.arange(0, 3000, 3), np.arange(0, 3000, 3) + 1])
    rows = np.sort(rows)[:-200]
    ticks = grid(np.append(rows, rows[-1] + 100))
    report = inspect_recording(packet_recording(ticks))
    assert len(report["gaps"]) == GAPS_LISTED < report["gap_count"]
    assert report["gaps"][-1]["lost"] == 99
    starts = [gap["start_s"] for gap in report["gaps"]]
    assert starts == sorted(starts)


def test_packets_that_are_copies_are_duplicates():
    raw, samples = flight(0, 40)
    report = inspect_recording(Recording(Path("made.mcap"), "mcap", samples, raw))
    assert (report["raw_packets"], report["duplicates"]) == (160, 120)
    assert report["malformed"] == report["damaged"] == 0
    unasked = inspect_recording(Recording(Path("made.mcap"), "mcap", samples))
    assert (unasked["raw_packets"], unasked["duplicates"]) == (160, 120)


def test_garbage_and_damaged_copies_are_no_duplicates():
    raw, samples = flight(0, 100)
    packets = raw.packets.copy()
    packets[[7, 90, 201]] = 0xFF  # nothing of ours
    packets[[50, 330], 20] ^= 1  # a copy that contradicts three others
    damaged = RawBatch(packets, raw.host_time_ns)
    report = inspect_recording(Recording(Path("made.mcap"), "mcap", samples, damaged))
    assert report["malformed"] == 3
    assert report["damaged"] == 2
    assert report["duplicates"] == 400 - 3 - 2 - 100


def test_copies_stand_for_packets_that_were_not_loaded():
    recording = packet_recording(grid(np.arange(10)), kind="mcap")
    recording.samples.copies[:] = 4
    report = inspect_recording(replace(recording, raw=None))
    assert (report["raw_packets"], report["duplicates"]) == (40, 30)


def test_a_channel_at_the_rails_of_the_packet_is_clipped():
    gyro = np.zeros((100, 3), np.int64)
    gyro[:7, 1], gyro[7:10, 1], gyro[10, 1], gyro[11, 1] = 32767, -32768, 32766, -32767
    motors = np.full((100, 4), 2400)
    motors[:5, 2] = 4088
    report = inspect_recording(packet_recording(grid(np.arange(100)), gyro=gyro, motors=motors))
    assert report["clipping"] == {"gyro_y": 10, "duty_3": 5}
    assert "gyro_y at its limit in 10 samples" in report["verdict"]
    assert report["verdict"].startswith("usable, with faults")


def other_source(**channels):
    """A 1 kHz source without packets."""
    samples = empty_samples(1000, 1e-6)
    samples.ticks[:] = np.arange(1000) * 1000
    for name, values in channels.items():
        getattr(samples, name)[:] = values
    return Recording(Path("other"), "microsd", samples)


def test_a_motor_beyond_full_duty_is_told():
    duty = np.full((1000, 4), 0.6)
    duty[700:, 2] = np.linspace(0.6, 20.0, 300)
    report = inspect_recording(other_source(duty=duty))
    beyond = np.count_nonzero(duty.max(axis=1) > 1.001)
    assert f"a motor beyond full duty in {beyond} samples" in report["verdict"]


def test_another_source_is_clipped_where_it_sticks_at_a_range_of_the_sensor():
    accelerometer = np.tile([0.0, 0.0, 9.81], (1000, 1))
    accelerometer[100:120, 0] = 15.999 * 9.80665
    accelerometer[300, 1] = 7.999 * 9.80665  # one peak alone is no rail
    accelerometer[301:310, 2] = 7.5 * 9.80665
    report = inspect_recording(other_source(accelerometer=accelerometer))
    assert report["clipping"] == {"accelerometer_x": 20}


def test_a_wrong_unit_of_the_accelerometer_is_pointed_out():
    report = inspect_recording(other_source(accelerometer=[0, 0, 1.0]))
    assert "the accelerometer's mean is 0.102 g: check its unit" in report["verdict"]


def test_the_verdict_names_each_fault_in_words():
    rows = [*range(100), *range(140, 1000)]
    recording = packet_recording(grid(rows), battery=2900)
    recording.damage.extend(["a chunk is broken", "another too"])
    verdict = inspect_recording(recording)["verdict"]
    assert verdict == (
        "usable, with faults: a chunk is broken (and 1 more); 40 samples lost (4 %), gaps: 1, "
        "the longest 0.082 s; the battery went down to 2.90 V"
    )


def test_a_little_loss_is_good_but_one_long_gap_is_told():
    scattered = [row for row in range(10_000) if row % 1000 != 500]
    verdict = inspect_recording(packet_recording(grid(scattered)))["verdict"]
    assert verdict == "good: 20 s at 499.5 Hz, 10 samples lost (0.1 %)"
    verdict = inspect_recording(packet_recording(grid([*range(5000), *range(5040, 10_000)])))
    assert verdict["verdict"] == "usable, with faults: a gap of 0.082 s at 9.998 s"


def test_a_rate_that_is_not_the_telemetry_s_is_told():
    report = inspect_recording(packet_recording(grid(np.arange(0, 2000, 4))))
    assert report["lost_samples"] == 0
    assert "a sample every 8 ms where the telemetry has 2 ms" in report["verdict"]


def test_repeated_times_are_told():
    ticks = grid([0, 1, 2, 2, 3, 4])
    assert "1 samples repeat the time" in inspect_recording(packet_recording(ticks))["verdict"]


def test_no_samples_is_bad():
    report = inspect_recording(Recording(Path("empty.csv"), "csv", empty_samples(0)))
    assert report["verdict"] == "bad: no samples"
    assert (report["duration_s"], report["rate_hz"]) == (0.0, 0.0)
    json.dumps(report, allow_nan=False)


def test_rows_that_come_more_slowly_in_a_later_segment_are_not_taken_for_gaps():
    samples = empty_samples(200, 1e-6)
    samples.segment[120:] = 1
    steps_us = np.where(samples.segment == 0, 4000, 10_000)
    steps_us[[50, 150]] *= 3  # two rows of each are missing
    samples.ticks[:] = np.cumsum(steps_us)
    assert row_steps(samples).lost.sum() == 4


def test_one_sample_is_described_without_a_rate_to_measure():
    report = inspect_recording(packet_recording([5]))
    assert report["duration_s"] == pytest.approx(0.002)


@given(packet_recordings(), st.booleans())
def test_any_recording_is_described_in_json_without_nan(recording, with_holes):
    if with_holes:
        recording.samples.gyro[::2] = np.nan
        recording.samples.accelerometer[:] = np.nan
        recording.samples.accelerometer[0, 0] = np.inf
        recording.samples.battery_v[:] = np.nan
    recording.samples.segment[1:] = np.cumsum(np.diff(recording.samples.ticks) < 0)
    report = inspect_recording(recording)
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert "\n" not in report["verdict"]


# What cannot be in a channel, or does not agree with the others, is in the verdict.


@pytest.fixture(scope="module")
def stand_in():
    """From rest on the ground into the air, 31 s."""
    samples = open_recording(RECORDINGS / "stand_in_flight.mcap").samples
    return replace(samples, copies=np.ones(len(samples), np.uint8))


def verdict(samples):
    return inspect_recording(Recording(Path("made.csv"), "csv", samples))["verdict"]


def changed(samples, name, change):
    """A copy in which one of the channels went through ``change``."""
    values = getattr(samples, name).copy()
    given_back = change(values)
    return replace(samples, **{name: values if given_back is None else given_back})


def column(index, change):
    def on(values):
        values[:, index] = change(values[:, index])

    return on


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("battery_v", lambda v: 46 * v, "battery up to 1.* V, which cannot be"),
        ("battery_v", lambda v: 1e-3 * v, "battery up to 0.* V, which cannot be"),
        ("gyro", lambda v: 57.3 * v, "gyro_x.*deg/s, which cannot be, in .* of 15490 samples"),
        ("duty", lambda v: v - 0.5, "duty_1, duty_2, duty_3, duty_4 up to -0.5, which cannot be"),
        ("accelerometer", lambda v: 100 * v, "accelerometer_.* g, which cannot be"),
        ("attitude", lambda v: 57.3 * v, "roll, pitch.*deg, which cannot be"),
        ("gyro", lambda v: v / 57.3, "turns .* times as fast about x as gyro_x says"),
        ("gyro", column(1, np.negative), "pitch turns against gyro_y"),
        ("attitude", column(2, np.negative), "yaw turns against gyro_z"),
        ("gyro", lambda v: v[:, [1, 0, 2]], "roll turns with gyro_y, not gyro_x"),
        ("accelerometer", lambda v: 0.7 * v, "at rest the accelerometer reads 0.7 g"),
        ("accelerometer", column(2, np.negative), "accelerometer_z is -.* g in the mean: its sign"),
        ("duty", lambda v: 0.48 + 0.4 * v, "duty is 0.48 while the craft lies still"),
        ("duty", lambda v: v / 255, "duty never exceeds .* though the craft flies"),
        ("gyro", column(2, lambda v: 0 * v), "gyro_z is 0 throughout while the others change"),
        ("duty", column(3, lambda v: 0 * v + 0.5), "duty_4 is 0.5 throughout while the others"),
    ],
)
def test_what_cannot_be_is_a_fault(name, change, said, stand_in):
    wrong = changed(stand_in, name, change)
    found = verdict(wrong)
    assert found.startswith("usable, with faults: ")
    assert re.search(said, found), found
    assert verdict(stand_in).startswith("good: ")


def test_every_format_is_judged_alike(stand_in, tmp_path):
    wrong = changed(stand_in, "gyro", lambda v: v / 57.3)
    write_table_csv(Recording(Path("a"), "csv", wrong), tmp_path / "a.csv")
    assert "gyro_x says" in inspect_recording(read_csv(tmp_path / "a.csv"))["verdict"]


@settings(max_examples=15)
@given(st.integers(300, 3000), st.integers(4000, 9000), st.sampled_from(["gyro", "accelerometer"]))
def test_a_channel_that_stops_is_stuck_for_as_long(stand_in, rows, first, name):
    def stop(values):
        values[first : first + rows, 1] = values[first, 1] + 1e-4  # not its neighbour's value

    found = verdict(changed(stand_in, name, stop))
    assert f"{name}_y is stuck for {rows} samples from number {first + 1} on" in found


@settings(max_examples=15)
@given(st.floats(0.05, 0.95))
def test_missing_values_are_counted(stand_in, share):
    count = int(share * len(stand_in))

    def drop(values):
        values[np.linspace(0, len(stand_in) - 1, count).astype(int)] = np.nan

    report = inspect_recording(
        Recording(Path("made.csv"), "csv", changed(stand_in, "accelerometer", drop))
    )
    assert f"missing in {count} of 15490 samples" in report["verdict"]
    assert report["missing_values"]["accelerometer_x"] == count


def test_a_few_values_that_are_missing_at_the_start_are_no_fault(stand_in):
    """A log's sources begin one after the other."""

    def drop(values):
        values[:50] = np.nan

    assert verdict(changed(stand_in, "attitude", drop)).startswith("good: ")


@pytest.mark.parametrize("factor", [1000, 1 / 1000])
def test_a_time_in_another_unit_is_a_fault(stand_in, factor):
    ticks = np.rint((stand_in.ticks - stand_in.ticks[0]) * stand_in.tick_s * factor * 1e9)
    samples = replace(stand_in, ticks=ticks.astype(np.int64), tick_s=1e-9)
    assert "check the time's unit" in verdict(samples)


@pytest.mark.parametrize(
    "name", ["stand_in_flight.mcap", "nanobench_trefoil.mcap", "microsd_log16"]
)
def test_real_flights_have_no_such_fault(name):
    found = inspect_recording(open_recording(RECORDINGS / name))["verdict"]
    for word in ("cannot be", "turns", "stuck", "throughout", "lies still", "missing", "check"):
        assert word not in found, found


@pytest.mark.parametrize("rows", [2, 5, 10, 50])
def test_how_often_the_motors_are_renewed_is_measured(stand_in, rows):
    def hold(values):
        return values[np.arange(len(values)) // rows * rows]

    air = stand_in[3000:]
    report = inspect_recording(Recording(Path("a"), "csv", changed(air, "duty", hold)))
    assert report["renewed_hz"]["duty"] == pytest.approx(500 / rows, rel=0.1)
    assert report["renewed_hz"]["gyro"] == pytest.approx(500, rel=0.02)
    assert ("settings are renewed" in report["verdict"]) == (rows >= 2)
