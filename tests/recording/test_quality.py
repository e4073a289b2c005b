import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from groundstation.recording.csv_file import read_csv, write_table_csv
from groundstation.recording.microsd import read_microsd
from groundstation.recording.quality import GAPS_LISTED, inspect_recording
from groundstation.recording.session import Recording
from groundstation.telemetry.packet import SAMPLE_TICKS
from groundstation.telemetry.samples import RawBatch, empty_samples, row_steps
from support.packets import flight, packet_recording, packet_recordings

RECORDINGS = Path(__file__).parents[2] / "recordings"
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
