"""The air between craft and bridge: four copies of each packet, lost in bursts.

NRF24L01+ at 2 Mbit/s: 295 us of air time for 32 bytes; the add-on refreshes its buffer every
2 ms and sends it every 500 us.
"""

from __future__ import annotations

from typing import Any

from firmware_sim.layout import RADIO_STREAM
from firmware_sim.random_numbers import uniform
from groundstation.compiled import kernel

REPEAT_NS = 500_000
FIRST_COPY_NS = 250_000
"""From the start of a pass until its packet is on the air."""
AIR_NS = 295_000
FETCH_NS = 40_000
"""Interrupt and SPI transfer in the receiver."""
DAMAGED_BITS = 256


@kernel
def transmit(
    times: Any, copies: int, loss: Any, air: Any, rng: Any, row: Any, heard: Any, bit: Any
) -> int:
    """The compiled radio: ``transmit(times, copies, loss, air, rng, row, heard, bit)``.

    times: (n,) ns of the passes; loss: (5,) good_loss, bad_loss, to_bad, to_good, damage.
    air: (1,) int64, 1 while the channel is bad; rng: the state's streams.
    Fills, for each copy that arrives, its row, the time (ns) at which the bridge has it, and
    the bit that was damaged (-1: none); returns how many arrived.
    """
    count = 0
    for i in range(len(times)):
        for copy in range(copies):
            change = loss[3] if air[0] != 0 else loss[2]
            if change > 0.0 and uniform(rng, RADIO_STREAM) < change:
                air[0] = 1 - air[0]
            chance = loss[1] if air[0] != 0 else loss[0]
            if chance > 0.0 and uniform(rng, RADIO_STREAM) < chance:
                continue
            row[count] = i
            heard[count] = times[i] + FIRST_COPY_NS + copy * REPEAT_NS + AIR_NS + FETCH_NS
            bit[count] = -1
            if loss[4] > 0.0 and uniform(rng, RADIO_STREAM) < loss[4]:
                bit[count] = int(uniform(rng, RADIO_STREAM) * DAMAGED_BITS)
            count += 1
    return count
