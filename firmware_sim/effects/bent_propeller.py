"""A torque that turns with its rotor, without a force: the couple of ``propeller_imbalance``."""

from __future__ import annotations

from typing import Any

from firmware_sim.effects.effect import ROTOR, Effect, Values, size
from firmware_sim.effects.propeller_imbalance import put


def _apply(p: Any, values: Values) -> None:
    put(p, values["rotor"], 0.0, values["torque_n_m"] / 250.0**2)


EFFECT = Effect(
    parameters={"rotor": (1.0, ""), "torque_n_m": (5e-5, "N m")},
    apply=_apply,
    draw=lambda generator: {
        "rotor": float(generator.integers(1, 5)),
        "torque_n_m": size(generator, 2e-5, 2e-4),
    },
    limits={"rotor": ROTOR, "torque_n_m": (-0.01, 0.01)},
    listed=False,
)
