"""Comparisons and searches as the Python API shows them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from groundstation.comparison.comparison import Comparison, worst_stretch
from groundstation.discrepancy.engine import Discrepancy
from groundstation.discrepancy.report_figures import (
    by_horizon,
    time_map,
    waterfall,
    where_map,
    worst_overlay,
)
from groundstation.discrepancy.report_words import meaning
from groundstation.dynamics.meanings import title_of
from groundstation.report.page import Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def comparison(one: Comparison) -> Shown:
    """Where the model errs, channel by regime; each figure of the report."""
    places = one.places
    names = ("channel", "regime", "rms", "expected_rms", "unit", "significance", "seconds")
    columns = {name: [getattr(place, name) for place in places] for name in names}
    pictures = {
        "where": partial(where_map, [("error over noise", places)]),
        "time": partial(time_map, one),
        "horizons": partial(by_horizon, one),
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
        does = meaning(effect)
        for name, each in effect.parameters.items():
            row = (effect.name, title_of(effect.name), does, name, each.value, each.stderr)
            for column, cell in zip(
                columns.values(), (*row, each.unit, float(effect.weight)), strict=True
            ):
                column.append(cell)
    maps = [("before", proof.before.places), ("after", proof.after.places)]
    pictures = {
        "gap": partial(waterfall, proof.steps),
        "where": partial(where_map, maps),
        "horizons": partial(by_horizon, proof.before, proof.after),
        **_worst(proof.before, proof.after),
    }
    return Shown(repr(one), columns, one.warnings, pictures)


def _worst(before: Comparison, after: Comparison | None) -> dict[str, partial[Figure]]:
    """The channel that is worst, where it is worst."""
    if not before.places:
        return {}
    stretch = worst_stretch(before.errors, before.floors, before.places[0].channel)
    if stretch is None:
        return {}
    return {"worst": partial(worst_overlay, stretch, before, after)}
