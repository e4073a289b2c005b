import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from groundstation.telemetry.packet import (
    PACKET_BYTES,
    PACKET_DTYPE,
    SAMPLE_TICKS,
    TICK_S,
    as_packets,
    decode,
    encode,
    motor_counts,
)
from groundstation.telemetry.samples import packet_counts, samples_from_packets

GOLDEN = bytes.fromhex(
    "06 24"  # timestamp 9222, the low 16 bits of 17114118
    "aa 0c"  # battery 3242 mV
    "30 8d c3 98 8b c7"  # motors 3376 3128 2968 3192, 12 bits each
    "43 fe b5 02 b5 ff"  # gyro -445 693 -75
    "b7 fe 4a 0c 1b 1e"  # accelerometer -329 3146 7707
    "f3 fe d1 fd c0 f3"  # roll -269, pitch -559 (nose up), yaw -3136
    "80 4f 50 49"  # debug 1230000000
)
GOLDEN_FIELDS = {
    "battery": 3242,
    "motors": [3376, 3128, 2968, 3192],
    "gyro": [-445, 693, -75],
    "accelerometer": [-329, 3146, 7707],
    "angles": [-269, -559, -3136],
    "debug": 1230000000,
}


def decoded_samples(packets, ticks):
    n = len(packets)
    return samples_from_packets(
        packets,
        np.asarray(ticks, np.int64),
        np.zeros(n, np.int64),
        np.zeros(n, np.int32),
        np.ones(n, np.uint8),
    )


def test_the_golden_packet_decodes_to_the_fields_of_the_real_log():
    record = decode(as_packets(GOLDEN))
    assert record["timestamp"].tolist() == [9222]
    assert record["battery"].tolist() == [3242]
    assert motor_counts(record).tolist() == [[3376, 3128, 2968, 3192]]
    assert record["gyro"].tolist() == [[-445, 693, -75]]
    assert record["accelerometer"].tolist() == [[-329, 3146, 7707]]
    assert record["angles"].tolist() == [[-269, -559, -3136]]
    assert record["debug"].tolist() == [1230000000]


@pytest.mark.parametrize("timestamp", [9222, 17114118])
def test_the_golden_fields_encode_to_the_packet_wrapped_or_not(timestamp):
    assert encode(timestamp=timestamp, **GOLDEN_FIELDS).tobytes() == GOLDEN


def test_the_golden_packet_in_physical_units():
    samples = decoded_samples(as_packets(GOLDEN), [17114118])
    assert samples.time_s[0] == pytest.approx(17.351814, abs=1e-6)
    assert samples.battery_v[0] == pytest.approx(3.242)
    assert samples.duty[0] == pytest.approx([0.82421875, 0.763671875, 0.724609375, 0.779296875])
    assert np.degrees(samples.gyro[0]) == pytest.approx([-27.16064, 42.29736, -4.577637], rel=1e-5)
    assert samples.accelerometer[0] == pytest.approx([-0.787690, 7.532155, 18.452100], rel=1e-5)
    assert np.degrees(samples.attitude[0]) == pytest.approx([-2.69, 5.59, -31.36], rel=1e-5)
    assert samples.debug[0] == 1230000000


def test_the_layout_is_the_documented_one():
    offsets = {name: PACKET_DTYPE.fields[name][1] for name in PACKET_DTYPE.names}
    assert offsets == {
        "timestamp": 0,
        "battery": 2,
        "motors": 4,
        "gyro": 10,
        "accelerometer": 16,
        "angles": 22,
        "debug": 28,
    }
    assert PACKET_DTYPE.itemsize == PACKET_BYTES == 32


def test_a_sample_is_two_milliseconds_of_ticks():
    assert abs(SAMPLE_TICKS * TICK_S - 0.002) < 1e-15
    assert abs(SAMPLE_TICKS - 1972.603) < 1e-3
    assert abs(65536 * TICK_S - 0.0664) < 1e-4


raw_packets = hnp.arrays(np.uint8, st.tuples(st.integers(0, 20), st.just(PACKET_BYTES)))


@given(raw_packets)
def test_any_32_bytes_survive_decode_and_encode(packets):
    record = decode(packets)
    fields = {name: record[name] for name in PACKET_DTYPE.names if name != "motors"}
    assert np.array_equal(encode(motors=motor_counts(record), **fields), packets)
    assert motor_counts(record).max(initial=0) <= 4095


@given(raw_packets, st.integers(0, 2**40))
def test_any_packet_survives_physical_units(packets, wraps):
    """-32768 counts of pitch negate to 32768, which still comes back."""
    ticks = decode(packets)["timestamp"].astype(np.int64) + wraps * 65536
    samples = decoded_samples(packets, ticks)
    assert np.array_equal(encode(**packet_counts(samples)), packets)


@given(st.lists(st.integers(0, 4095), min_size=4, max_size=4))
def test_the_motors_are_48_bits_with_the_first_lowest(motors):
    packet = encode(0, 0, motors, [0, 0, 0], [0, 0, 0], [0, 0, 0], 0).tobytes()
    packed = int.from_bytes(packet[4:10], "little")
    assert [(packed >> (12 * motor)) & 0xFFF for motor in range(4)] == motors


@given(st.binary(max_size=200))
def test_a_trailing_fragment_is_left_out(data):
    packets = as_packets(data)
    assert packets.shape == (len(data) // 32, 32)
    assert data.startswith(packets.tobytes())


@pytest.mark.parametrize(
    ("field", "low", "high"),
    [
        ("battery", 0, 65535),
        ("motors", 0, 4095),
        ("gyro", -32768, 32767),
        ("accelerometer", -32768, 32767),
        ("angles", -32768, 32767),
        ("debug", 0, 2**32 - 1),
    ],
)
def test_a_count_beyond_its_field_is_refused_by_name(field, low, high):
    width = len(GOLDEN_FIELDS[field]) if isinstance(GOLDEN_FIELDS[field], list) else None

    def encode_with(value):
        values = value if width is None else [0] * (width - 1) + [value]
        return encode(timestamp=0, **{**GOLDEN_FIELDS, field: values})

    for fits in (low, high):
        assert len(encode_with(fits)) == 1
    for outside in (low - 1, high + 1):
        with pytest.raises(ValueError, match=rf"{field}: {outside} is outside {low}\.\.{high}"):
            encode_with(outside)


def test_one_packet_and_many_go_through_the_same_code():
    many = np.tile(as_packets(GOLDEN), (100_000, 1))
    records = decode(many)
    assert np.shares_memory(records, many)
    assert np.all(motor_counts(records) == [3376, 3128, 2968, 3192])
    assert records.shape == (100_000,)
