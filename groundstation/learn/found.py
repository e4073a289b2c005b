"""What a search found, as names and in words: what is worth a name, and what is still open."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.discrepancy.report_json import DiscrepancyReport, EffectFound, PossibleEffect
from groundstation.documents import decode_json, read_document
from groundstation.dynamics.effect import to_point
from groundstation.dynamics.registry import EFFECTS
from groundstation.errors import BadInputError
from groundstation.identification.likelihood.motion import KEYS

WORTH = 0.1
"""Of the size worth finding: what is smaller in every number is told, and not named."""


def read_found(path: Path) -> DiscrepancyReport:
    """The findings in a file. Raises BadInputError."""
    try:
        return decode_json(read_document(path), DiscrepancyReport)
    except (OSError, ValueError) as error:
        raise BadInputError(f"{path}: cannot be read ({error}); remove it") from error


def named_effects(found: DiscrepancyReport) -> list[EffectFound]:
    """Effects that were found and are worth a name."""
    return [one for one in found.effects if not _corrects(one) and _size(one) >= WORTH]


def _corrects(found: EffectFound) -> bool:
    """Whether it only says anew a constant of the model, which was fitted to this very craft."""
    return found.name in EFFECTS and EFFECTS[found.name].renames is not None


def _size(found: EffectFound | PossibleEffect) -> float:
    """The largest of an effect's sizes, over the one worth finding; a user's own always counts."""
    if found.name not in EFFECTS:
        return np.inf
    point = to_point(EFFECTS[found.name], {k: one.value for k, one in found.parameters.items()})
    return max(
        abs(value - KEYS[key].absent) / KEYS[key].worth
        for key, value in point.items()
        if KEYS[key].parameter.kind == "size"
    )


def open_names(found: DiscrepancyReport) -> dict[str, list[str]]:
    """Names with others that explain as much, and what is only possible and worth a name."""
    rivals = {one.name: one.alternatives for one in named_effects(found) if one.alternatives}
    rivals |= {one.name: one.alternatives for one in found.possible if _size(one) >= WORTH}
    return {name: [other.name for other in others] for name, others in rivals.items()}


def open_words(found: DiscrepancyReport) -> list[str]:
    """The same in words."""
    possible = {one.name for one in found.possible}
    words = []
    for name, others in open_names(found).items():
        could = f"could also be {' or '.join(others)}" if others else ""
        maybe = "is possible, not sure" if name in possible else ""
        words.append(f"{name} {' and '.join(part for part in (maybe, could) if part)}")
    return words


def known_errors(found: DiscrepancyReport) -> dict[str, float]:
    """What flights say already of effects' sizes, by key: of those that are open nothing."""
    open_ones = {name for pair in open_names(found).items() for name in (pair[0], *pair[1])}
    weak = {f"{one.name}.{one.parameter}": one.stderr or np.inf for one in found.not_shown}
    known = {}
    for key, one in KEYS.items():
        if one.effect.name not in open_ones:
            known[key] = min(weak.get(key, one.worth / 10.0), one.worth) or 1.0
    return known


def found_line(found: DiscrepancyReport) -> str:
    named = (
        "; ".join(said_effect(one.name, one.parameters) for one in named_effects(found))
        or "nothing"
    )
    gap = found.gap.validation
    after = gap.before if gap.after is None else gap.after
    corrected = [one for one in found.effects if _corrects(one)]
    hardly = sorted(
        {one.name for one in found.effects}
        - {one.name for one in (*corrected, *named_effects(found))}
    )
    told = f"named: {named}; on the proof flight predictions miss by {gap.before:.2f} times the"
    told += f" noise before and {after:.2f} times after"
    for one in corrected:
        told += f"; the fit's constants are corrected by {said_effect(one.name, one.parameters)}"
    if hardly:
        told += f"; {', '.join(hardly)} too small to be named"
    for words in open_words(found):
        told += f"; {words}"
    return told


def said_effect(name: str, parameters: Mapping[str, Any]) -> str:
    """An effect with its numbers: 'dead_time delay_s 0.0041 ± 0.0001 s'."""
    parts = []
    for key, one in parameters.items():
        unit = EFFECTS[name].parameter(key).unit if name in EFFECTS else one.unit
        spread = "" if one.stderr is None else f" ± {one.stderr:.2g}"
        parts.append(f"{key} {one.value:.4g}{spread} {unit}".rstrip())
    return f"{name} ({', '.join(parts)})"
