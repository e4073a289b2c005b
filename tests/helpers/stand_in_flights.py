"""Recordings of the stand-in as a ground station decodes them, with the truth beside them."""

import msgspec
import numpy as np

from firmware_sim.craft import StandIn, StandInSettings
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch

CARRYING_GAINS = {
    "pid_rate.roll_kp": 30.0,
    "pid_rate.pitch_kp": 30.0,
    "pid_attitude.roll_kp": 3.0,
    "pid_attitude.pitch_kp": 3.0,
    "pid_attitude.roll_ki": 3.0,
    "pid_attitude.pitch_ki": 3.0,
}
"""Gains that carry effects of every size (docs/stand_in.md)."""


def recorded(seconds, **settings):
    """(samples, truth) of a stand-in's flight; the truth has one row per pass with power."""
    craft = StandIn(msgspec.convert({"truth": True, **settings}, StandInSettings))
    packets, heard_s = craft.advance(seconds)
    samples, _ = decode_all(RawBatch(packets, np.rint(heard_s * 1e9).astype(np.int64)))
    return samples, craft.truth()


def truth_of(samples, truth):
    """The rows of ``truth`` that belong to ``samples`` of one segment, by device time."""
    first = np.median(samples.time_s[:50] - 0.002 * np.arange(50)) - samples.time_s[0]
    index = np.rint((samples.time_s - samples.time_s[0] - first) / 0.002).astype(int)
    return truth[np.clip(index, 0, len(truth) - 1)]
