"""A user's own effects: a Python file that defines them, and their law as compiled code.

    from groundstation.dynamics.effects.catalogue import Effect, Parameter

    def spring(values, state, rotor_slope, acceleration):
        acceleration[0] -= values[0] * state[10] ** 3   # rad/s^2 on roll, from the roll rate

    EFFECT = Effect("cubic_damping", "body", (Parameter("d", "s/rad^2", 0.1, 0.001, 10.0),),
                    "-d p^3 on roll", "...", "...", ("gyro x",), law=spring)

A model names the file in the effect's ``source``; whoever flies such a model runs that file, as
with any Python program: take models with a source from people you trust.
"""

from __future__ import annotations

import runpy
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.effects.catalogue import EFFECTS, Effect, Law
from groundstation.errors import BadInputError

Array = NDArray[np.float64]

MOST_VALUES = 16
"""Parameters of all own effects of a model together."""


@cache
def load_effects(path: str | Path) -> Mapping[str, Effect]:
    """The effects that a Python file defines at its top level, by name.

    Raises BadInputError where the file cannot be run, defines none, takes a listed name, or
    defines one without a law.
    """
    try:
        found = runpy.run_path(str(path))
    except FileNotFoundError as error:
        raise BadInputError(f"effect file {path}: no such file; correct the path") from error
    except Exception as error:  # whatever a user's file raises is said as it is
        raise BadInputError(f"effect file {path}: {type(error).__name__}: {error}") from error
    effects = {value.name: value for value in found.values() if isinstance(value, Effect)}
    if not effects:
        raise BadInputError(f"effect file {path}: defines no Effect; see docs/simulate.md")
    for effect in effects.values():
        if effect.name in EFFECTS:
            raise BadInputError(f"effect file {path}: {effect.name} is built in; rename yours")
        if effect.law is None:
            raise BadInputError(f"effect file {path}: {effect.name} has no law")
        law_address((effect.law,), (len(effect.parameters),))
    return effects


def find_effect(name: str, source: str | Path = "") -> Effect:
    """An effect by name: listed, or from the user's file ``source``.

    Raises BadInputError with the names there are.
    """
    known = load_effects(source) if source else EFFECTS
    if name not in known:
        where = f" in {source}" if source else ""
        raise BadInputError(f"effect {name!r}: there are{where} {', '.join(known)}")
    return known[name]


@cache
def law_address(laws: tuple[Law, ...], counts: tuple[int, ...]) -> int:
    """Address of compiled code that runs laws one after another, each on its own values.

    Raises BadInputError for a law that numba cannot compile.
    """
    compiled = _compile(laws, counts)
    _KEPT.append(compiled)
    return int(compiled.address)


def own_acceleration(
    effect: Effect, values: ArrayLike, states: ArrayLike, rotor_slopes: ArrayLike
) -> Array:
    """What an own effect adds, row by row: (n, 17) states and (n, 4) slopes to (n, 6)."""
    if effect.law is None:
        raise ValueError(f"effect {effect.name} has no law of its own")
    numbers = np.asarray(values, np.float64)
    rows = np.asarray(states, np.float64)
    slopes = np.asarray(rotor_slopes, np.float64)
    added = np.zeros((len(rows), 6))
    _all_rows(effect.law)(numbers, rows, slopes, added)
    return added


@cache
def _all_rows(law: Law) -> Any:
    """A law applied to rows of states, compiled."""
    from numba import njit

    one = njit(law)

    @njit
    def every(values: Any, states: Any, slopes: Any, added: Any) -> None:
        for i in range(len(states)):
            one(values, states[i], slopes[i], added[i])

    return every


_KEPT: list[Any] = []
"""Compiled laws live as long as the process: their addresses are in records of plain numbers."""


def _compile(laws: Sequence[Law], counts: Sequence[int]) -> Any:
    from numba import carray, cfunc, njit, types
    from numba.core.errors import NumbaError

    pointer = types.CPointer(types.float64)

    def nothing(values: Any, state: Any, slope: Any, out: Any) -> None:
        pass

    chain = njit(nothing)
    first = 0
    for law, count in zip(laws, counts, strict=True):
        chain = _then(chain, njit(law), first, first + count)
        first += count
    total = chain

    def entry(values: Any, state: Any, slope: Any, out: Any) -> None:
        total(carray(values, MOST_VALUES), carray(state, 17), carray(slope, 4), carray(out, 6))

    try:
        return cfunc(types.void(pointer, pointer, pointer, pointer))(entry)
    except NumbaError as error:
        names = ", ".join(getattr(law, "__name__", "law") for law in laws)
        reason = str(error).strip().splitlines()[-1]
        raise BadInputError(f"effect law {names}: cannot be compiled: {reason}") from error


def _then(before: Any, law: Any, first: int, last: int) -> Any:
    from numba import njit

    @njit
    def both(values: Any, state: Any, slope: Any, out: Any) -> None:
        before(values, state, slope, out)
        law(values[first:last], state, slope, out)

    return both
