"""The listed effects: a file of ``dynamics/effects`` defines one ``EFFECT`` of its own name, and is
listed by being there; its ``role`` says whether a search asks it. A listed one also needs its words
in ``meanings.py`` and a twin in ``firmware_sim/effects`` (with its place in ``layout.py`` and
``plant.py``), written apart, which the tests fly beside it (``tests/firmware_sim/test_effects.py``,
``tests/dynamics/effects/test_registry.py``). A user's own is a file alone:
``craft.load_effects``."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pkgutil import iter_modules

from groundstation.dynamics import effects
from groundstation.dynamics.effect import Effect, Role, Stage


def _listed() -> dict[str, Effect]:
    found = {}
    for module in sorted(iter_modules(effects.__path__), key=lambda one: one.name):
        effect = import_module(f"{effects.__name__}.{module.name}").EFFECT
        if effect.name != module.name:
            raise ValueError(f"dynamics/effects/{module.name}.py defines {effect.name!r}")
        found[effect.name] = effect
    return found


EFFECTS: Mapping[str, Effect] = _listed()
"""The listed effects by name, in alphabetical order."""
DISTURBANCE: Effect = next(effect for effect in EFFECTS.values() if effect.role is Role.NOISE)
"""The law of a model's ``disturbance``: what an observer follows, which is no effect."""
DELAY = "dead_time.delay_s"
"""The key under which fits and searches estimate how late every measurement is, s."""
SPIN_UP = "rotor_acceleration_torque.rotor_inertia_kg_m2"
"""The same of what accelerating rotors turn the craft with."""
COMPILED: tuple[Stage, ...] = ("supply", "motor", "rotor", "body", "sensor")
"""Stages whose laws act within the equations of motion; the others are evaluated once."""
ROTORS_TURN_BY: tuple[Stage, ...] = ("supply", "motor")
"""Stages whose laws change how fast a rotor turns by its PWM."""


def at_stage(stage: str) -> tuple[Effect, ...]:
    """The listed effects of a stage in the order in which their laws act."""
    found = [effect for effect in EFFECTS.values() if effect.stage == stage]
    return tuple(sorted(found, key=lambda effect: (effect.order, effect.name)))
