"""A user's own effects as candidates of the search: through their law, with numeric derivatives.

The unknowns are the effect's sizes, the parameters that alone make a difference, counted from the
value at which the effect is absent. Parameters that only shape it (a length over which it fades,
say) stay at the value of the model, or at their default.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.effects.catalogue import EFFECTS, Effect, Parameter
from groundstation.dynamics.effects.own import load_effects, own_acceleration
from groundstation.dynamics.model import EffectTerm, Estimate, Model
from groundstation.errors import BadInputError

Array = NDArray[np.float64]

STEP = 0.01
"""Of the numeric derivatives, over the parameter's default."""
TRIED = 64
"""States at which it is seen which parameters are sizes."""


@dataclass(frozen=True)
class OwnEffect:
    """An effect of the user's.

    source: the file that defines it. sizes: names of the parameters to be found. reference: value
    of every parameter where the search begins to count: absent for sizes.
    """

    effect: Effect
    source: str
    sizes: tuple[str, ...]
    reference: Mapping[str, float]

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(f"{self.effect.name}.{name}" for name in self.sizes)

    def values(self, point: Mapping[str, float]) -> dict[str, float]:
        """Every parameter of the effect at a point of the search."""
        name = self.effect.name
        return {key: one + point.get(f"{name}.{key}", 0.0) for key, one in self.reference.items()}

    def present(self, point: Mapping[str, float]) -> bool:
        return any(point.get(key, 0.0) != 0.0 for key in self.keys)

    def parameter(self, key: str) -> Parameter:
        return self.effect.parameter(key.partition(".")[2])

    def range_of(self, key: str) -> tuple[float, float]:
        """Plausible values of an unknown."""
        one = self.parameter(key)
        return one.low - one.absent, one.high - one.absent

    def estimates(
        self, point: Mapping[str, float], errors: Mapping[str, float]
    ) -> dict[str, Estimate]:
        """The parameters as a model file has them; those that are not fitted have no error."""
        name = self.effect.name
        return {
            key: Estimate(value, errors.get(f"{name}.{key}"), self.effect.parameter(key).unit)
            for key, value in self.values(point).items()
        }

    def acceleration(self, point: Mapping[str, float], states: Array, slopes: Array) -> Array:
        """What the effect adds (n, 6) at states (n, 17) with rotor slopes (n, 4)."""
        return own_acceleration(self.effect, list(self.values(point).values()), states, slopes)

    def column(self, key: str, point: Mapping[str, float], states: Array, slopes: Array) -> Array:
        """Its derivative (n, 6) by an unknown, central differences."""
        one = self.parameter(key)
        step = STEP * max(abs(one.default - one.absent), 1e-3 * (one.high - one.low))
        high, low = (
            self.acceleration({**point, key: point.get(key, 0.0) + sign * step}, states, slopes)
            for sign in (1.0, -1.0)
        )
        return np.asarray((high - low) / (2.0 * step))


def own_effects(path: str | Path) -> list[OwnEffect]:
    """The effects that a file defines, as candidates. Raises BadInputError like ``load_effects``,
    and for one whose law does nothing."""
    source = str(Path(path).resolve())
    return [_own(effect, source, {}) for effect in load_effects(source).values()]


def own_terms(model: Model) -> tuple[list[OwnEffect], dict[str, float]]:
    """The own effects that a model has already, and where they stand in the search's unknowns."""
    found: list[OwnEffect] = []
    point: dict[str, float] = {}
    for term in model.effects:
        if term.name in EFFECTS:
            continue
        effect = load_effects(term.source)[term.name]
        values = effect.values({name: one.value for name, one in term.parameters.items()})
        one = _own(effect, term.source, values)
        found.append(one)
        point |= {f"{effect.name}.{name}": values[name] - one.reference[name] for name in one.sizes}
    return found, point


def joined(known: Sequence[OwnEffect], candidates: Sequence[OwnEffect]) -> list[OwnEffect]:
    """The model's own effects and further candidates.

    Raises BadInputError where two files define one name.
    """
    found = {one.effect.name: one for one in known}
    for one in candidates:
        other = found.setdefault(one.effect.name, one)
        if other.source != one.source:
            raise BadInputError(
                f"effect {one.effect.name}: defined in {one.source} and, for the model, in"
                f" {other.source}; rename one"
            )
    return list(found.values())


def term_of(one: OwnEffect, point: Mapping[str, float], errors: Mapping[str, float]) -> EffectTerm:
    """The term of a model file."""
    return EffectTerm(one.effect.name, one.estimates(point, errors), one.source)


def _own(effect: Effect, source: str, values: Mapping[str, float]) -> OwnEffect:
    sizes = _sizes(effect)
    if not sizes:
        raise BadInputError(
            f"effect file {source}: {effect.name} adds nothing at the default of any parameter;"
            " nothing could be found of it"
        )
    reference = {
        p.name: p.absent if p.name in sizes else values.get(p.name, p.default)
        for p in effect.parameters
    }
    return OwnEffect(effect, source, sizes, reference)


def _sizes(effect: Effect) -> tuple[str, ...]:
    """Parameters that make a difference at their default while the others are absent, or, should
    the law not stand that, whose absence it stands and which make a difference at all defaults."""
    draw = np.random.default_rng(0)
    states = draw.normal(size=(TRIED, 17))
    states[:, 6:10] /= np.linalg.norm(states[:, 6:10], axis=1)[:, None]
    states[:, 13:] = 250.0 + 20.0 * states[:, 13:]
    slopes = 500.0 * draw.normal(size=(TRIED, 4))

    def added(values: Mapping[str, float]) -> Any:
        try:
            with np.errstate(all="ignore"):
                return own_acceleration(effect, list(values.values()), states, slopes)
        except ZeroDivisionError:
            return np.full(1, np.nan)

    absent = {p.name: p.absent for p in effect.parameters}
    found = []
    for p in effect.parameters:
        alone = added({**absent, p.name: p.default})
        if not np.isfinite(alone).all():
            default = {q.name: q.default for q in effect.parameters}
            whole, without = added(default), added({**default, p.name: p.absent})
            if np.isfinite(without).all() and np.isfinite(whole).all() and (whole != without).any():
                found.append(p.name)
        elif alone.any():
            found.append(p.name)
    return tuple(found)
