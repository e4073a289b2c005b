"""Comparisons and searches as the Python API shows them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from groundstation.comparison.comparison import Comparison
from groundstation.comparison.localisation import worst_stretch
from groundstation.discrepancy.engine import Discrepancy
from groundstation.discrepancy.report_figures import (
    by_horizon,
    time_map,
    waterfall,
    where_map,
    worst_overlay,
)
from groundstation.dynamics.meanings import physics_of, title_of
from groundstation.report.result import Shown

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure


def comparison(one: Comparison) -> Shown:
    """Where the model errs, channel by regime; each figure of the report."""
    places = one.places
    names = ("channel", "regime", "rms", "expected_rms", "unit", "significance", "seconds")
    columns = {name: [getattr(place, name) for place in places] for name in names}
    pictures = {
        "where": partial(_drawn, lambda: where_map([("error over noise", places)]), "Where"),
        "time": partial(_drawn, lambda: time_map(one), "Second by second"),
        "horizons": partial(_drawn, lambda: by_horizon(one), "By horizon"),
        **_worst(one, None),
    }
    line = f"prediction errors are {one.gap:.2f} times noise over all channels"
    return Shown(line, columns, list(one.warnings.values()), pictures)


def discrepancy(one: Discrepancy) -> Shown:
    """The effects that were found, with their sizes; each figure of the report."""
    proof = one.proof
    columns: dict[str, list[object]] = {
        name: []
        for name in ("effect", "title", "does", "parameter", "value", "stderr", "unit", "weight")
    }
    for effect in one.findings.effects:
        values = {name: each.value for name, each in effect.parameters.items()}
        does = physics_of(effect.name, values) or effect.adds
        for name, each in effect.parameters.items():
            row = (effect.name, title_of(effect.name), does, name, each.value, each.stderr)
            for column, cell in zip(
                columns.values(), (*row, each.unit, float(effect.weight)), strict=True
            ):
                column.append(cell)
    maps = [("before", proof.before.places), ("after", proof.after.places)]
    pictures = {
        "gap": partial(_drawn, lambda: waterfall(proof.steps), "The gap, effect by effect"),
        "where": partial(_drawn, lambda: where_map(maps), "Where, before and after"),
        "horizons": partial(_drawn, lambda: by_horizon(proof.before, proof.after), "By horizon"),
        **_worst(proof.before, proof.after),
    }
    return Shown(repr(one), columns, one.warnings, pictures)


def _worst(before: Comparison, after: Comparison | None) -> dict[str, partial[tuple[Figure, str]]]:
    """The channel that is worst, where it is worst."""
    if not before.places:
        return {}
    stretch = worst_stretch(before.errors, before.floors, before.places[0].channel)
    if stretch is None:
        return {}
    draw = partial(worst_overlay, stretch, before, after)
    return {"worst": partial(_drawn, draw, "Where the model is wrong most")}


def _drawn(draw: Callable[[], Figure], words: str) -> tuple[Figure, str]:
    return draw(), words
