"""``python -m bench.floor [NAME...]``: gaps of the base model and of the true one, by effect.

Flights of the reduced stand-in with one effect at medium size: two to learn the noise floor
on, a third to judge on. The table of bench/sealed/RESULTS.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from affected_flights import BASE, MEDIUM, affected
from compared_flights import flights, hidden

from groundstation.comparison.channels import CHANNELS
from groundstation.comparison.comparison import compare

SECONDS = 60.0


def main(names: list[str]) -> None:
    print(
        "| hidden | worst channel | gap before | with the true effect | explained | first place |"
    )
    print("|---|---|---|---|---|---|")
    noisy = {"torque_noise": 6.0, "sensor_noise": 2.0}
    for name in names or ["nothing", "nothing, noise x6", *MEDIUM]:
        settings = noisy if name.endswith("x6") else {}
        effects = hidden(name, MEDIUM[name]) if name in MEDIUM else ()
        made = [
            list(flights(seed, effects=effects, seconds=SECONDS, **settings)) for seed in (1, 2, 3)
        ]
        learnt = compare(made[0] + made[1], BASE)
        before = compare(made[2], BASE, learnt.black_box)
        model = affected(name) if name in MEDIUM else msgspec.structs.replace(BASE)
        after = before.with_model(model)
        ratio = before.rms / before.noise_floor
        worst = int(np.nanargmax(ratio))
        left = after.rms[worst] / before.noise_floor[worst]
        explained = (ratio[worst] ** 2 - left**2) / (ratio[worst] ** 2 - 1.0)
        first = before.places[0]
        clear = f"{first.channel}, {first.regime}" if first.significance > 3.0 else "-"
        share = f"{explained:.2f}" if ratio[worst] > 1.02 else "-"
        print(
            f"| {name} | {CHANNELS[worst]} | {ratio[worst]:.2f} | {left:.3f} | {share} | {clear} |",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:])
