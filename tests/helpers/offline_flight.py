"""A stand-in flown through a programme in fast time, by its client's side of the firmware."""

import numpy as np

from firmware_sim.craft import StandIn
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch

TAKE_OFF_S, TICK_S = 5.0, 0.01
THRUST = 30000


def fly_offline(settings, programme, jitter_s=0.0):
    """(samples, times the setpoints were sent in ns, setpoints (k, 3) in rad, craft).

    settings: with program "wait" and altitude_hold. jitter_s: how late a setpoint may be.
    """
    craft = StandIn(settings)
    late = np.random.default_rng(settings.seed)
    start = 4.0
    packets, heard = craft.advance(start)
    parts = [(packets, heard)]
    # today's firmware takes thrust only from who was armed and has sent zero once
    craft.arm(True)
    craft.command(0.0, 0.0, 0.0, 0)
    level = np.zeros((round(TAKE_OFF_S / TICK_S), 3))
    table = np.vstack([level, programme.setpoints()])
    times = start + TICK_S * np.arange(len(table)) + late.uniform(0, jitter_s, len(table))
    for time_s, (roll, pitch, yaw) in zip(times, table, strict=True):
        parts.append(craft.advance(float(time_s)))
        craft.command(roll, -pitch, -yaw, THRUST)
    packets = np.concatenate([part for part, _ in parts])
    heard = np.concatenate([part for _, part in parts])
    samples, _ = decode_all(RawBatch(packets, np.rint(heard * 1e9).astype(np.int64)))
    flying = samples.time_s - samples.time_s[0] > start + TAKE_OFF_S - 1.0
    sent = np.rint(times * 1e9).astype(np.int64)
    return (
        samples[np.flatnonzero(flying)],
        sent[len(level) :],
        np.radians(table[len(level) :]),
        craft,
    )
