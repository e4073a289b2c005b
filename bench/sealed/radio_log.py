"""Flights of today's craft as a ground station's radio logs them, in fast time.

The stand-in's own log answers, the link's own plan and rows ask and assemble: the two blocks half a
period apart, motors in both, what ``groundstation run --rate 250`` writes. Only the wire between is
left out.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np

from firmware_sim.craft import StandIn
from firmware_sim.crtp import APPEND_V2, CREATE_V2, LOG, START_V2, Conversation
from groundstation.links.log_rows import LogPacket, LogPlan, LogRows, plan_log
from groundstation.telemetry.samples import SampleBatch

PERIOD_MS = 4
"""250 rows a second: the most that two blocks are heard at by most dongles."""
STEP_S, PASS_S = 0.5, 2e-3
A_PACKET = 27
"""Bytes of variables, three each, in one request."""
TYPES = {
    1: ("uint8_t", "B"), 2: ("uint16_t", "H"), 3: ("uint32_t", "I"), 4: ("int8_t", "b"),
    5: ("int16_t", "h"), 6: ("int32_t", "i"), 7: ("float", "f"), 8: ("FP16", "e"),
}  # fmt: skip
"""Number of a type in the log's protocol -> its name, its format."""
NUMBERS = {name: number for number, (name, _) in TYPES.items()}
FORMATS = dict(TYPES.values())


def logged(craft: StandIn, seconds: float, start_ns: int, loss: float = 0.0) -> SampleBatch:
    """The rows of a flight from power-on, ``PERIOD_MS`` apart.

    start_ns: host time of power-on. loss: share of the packets that are not heard. A craft that
    starts anew is asked anew, in a new segment.
    """
    heard = np.random.default_rng((craft.settings.seed, 3))
    conversation = Conversation(craft)
    listed = {name: TYPES[kind][0] for name, kind, _ in conversation.contents.variables}
    plan = plan_log(listed, slow=True)
    rows, parts, boots = LogRows(plan, PERIOD_MS), [], 0
    for until_s in np.arange(STEP_S, seconds + STEP_S / 2, STEP_S):
        craft.advance(float(until_s))
        if not craft.powered:
            continue
        if craft.boots != boots:
            if boots:
                rows.restart(plan, PERIOD_MS)
            boots = craft.boots
            _ask(conversation, craft, plan)
        packets = (
            _read(packet, plan, start_ns, craft)
            for packet in conversation.due(craft.uptime_ms)
            if heard.random() >= loss
        )
        parts.append(rows.add(packets))
    return SampleBatch.concatenate([part for part in parts if len(part)])


def _ask(conversation: Conversation, craft: StandIn, plan: LogPlan) -> None:
    """Let the craft log the plan's blocks, the one with the motors again half a period later."""
    conversation.due(craft.uptime_ms)  # a firmware that started anew has forgotten its blocks
    for number, body in enumerate(_blocks(conversation, plan)):
        for at in range(0, len(body), A_PACKET):
            add = bytes([LOG << 4 | 1, APPEND_V2 if at else CREATE_V2, number])
            (answer,) = conversation.answer(add + body[at : at + A_PACKET])
            assert answer[-1] == 0, answer
        start = bytes([LOG << 4 | 1, START_V2, number]) + PERIOD_MS.to_bytes(2, "little")
        if plan.again and number == plan.again:
            # the craft's clock shows the pass to come, which an advance until then flies as well
            craft.advance(craft.time_s + 1e-3 * (PERIOD_MS / 2) - PASS_S / 2)
        conversation.answer(start)


def _blocks(conversation: Conversation, plan: LogPlan) -> Iterator[bytes]:
    places = {name: place for place, (name, *_) in enumerate(conversation.contents.variables)}
    for block in plan.blocks:
        yield b"".join(
            bytes([NUMBERS[kind]]) + places[name].to_bytes(2, "little") for name, kind in block
        )


def _read(packet: bytes, plan: LogPlan, start_ns: int, craft: StandIn) -> LogPacket:
    number, stamp = packet[1], int.from_bytes(packet[2:5], "little")
    formats = "<" + "".join(FORMATS[kind] for _, kind in plan.blocks[number])
    booted_ms = round(1e3 * craft.time_s) - craft.uptime_ms
    host_ns = start_ns + (booted_ms + stamp) * 1_000_000
    return number, stamp, struct.unpack(formats, packet[5:]), host_ns
