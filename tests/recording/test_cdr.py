import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from groundstation.recording.mcap_schemas import HEADER, Definition

NUMBERS = [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
NUMBERS += ["float32", "float64"]


@st.composite
def messages(draw):
    """A definition and values for it."""
    lines, values = [], {}
    for place in range(draw(st.integers(1, 6))):
        kind = draw(st.sampled_from(NUMBERS))
        name = f"field_{place}"
        if draw(st.booleans()):
            lines.append(f"{kind}[] {name}  # comment")
            # an empty sequence of wide numbers is aligned by some encoders and not by others
            low = 0 if np.dtype(kind).itemsize <= 4 else 1
            values[name] = draw(hnp.arrays(kind, st.integers(low, 5)))
        else:
            lines.append(f"{kind} {name}")
            values[name] = draw(hnp.arrays(kind, 1))
    return "\n".join(lines), values


@given(messages())
def test_what_is_encoded_decodes_to_the_same_bits(message):
    text, values = message
    definition = Definition.parse(text)
    decoded = definition.decode(definition.encode(values))
    assert {name: array.tobytes() for name, array in decoded.items()} == {
        name: array.tobytes() for name, array in values.items()
    }


@given(messages())
def test_another_implementation_decodes_the_same_values(message):
    text, values = message
    payload = Definition.parse(text).encode(values)
    schema = Schema(id=1, data=text.encode(), encoding="ros2msg", name="made_msgs/msg/Made")
    theirs = DecoderFactory().decoder_for("cdr", schema)(payload)
    for line in text.splitlines():
        kind, name = line.split()[:2]
        got = getattr(theirs, name)
        if not isinstance(got, list):
            got = list(got) if isinstance(got, bytes) else [got]
        np.testing.assert_array_equal(np.array(got, kind.removesuffix("[]")), values[name])


@given(messages(), st.data())
def test_a_message_cut_short_is_refused(message, data):
    text, values = message
    definition = Definition.parse(text)
    payload = definition.encode(values)
    cut = data.draw(st.integers(0, len(payload) - 1))
    with pytest.raises(ValueError, match="message"):
        definition.decode(payload[:cut])


def test_a_count_longer_than_the_message_is_refused():
    payload = HEADER + struct.pack("<I", 0xFFFFFFFF) + b"\0" * 16
    with pytest.raises(ValueError, match="ends inside speeds"):
        Definition.parse("float64[] speeds").decode(payload)


def test_bytes_behind_the_message_are_refused():
    definition = Definition.parse("uint8 a")
    with pytest.raises(ValueError, match="8 bytes too many"):
        definition.decode(definition.encode({"a": 1}) + bytes(8))


def test_big_endian_messages_are_refused():
    with pytest.raises(ValueError, match="not little-endian"):
        Definition.parse("uint8 a").decode(b"\0\0\0\0\1")


@pytest.mark.parametrize("line", ["string name", "float64[3] fixed", "Header header", "float64"])
def test_definitions_of_other_things_than_numbers_are_refused(line):
    with pytest.raises(ValueError, match="not a number"):
        Definition.parse(line)
