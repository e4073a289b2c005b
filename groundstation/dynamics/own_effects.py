"""A user's own effects beside the listed ones.

A user's file (``--effects FILE``, or a model's ``source``) defines any number at its top level.
Whoever flies a model with a source runs that file, as with any Python program: only one that is
known, or consented to (``groundstation.dynamics.trust``).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, get_args

from groundstation.dynamics.effect import Effect, Stage
from groundstation.dynamics.registry import COMPILED, EFFECTS
from groundstation.dynamics.trust import trusted_source
from groundstation.errors import BadInputError


@cache
def load_effects(path: str | Path) -> Mapping[str, Effect]:
    """The effects that a Python file defines at its top level, by name.

    Raises BadInputError where the file may not or cannot be run, defines none, takes a listed
    name, or defines one whose law cannot be compiled.
    """
    try:
        found: dict[str, Any] = {"__name__": "effects", "__file__": str(path)}
        exec(compile(trusted_source(Path(path)), str(path), "exec"), found)
    except BadInputError:
        raise
    except FileNotFoundError as error:
        raise BadInputError(f"effect file {path}: no such file; correct the path") from error
    except Exception as error:  # whatever a user's file raises is said as it is
        raise BadInputError(f"effect file {path}: {type(error).__name__}: {error}") from error
    theirs = {value.name: value for value in found.values() if isinstance(value, Effect)}
    if not theirs:
        raise BadInputError(f"effect file {path}: defines no Effect; see docs/simulate.md")
    for effect in theirs.values():
        if effect.name in EFFECTS:
            raise BadInputError(f"effect file {path}: {effect.name} is built in; rename yours")
        _require_law(effect, path)
    return theirs


def find_effect(name: str, source: str | Path = "") -> Effect:
    """An effect by name: listed, or from the user's file ``source``.

    Raises BadInputError with the names there are.
    """
    known = load_effects(source) if source else EFFECTS
    if name not in known:
        where = f" in {source}" if source else ""
        raise BadInputError(f"effect {name!r}: there are{where} {', '.join(known)}")
    return known[name]


def _require_law(effect: Effect, path: str | Path) -> None:
    """Raises BadInputError for an effect that cannot be flown."""
    where = f"effect file {path}: {effect.name}"
    if not callable(effect.law):
        raise BadInputError(f"{where} has no law")
    if effect.stage not in get_args(Stage):
        raise BadInputError(
            f"{where}: stage {effect.stage!r}; there are {', '.join(get_args(Stage))}"
        )
    if effect.states and effect.stage not in ("body", "sensor"):
        raise BadInputError(f"{where}: only an effect of the body or a sensor may have states")
    if effect.stage in COMPILED:
        from groundstation.dynamics.chains import own_address

        own_address(effect.stage, (effect,), (0,))
