"""``python -m bench.delay [SEEDS]``: is the thesis's nk = 8 a delay of 16 ms?

Flights of 60 s of three crafts whose delay is known. How often which delay comes out on each axis:
of ARX(2,1,nk) on the angle, as in the thesis, by one-step error and by free run (2 s, held-out
third); of the structure that is chosen of all 88; of ARX(2,1,nk) on the gyro by one-step error. And
the delay that the fit of the body finds.
"""

from __future__ import annotations

import sys
from collections import Counter
from typing import Any

import msgspec
import numpy as np

from bench.sealed.flights import CARRY
from firmware_sim.craft import StandIn, StandInSettings
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.arx.data import ArxData, arx_data
from groundstation.identification.arx.fit import ArxSearch, search_arx
from groundstation.identification.body.fit import fit_body
from groundstation.identification.division import hold_out
from groundstation.identification.runs import Run, runs_of
from groundstation.identification.stretches import stretches_of
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch

VEHICLE = BUILT_IN["crazyflie1"]
CRAFTS: dict[str, dict[str, Any]] = {
    "no delay (reduced)": {"plant": "reduced"},
    "3.3 ms (faithful)": {"plant": "faithful"},
    "16 ms (faithful)": {"plant": "faithful", "sensor": {"delay_s": 0.016}},
}
AXES = ("roll", "pitch", "yaw")
COLUMNS = ("angle, one step", "angle, free run", "chosen of 88", "gyro, one step")
SECONDS, SEEDS = 60.0, 10


def main() -> int:
    """Prints a table in Markdown."""
    seeds = range(1, 1 + (int(sys.argv[1]) if sys.argv[1:] else SEEDS))
    print(f"nk or structure (in so many of {len(seeds)} flights); delay: mean and range\n")
    print(f"| craft | axis | {' | '.join(COLUMNS)} | body fit, ms |")
    print("|" + "---|" * (len(COLUMNS) + 3))
    for craft, settings in CRAFTS.items():
        flights = [_flown(seed, settings) for seed in seeds]
        delays = [_body_delay_ms(parts) for parts in flights]
        late = f"{np.mean(delays):.1f} ({min(delays):.1f} to {max(delays):.1f})"
        for axis in AXES:
            counts: list[Counter[str]] = [Counter() for _ in COLUMNS]
            for parts in flights:
                for count, nk in zip(counts, _chosen(parts, axis), strict=True):
                    count[nk] += 1
            cells = " | ".join(_shown(count) for count in counts)
            print(f"| {craft} | {axis} | {cells} | {late} |", flush=True)
    return 0


def _flown(seed: int, settings: dict[str, Any]) -> tuple[list[Run], list[Run]]:
    given = {"seed": seed, "gains": CARRY, **settings}
    craft = StandIn(msgspec.convert(given, StandInSettings))
    packets, heard_s = craft.advance(SECONDS)
    samples, _ = decode_all(RawBatch(packets, np.rint(heard_s * 1e9).astype(np.int64)))
    stretches = stretches_of(runs_of(samples, f"seed {seed}"), VEHICLE.motor)
    return hold_out([one.run[one.rows] for one in stretches])


def _chosen(parts: tuple[list[Run], list[Run]], axis: str) -> tuple[str, ...]:
    """What stands under ``COLUMNS``, of one flight."""
    angle, rate = (_searched(parts, axis, channel) for channel in ("attitude", "gyro"))
    second, on_gyro = (
        [one for one in search.candidates if one.order[:2] == (2, 1)] for search in (angle, rate)
    )
    return (
        str(min(second, key=lambda one: one.rms_step).axis.nk),
        str(min(second, key=lambda one: one.rms_validation).axis.nk),
        angle.chosen.label,
        str(min(on_gyro, key=lambda one: one.rms_step).axis.nk),
    )


def _searched(parts: tuple[list[Run], list[Run]], axis: str, channel: str) -> ArxSearch:
    fit, held = ([_data(run, axis, channel) for run in part if run.seconds > 2.0] for part in parts)
    return search_arx(fit, held)


def _data(run: Run, axis: str, channel: str) -> ArxData:
    return arx_data(run, axis, VEHICLE.motor, VEHICLE.configuration, channel=channel)


def _body_delay_ms(parts: tuple[list[Run], list[Run]]) -> float:
    flown = stretches_of([*parts[0], *parts[1]], VEHICLE.motor)
    effects = ("dead_time", "rotor_acceleration_torque")
    return 1e3 * float(fit_body(flown, VEHICLE, effects).estimates["dead_time.delay_s"])


def _shown(count: Counter[str]) -> str:
    return ", ".join(f"{what} ({times})" for what, times in count.most_common())


if __name__ == "__main__":
    sys.exit(main())
