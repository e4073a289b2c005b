"""A search told: in words, in figures and as one HTML page.

Sentences that belong to one thing stand with it: why a name was refused in ``acceptance.py`` and
``proof.py``, what an effect is in ``dynamics/meanings.py``, warnings in ``engine.py``, what was
not looked for in ``report_json.py``."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import partial
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np

from groundstation.comparison.comparison import (
    Comparison,
    Place,
    Spectrum,
    Stretch,
    over_time,
    spectrum_of,
    worst_stretch,
)
from groundstation.comparison.gap import CHANNELS, HORIZONS_S, PER_SI, UNITS, WHOLE
from groundstation.discrepancy.engine import Discrepancy
from groundstation.discrepancy.proof import LEFT, EffectFound, Leftover, NotShown, Proof
from groundstation.discrepancy.report_json import (
    CompareReport,
    DiscrepancyReport,
    Gap,
    why_lost,
)
from groundstation.dynamics.meanings import FOUND, physics_of, title_of
from groundstation.dynamics.model import Estimate
from groundstation.report.page import (
    GOOD,
    HEAT,
    IMPROVED,
    INK,
    MEASURED,
    MISSING,
    MODELLED,
    NEUTRAL,
    NOTE,
    ON_BRIGHT,
    ON_DARK,
    PAPER,
    Advice,
    Page,
    Shown,
    figure,
    legend_above,
)
from groundstation.telemetry.arrays import Array
from groundstation.text import listed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from groundstation.discrepancy.proof import Candidate

# What a discrepancy report begins with, in plain words: what was found, how sure it is, what to do
# next, and one flight that would show the rest.


CLEAR, PLACES = 3.0, 8
"""Standard deviations of noise energy from which a place is worth naming; so many are in lines."""
SURE = 1.96
"""Standard errors either way that hold 95 % of estimates."""
LARGE_LEFT = 0.3
"""Share of what was wrong from which what is left is worth a warning of its own."""
FAR = 2.0
"""Gap of a channel from which simulations of it are not to be relied on."""
DOUBTS = {
    "recordings_disagree": "though stretches and flights differ by nearly as much",
    "without_weight": "though predictions are hardly better with it",
    "predicts_worse": "though a channel of its own is predicted worse with it on other flights",
}
"""Of what is possible, by the reason why it is not named."""


def titled(effect: str) -> str:
    """An effect as people call it; of one that may be of several rotors also which."""
    name, _, rotor = effect.partition(".")
    return title_of(name) + (f" ({rotor})" if rotor else "")


def label(channel: str) -> str:
    """A channel as people read it."""
    return channel.replace("_", " ")


def by_weight(effects: Sequence[EffectFound]) -> list[EffectFound]:
    """What explains most first; those of which that is not known last, as they were added."""
    return sorted(effects, key=lambda one: -(one.weight if one.weight is not None else -1.0))


def is_zero(estimate: Estimate) -> bool:
    """Whether a parameter cannot be told from zero."""
    return estimate.stderr is not None and abs(estimate.value) < SURE * estimate.stderr


def meaning(effect: EffectFound) -> str:
    """What it does to the craft, with the size that was found."""
    values = {name: one.value for name, one in effect.parameters.items()}
    return physics_of(effect.name, values) or effect.adds


def chosen_in_words(share: float) -> str:
    """How often resamples choose a name."""
    return f"chosen in {100.0 * share:.0f} % of resamples"


def possible_in_words(report: DiscrepancyReport) -> Iterator[str]:
    """Effects that are fitted along and not named, a line each."""
    for one in report.possible:
        others = [
            f"{title_of(other.name)} in {100.0 * other.share:.0f} %"
            for other in one.alternatives
            if other.share
        ]
        instead = f", in its place {listed(others)}" if others else ""
        why = DOUBTS.get(one.reason, chosen_in_words(one.recurrence))
        yield (
            f"possible: {title_of(one.name)}, {why}{instead}; fitted along, its part is counted"
            " with the changed constants"
        )


def found_in_words(report: DiscrepancyReport) -> str:
    """What was found and how sure that is: the first line."""
    level = report.gap.validation
    gap = f"prediction errors are {level.before:.2f} times noise"
    if report.verdict in FOUND:
        effects = by_weight(report.effects)
        names = [f"{title_of(one.name)} ({meaning(one)})" for one in effects[:2]]
        rest = [title_of(one.name) for one in effects[2:]]
        part = ", and more than that" if report.verdict == "found_in_part" else ""
        return f"Missing in the model{part}: {listed([*names, *rest])}. {_how_sure(report)}"
    if report.verdict == "unexplained" and report.possible:
        maybe = listed([title_of(one.name) for one in report.possible])
        return f"Something acts on the craft, and no name is sure: {gap}; possible: {maybe}."
    if report.verdict == "unexplained":
        return (
            f"Something acts on the craft that no effect in the list describes: {gap}, and no name"
            " takes a tenth of that off."
        )
    moved = [change.name for change in report.base_changes]
    if moved:
        return f"No effect is missing, but {listed(moved)} had to change. {_how_sure(report)}"
    within = f", within the {LEFT:g} that noise levels are known to" if level.before <= LEFT else ""
    return (
        "Nothing is missing that these recordings could show. Checked"
        f" {_checked_on(report)}: {gap}{within}."
    )


def _checked_on(report: DiscrepancyReport) -> str:
    whole = isinstance(report.validation, list)
    return f"on {'' if whole else 'the parts of these '}recordings that no fit has seen"


def _how_sure(report: DiscrepancyReport) -> str:
    level, what = report.gap.validation, report.explained
    if level.after is None:
        return ""
    change = f"prediction errors fall from {level.before:.2f} to {level.after:.2f} times noise"
    if level.after > level.before:
        change = (
            f"prediction errors grow from {level.before:.1f} to {level.after:.1f} times noise, so"
            " the model is none the better for it"
        )
    share = ""
    if what is not None:
        percent = 100.0 * (what.named + what.constants)
        share = f", and what was found explains {percent:.0f} % of what was wrong"
    return f"Checked {_checked_on(report)}: {change}{share}."


def next_in_words(report: DiscrepancyReport, written: bool = False) -> str:
    """What to do now: the second line. written: whether the improved model is in a file."""
    level = report.gap.validation
    plan = flight_plan(report.not_shown)
    fly = f"fly the plan below ({plan[0][0]})" if plan else "fly another flight of another kind"
    better = level.after is not None and level.after < level.before
    if report.verdict == "unexplained":
        worst = report.where[0] if report.where else None
        place = f", where {_in_regime(worst.channel, worst.regime)} is worst" if worst else ""
        return f"look at the map below{place}; then {fly} and search again with both recordings."
    if report.verdict == "no_discrepancy" and not report.base_changes:
        return f"use the model as it is; to look for what this flight cannot show, {fly}."
    if not better:
        return f"keep the given model; {fly} and search again with both recordings."
    use = "use the improved model" if written else "write the improved model with -o, use it"
    use += " in place of the given one"
    if off := _still_off(report):
        use += f", but do not rely on its {listed(off)}"
    more = f"; to look for the rest, {fly}" if plan else ""
    return f"{use}{more}."


def compared_in_words(report: CompareReport, worst: Place | None) -> str:
    """Where a model disagrees with recordings; worst: the place that is clearly worse than noise,
    None: there is none."""
    gap = report.gap.validation.before
    if worst is None:
        return f"The model predicts these recordings as well as noise allows ({gap:.2f} times)."
    ratio = worst.rms / worst.expected_rms
    return (
        f"The model's prediction errors are {gap:.1f} times noise over all channels, and most"
        f" clearly so in {_in_regime(worst.channel, worst.regime)}: {ratio:.1f} times noise."
    )


def compared_next(report: CompareReport, worst: Place | None) -> str:
    """What to do with that."""
    if worst is None:
        return "use the model; compare it with a flight of another kind as well."
    names = " ".join(report.recordings)
    return (
        f"ask what is missing: groundstation discrepancy OTHER_FLIGHTS --model {report.model}"
        f" --validate {names}."
    )


def advice_of(report: DiscrepancyReport) -> list[Advice]:
    """What must not be overlooked, the gravest first."""
    found: list[Advice] = []
    level, what = report.gap.validation, report.explained
    plan = flight_plan(report.not_shown)
    fly = f"Fly the plan below: {plan[0][0]}" if plan else "Fly longer, and other manoeuvres"

    def advise(what: str, why: str, do: str) -> None:
        found.append(Advice(what[:1].upper() + what[1:], why, do))

    if report.gap.worse:
        names = listed([label(one) for one in report.gap.worse])
        advise(
            f"The improved model predicts {names} worse than the given one",
            "What was found may stand for something else there",
            "Search with one more recording of another kind",
        )
    beyond = level.after is not None and level.after > LEFT
    if what is not None and what.left > LARGE_LEFT and beyond:
        where = f", most of it in {label(report.left[0].channel)}" if report.left else ""
        advise(
            f"{100.0 * what.left:.0f} % of what was wrong is still unexplained{where}",
            "Simulations err by as much beyond noise",
            fly,
        )
    if what is not None and what.disturbance > LARGE_LEFT:
        advise(
            f"{100.0 * what.disturbance:.0f} % of what was wrong are slow forces and moments"
            " without a name",
            "They are followed, not predicted: a simulation does not have them",
            "Fly in still air, away from walls, with a fresh battery",
        )
    for effect in report.effects:
        for other in effect.alternatives[:1]:
            advise(
                f"{title_of(effect.name)} could also be {title_of(other.name)}",
                "These recordings do not tell the two apart",
                f"Fly {other.manoeuvre}",
            )
    return found


PLAN = (
    (r"must be recorded|recorded$|positions known", "record attitude, and position where you can"),
    (r"yaw|turn", "yaw steps both ways, then a steady turn at 3 rad/s with doublets in it"),
    (r"thrust|bench", "thrust steps over 60 to 140 % of hover, with a full and an empty battery"),
    (r"doublet", "sharp roll and pitch doublets on the spot, small ones and of 3 rad/s and more"),
    (r"to and fro|translat", "fly to and fro along both axes at 1 to 2 m/s, stopping in between"),
    (r"climb|descen", "climb and descend at several steady speeds, well above the ground"),
    (r"rest|take.off|ground|low hover", "begin and end at rest, take off, land, hover near ground"),
)
"""Parts of a flight, and by what words a manoeuvre that an effect asks for belongs to one."""


def flight_plan(not_shown: Sequence[NotShown]) -> list[tuple[str, list[str]]]:
    """One flight for all that recordings cannot show: (what to fly, the effects that it shows),
    what shows most first. A manoeuvre that is like no other is a part of its own."""
    parts: dict[str, list[str]] = {}
    for one in not_shown:
        for wanted in one.manoeuvre.split("; "):
            part = next((fly for words, fly in PLAN if re.search(words, wanted)), wanted)
            names = parts.setdefault(part, [])
            if one.name not in names:
                names.append(one.name)
    parts.pop("nothing special", None)
    return sorted(parts.items(), key=lambda step: -len(step[1]))


def _still_off(report: DiscrepancyReport) -> list[str]:
    """The two channels that the improved model predicts worst, where noise does not explain it."""
    after = {label(name): one.after or 0.0 for name, one in report.gap.channels.items()}
    far = [name for name, gap in after.items() if gap > FAR]
    return sorted(far, key=lambda name: -after[name])[:2]


def _in_regime(channel: str, regime: str) -> str:
    return f"{label(channel)} ({regime})"


# The reports as lines for a terminal.


def compared_in_lines(report: CompareReport) -> Iterator[str]:
    """What the model is good for, the gap of each channel, and where it is wrong."""
    yield from _good_for(report)
    yield from _gap_in_lines(report.gap)
    yield from _places_in_lines(report.where)


def found_in_short(report: DiscrepancyReport) -> list[str]:
    """The verdict, the constants that changed and the effects: a line each."""
    count = len(report.effects)
    verdict = report.verdict.replace("_", " ")
    if report.verdict in FOUND:
        verdict = f"{count} effect{'s' if count != 1 else ''} found"
    if report.verdict == "found_in_part":
        verdict += f", and errors are still {report.gap.validation.after:.2f} times noise"
    effects = enumerate(by_weight(report.effects), 1)
    return [
        verdict,
        *(f"changed: {change.words}" for change in report.base_changes),
        *(f"{number}. {effect.name}: {meaning(effect)}" for number, effect in effects),
    ]


def found_in_lines(report: DiscrepancyReport, written: bool) -> Iterator[str]:
    """The outcome of a search. written: whether the improved model is in a file."""
    verdict, *found = found_in_short(report)
    changed, effects = found[: len(report.base_changes)], found[len(report.base_changes) :]
    yield verdict
    yield found_in_words(report)
    yield f"next: {next_in_words(report, written)}"
    yield from _good_for(report)
    if report.explained is not None:
        yield report.explained.words(report.disturbance)
    yield from changed
    for line, effect in zip(effects, by_weight(report.effects), strict=True):
        yield line
        yield from _numbers_in_lines(effect)
    yield from possible_in_words(report)
    for small in report.candidates:
        if small.refused_by == "negligible":
            yield f"{small.name}: {small.reason}"
    left = report.residual_detail
    if report.residual == "structured":
        yield f"left over: structure in {left.channel}{_what_is_there(left, 'like')}"
    for one in report.left:
        yield f"left in {one.words}"
    yield from _gap_in_lines(report.gap)
    yield from _places_in_lines(report.where)
    if report.not_shown:
        yield "these recordings cannot show the rest; one flight with these parts would:"
        for number, (fly, names) in enumerate(flight_plan(report.not_shown), 1):
            yield f"  {number}. {fly}: {', '.join(names)}"
    for reason in dict.fromkeys(report.lost.values()):
        lost = ", ".join(name for name, why in report.lost.items() if why == reason)
        yield f"not looked for ({why_lost(reason)}): {lost}"
    for line in report.warnings:
        yield f"warning: {line}"


def _numbers_in_lines(effect: EffectFound) -> Iterator[str]:
    for name, estimate in effect.parameters.items():
        spread = "" if estimate.stderr is None else f" +- {estimate.stderr:.2g}"
        zero = ", not distinguishable from zero" if is_zero(estimate) else ""
        yield f"     {name} {estimate.value:.4g}{spread} {estimate.unit}".rstrip() + zero
    again = "" if effect.recurrence is None else f", {chosen_in_words(effect.recurrence)}"
    yield f"     gap {effect.gap.before:.3f} -> {effect.gap.after:.3f}{again}"
    for other in effect.alternatives:
        yield f"     could also be {other.name}; to tell: {other.manoeuvre}"


def _good_for(report: CompareReport | DiscrepancyReport) -> Iterator[str]:
    """What the model is good for, where a fit of it is known."""
    if report.good_for:
        yield f"the model: {report.good_for[:1].lower()}{report.good_for[1:]}"


def _what_is_there(left: Leftover, like: str) -> str:
    hertz = ", ".join(f"{f:.3g}" for f in left.frequencies_hz)
    return (f" at {hertz} Hz" if hertz else "") + (f", {like} {left.signal}" if left.signal else "")


def _gap_in_lines(gap: Gap) -> Iterator[str]:
    level = gap.validation
    after = "" if level.after is None else f", after {level.after:.2f}"
    yield f"gap over all channels: {level.before:.2f}{after} (1.00: noise alone)"
    head = "before" if level.after is not None else "gap"
    yield f"  {'channel':<16}{head:>8}{'' if level.after is None else '   after'}   error"
    for name, channel in gap.channels.items():
        own = channel.own_unit
        later = "" if channel.after is None else f"{channel.after:8.2f}"
        error = own.before if own.after is None else own.after
        yield (
            f"  {name:<16}{channel.before:8.2f}{later}   {error:.3g} {own.unit},"
            f" noise {own.noise_floor:.3g}"
        )


def _places_in_lines(rows: Sequence[Place]) -> Iterator[str]:
    """The places that are clearly worse than noise."""
    clear = [row for row in rows if row.significance >= CLEAR][:PLACES]
    yield "worst, most significant first:" if clear else "nowhere clearly worse than noise"
    for row in clear:
        where = f"  {row.channel:<16}{row.regime:<28}{row.rms:9.3g} {row.unit}"
        yield f"{where}, noise {row.expected_rms:.3g}"


# Figures of the comparison and discrepancy reports.


LARGEST_RATIO = 10.0
"""Where the colours of a map end: what is beyond is wrong at a look anyway."""
WORTH_A_NUMBER = 1.1
MOST_BARS = 23


def where_map(titled: Sequence[tuple[str, Sequence[Place]]]) -> Figure:
    """Channel by regime: prediction error over noise. One map, or before and after."""
    ordered = (sorted(places, key=lambda place: place.regime != WHOLE) for _, places in titled)
    regimes = list(dict.fromkeys(place.regime for places in ordered for place in places))
    made, axes = figure(9.6, 3.9 * len(titled) + 0.9, rows=len(titled), sharex=True)
    for axis, (title, places) in zip(axes, titled, strict=True):
        ratio = np.full((len(CHANNELS), len(regimes)), np.nan)
        for place in places:
            if place.expected_rms > 0 and place.regime in regimes:
                row, column = CHANNELS.index(place.channel), regimes.index(place.regime)
                ratio[row, column] = place.rms / place.expected_rms
        _heat(made, axis, ratio)
        for row, column in np.argwhere(np.isfinite(ratio)):
            value = ratio[row, column]
            if column > 0 and value < WORTH_A_NUMBER:
                continue
            dark = value < np.sqrt(LARGEST_RATIO)
            axis.text(
                column,
                row,
                f"{value:.2f}" if value < 9.995 else f"{value:.0f}",
                ha="center",
                va="center",
                fontsize=7.5,
                color=ON_DARK if dark else ON_BRIGHT,
            )
        axis.set_yticks(range(len(CHANNELS)), [label(c) for c in CHANNELS])
        axis.set_title(title)
    axes[-1].set_xticks(range(len(regimes)), regimes, rotation=35, ha="right")
    return made


def time_map(comparison: Comparison, number: int = 0) -> Figure:
    """Channel by second of one run: prediction error over noise."""
    errors, floor = comparison.errors[number], comparison.floors[number]
    time, ratio = over_time(errors, floor)
    made, (axis,) = figure(9.6, 2.9)
    time = time - errors.run.recording_start_s
    edges = (time[0] - 0.5, time[-1] + 0.5, len(CHANNELS) - 0.5, -0.5)
    _heat(made, axis, ratio.T, extent=edges)
    axis.set_yticks(range(len(CHANNELS)), [label(c) for c in CHANNELS])
    axis.set_xlabel(f"time in {errors.run.name}, s")
    return made


def by_horizon(before: Comparison, after: Comparison | None = None) -> Figure:
    """Each channel's error over noise at 20 and at 50 ms, before and after."""
    shown = [k for k in range(9) if np.isfinite(before.noise_floor[k])]
    made, axes = figure(9.6, 2.9, columns=2, sharey=True)
    for number, (axis, horizon) in enumerate(zip(axes, HORIZONS_S, strict=True)):
        floor = before.at_horizon(number)[1]
        first = (before.at_horizon(number)[0] / floor)[shown]
        place = np.arange(len(shown))
        if after is None:
            axis.hlines(place, 1.0, first, color=NEUTRAL, linewidth=1.0, zorder=0.5)
        else:
            second = (after.at_horizon(number)[0] / floor)[shown]
            axis.hlines(place, second, first, color=NEUTRAL, linewidth=1.0, zorder=0.5)
            axis.plot(second, place, "o", color=IMPROVED, label="improved model")
        axis.plot(first, place, "o", color=MODELLED, label="model", zorder=1.9)
        axis.axvline(1.0, color=MEASURED, linewidth=1.0, linestyle="--", label="noise")
        axis.set_xscale("log")
        _plain_ticks(axis.xaxis, max(2.0, float(np.nanmax(first))))
        axis.set_yticks(place, [label(CHANNELS[k]) for k in shown])
        axis.set_title(f"{horizon * 1e3:.0f} ms ahead")
        axis.set_xlabel("error over noise")
    axes[0].invert_yaxis()
    made.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False
    )
    return made


def worst_overlay(stretch: Stretch, before: Comparison, after: Comparison | None = None) -> Figure:
    """Measured, and predicted 50 ms ahead, where one channel is predicted worst."""
    channel = CHANNELS.index(stretch.channel)
    unit = PER_SI[channel]
    rows = slice(stretch.first, stretch.last)
    errors = before.errors[stretch.run]
    run = errors.run
    time = run.time_s[rows] - run.recording_start_s
    measured = np.hstack([run.gyro, run.accelerometer, run.attitude])[rows, channel] * unit
    made, axes = figure(9.6, 4.4, rows=2, sharex=True, height_ratios=[3, 2])
    axes[0].plot(time, measured, color=MEASURED, label="measured")
    shown = [("model", MODELLED, before)]
    if after is not None:
        shown.append(("improved model", IMPROVED, after))
    for name, color, one in shown:
        error = one.errors[stretch.run].horizons[-1][rows, channel] * unit
        known = np.isfinite(error)
        part = (time[known], (measured - error)[known])
        dots = {"linestyle": "", "marker": ".", "markersize": 1.6}
        style: dict[str, Any] = dots if channel in (3, 4, 5) else {"linewidth": 1.0}
        axes[0].plot(*part, color=color, label=f"{name}, 50 ms ahead", **style)
        axes[1].plot(time[known], error[known], color=color, linewidth=1.0)
    noise = before.at_horizon(len(HORIZONS_S) - 1)[1][channel] * unit
    axes[1].axhspan(-2 * noise, 2 * noise, color=NEUTRAL, alpha=0.2, linewidth=0)
    axes[0].set_ylabel(f"{label(stretch.channel)}, {UNITS[stretch.channel]}")
    axes[0].set_title(f"{label(stretch.channel)} in {run.name}", loc="left")
    legend_above(axes[0])
    axes[1].set_ylabel(f"error, {UNITS[stretch.channel]}")
    axes[1].set_xlabel("time, s")
    return made


def residual_spectrum(before: Spectrum, after: Spectrum | None = None) -> Figure:
    """Power density of one-row-ahead errors, before, after, and what noise leaves."""
    made, (axis,) = figure(9.6, 3.2)
    lines = [("model", MODELLED, before.error)]
    if after is not None:
        lines.append(("improved model", IMPROVED, after.error))
    lines.append(("noise", MEASURED, before.expected))
    for name, color, power in lines:
        style: dict[str, Any] = {"linestyle": "--"} if name == "noise" else {}
        axis.loglog(before.frequency_hz[1:-1], power[1:-1], color=color, label=name, **style)
    axis.set_xlabel("frequency, Hz")
    axis.set_ylabel(f"({UNITS[before.channel]})²/Hz")
    axis.set_title(f"{label(before.channel)}: errors one row ahead", loc="left")
    legend_above(axis)
    return made


def evidence_bars(candidates: Sequence[Candidate]) -> Figure:
    """How strongly the recordings speak for each effect before any was added."""
    shown = sorted(candidates, key=lambda c: c.score, reverse=True)[:MOST_BARS]
    made, (axis,) = figure(9.6, 0.9 + 0.24 * max(len(shown), 3))
    place = np.arange(len(shown))
    score = np.array([max(c.score, 0.1) for c in shown])
    colors = [GOOD if c.accepted else NEUTRAL for c in shown]
    axis.barh(place, score, color=colors, height=0.7, left=0.1)
    axis.set_xscale("log")
    axis.set_yticks(place, [titled(c.name) for c in shown])
    notes = [shorten(one.reason or "accepted", NOTE_MOST, placeholder=" …") for one in shown]
    for y, one, size, note in zip(place, shown, score, notes, strict=True):
        axis.annotate(
            note,
            (size + 0.1, float(y)),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize=7.5,
            color=INK if one.accepted else NOTE,
            weight="bold" if one.accepted else "normal",
        )
    # As many decades as leave room for every note.
    room = [0.98 - NOTE_CHARACTER * len(note) for note in notes]
    decades = np.log10(score / 0.1 + 1.0) / np.maximum(room, 0.2)
    axis.set_xlim(0.1, 0.1 * 10 ** max(3.0, float(decades.max(initial=3.0))))
    axis.invert_yaxis()
    axis.grid(visible=False, axis="y")
    axis.set_xlabel("evidence by itself: drop of -2 log likelihood")
    return made


def waterfall(steps: Sequence[tuple[str, float]]) -> Figure:
    """The gap on proof samples, from the given model to the improved one, effect by effect."""
    made, (axis,) = figure(9.6, 1.1 + 0.36 * (len(steps) + 1))
    values = np.array([gap for _, gap in steps])
    place = np.arange(len(steps))
    axis.barh(0, values[0], color=MODELLED, height=0.6)
    for k in range(1, len(steps)):
        low, high = sorted((values[k - 1], values[k]))
        color = GOOD if values[k] <= values[k - 1] else MODELLED
        axis.barh(k, high - low, left=low, color=color, height=0.6)
        axis.vlines(values[k - 1], k - 1.3, k + 0.3, color=NEUTRAL, linewidth=0.8)
    last = len(steps)
    axis.barh(last, values[-1], color=IMPROVED, height=0.6)
    for k, value in enumerate([*values, values[-1]]):
        step = 0 < k < last
        words = f"{values[k - 1]:.2f} → {value:.2f}" if step else f"{value:.2f}"
        axis.annotate(
            words,
            (max(value, values[k - 1]) if step else value, k),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontsize=9,
            bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 1.0},
        )
    names = [titled(name) for name, _ in steps]
    axis.set_yticks([*place, last], [names[0], *(f"+ {n}" for n in names[1:]), "improved model"])
    axis.axvline(1.0, color=MEASURED, linestyle="--", linewidth=1.0)
    axis.annotate("noise", (1.0, -0.6), xytext=(3, 0), textcoords="offset points", fontsize=8.5)
    axis.set_xlim(0.0, float(values.max()) * 1.2)
    axis.set_ylim(last + 0.6, -0.9)
    axis.grid(visible=False, axis="y")
    axis.set_xlabel("gap over all channels, proof samples (1: nothing left to explain)")
    return made


NOTE_MOST = 70
"""Characters of a note beside a bar; the table has all of it."""
NOTE_CHARACTER = 0.0068
"""Width of a character of a note beside a bar, as a share of the axes."""
TICKS = (1.0, 1.5, 2.0, 3.0, 5.0, 10.0)


def _heat(made: Figure, axis: Any, ratio: Array, **more: Any) -> None:
    """A map of error over noise with its colour bar."""
    from matplotlib.colors import LogNorm

    image = axis.imshow(
        np.clip(ratio, 1.0, None),
        aspect="auto",
        cmap=HEAT,
        norm=LogNorm(1.0, LARGEST_RATIO),
        interpolation="nearest",
        **more,
    )
    axis.grid(visible=False)
    axis.set_facecolor(MISSING)
    made.colorbar(image, ax=axis, pad=0.01, label="error over noise", ticks=TICKS, format="%g")


def _plain_ticks(axis: Any, most: float) -> None:
    """Round numbers on a logarithmic axis, written out."""
    from matplotlib.ticker import FixedLocator, FormatStrFormatter, NullLocator

    ticks = [1.0, 1.1, 1.2, 1.4] if most < 1.7 else [1.0, 1.5] if most < 8 else [1.0]
    ticks += [base * 10.0**power for power in range(4) for base in (2, 5, 10)]
    axis.set_major_locator(FixedLocator([tick for tick in ticks if tick <= 1.5 * most]))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FormatStrFormatter("%g"))


# The comparison and discrepancy reports as pages.


SPECTRA = 3
MAP_TEXT = (
    "Prediction errors 20 and 50 ms ahead over what noise alone leaves of them in the same rows;"
    " 1 is noise; numbers from 1.1 on, and for the whole flight. Regimes overlap; a grey cell did"
    " not occur or lacks its channel."
)
FLOOR_TEXT = (
    "An unstable craft cannot be simulated freely over a flight: at every row the model starts"
    " from what was measured and is judged 20 and 50 ms later. The noise floor is what a black"
    " box leaves on the same rows that knows no physics of the craft: the one-step errors are"
    " regressed on every generic signal that clearly shows in them (rotor speeds and their past,"
    " rates and products, velocity, tilt, closeness to the ground), what is left adds up to the"
    " horizon, and what fading memories of the past foretell of it is taken off. It is the same"
    " before and after."
)


def compare_page(found: Comparison, report: CompareReport) -> Page:
    """Where a model and recordings disagree."""
    page = Page(f"{report.model} against {', '.join(report.recordings)}", "Comparison report")
    worst = _worst(report.where)
    page.verdict(compared_in_words(report, worst), "good" if worst is None else "bad")
    page.next_step(compared_next(report, worst))
    for line in _good_for(report):
        page.text(f"What {line.replace(':', ' is good for:', 1)}.")
    page.advice([], list(found.warnings.values()))
    _channels(page, report.gap)
    page.heading("Where")
    page.figure(where_map([("error over noise", found.places)]), MAP_TEXT)
    for number in range(len(found.errors)):
        page.figure(time_map(found, number), "The same second by second.")
    page.heading("By horizon")
    page.figure(by_horizon(found), "The further ahead, the more a wrong torque adds up.")
    _further(page, report.gap)
    _closer(page, found, None, worst)
    page.heading("How it is measured")
    page.text(FLOOR_TEXT)
    return page


def discrepancy_page(proof: Proof, report: DiscrepancyReport) -> Page:
    """What the model was missing, and the proof."""
    page = Page(
        f"What {report.model} was missing", f"Discrepancy report on {', '.join(report.recordings)}"
    )
    _verdict(page, report)
    page.heading("What was found")
    if report.explained is not None:
        page.text(f"On proof samples, {report.explained.words(report.disturbance)}.")
    for change in report.base_changes:
        page.text(f"The given model's constants moved: {change.words}.")
    if report.effects:
        _named(page, report)
    else:
        page.text("No effect passed every test.")
    for line in possible_in_words(report):
        page.text(f"{line[:1].upper()}{line[1:]}.")
    page.heading("The gap closes")
    page.figure(
        waterfall(proof.steps),
        "Root mean square over the channels of error over noise, on samples that decided nothing.",
    )
    _channels(page, report.gap)
    page.figure(by_horizon(proof.before, proof.after), "Each channel, before and after.")
    _further(page, report.gap)
    if report.left:
        with page.more("What is left, channel by channel"):
            page.bullets(one.words for one in report.left)
    page.heading("Where")
    page.figure(
        where_map([("before", proof.before.places), ("after", proof.after.places)]), MAP_TEXT
    )
    _closer(page, proof.before, proof.after, _worst(report.where))
    page.heading("All candidates")
    page.figure(
        evidence_bars(report.candidates),
        "What each effect alone would explain, before any was added; effects that look alike"
        " share evidence, and only what passes every test is accepted.",
    )
    with page.more("The same as a table"):
        page.table(
            ["effect", "name", "score", "t", "other flights", "outcome"],
            [
                (
                    title_of(c.name),
                    c.name,
                    c.score,
                    c.t,
                    c.held_out or None,
                    "accepted" if c.accepted else c.reason,
                )
                for c in report.candidates
            ],
            "score: drop of -2 log likelihood; other flights: the same of flights that its size was"
            " not taken from, empty where it was refused before; t: largest parameter over its"
            " standard error.",
        )
    _limits(page, report)
    page.heading("How it is measured")
    page.text(FLOOR_TEXT)
    held = report.validation if isinstance(report.validation, str) else ", ".join(report.validation)
    page.text(f"Proof: {held}. Made by {report.created_by}.")
    return page


def _verdict(page: Page, report: DiscrepancyReport) -> None:
    """What was found, how sure that is, and what to do next."""
    level = report.gap.validation
    grew = level.after is not None and level.after > level.before
    clean = report.residual == "white" and not grew
    found = "good" if clean else "neutral"
    kind = {"effects_found": found, "found_in_part": "neutral", "unexplained": "bad"}
    page.verdict(found_in_words(report), kind.get(report.verdict, "good"))
    page.next_step(next_in_words(report))
    for line in _good_for(report):
        page.text(f"What {line.replace(':', ' is good for:', 1)}.")
    notes = list(report.warnings)
    if report.residual == "structured":
        left = report.residual_detail
        where = f"{label(left.channel)}{_what_is_there(left, 'most like')}"
        notes.append(f"What is left is not noise: structure in {where}")
    page.advice(advice_of(report), notes)


def _named(page: Page, report: DiscrepancyReport) -> None:
    rows: list[tuple[str, ...]] = []
    for effect in by_weight(report.effects):
        share, again = (
            "" if part is None else f"{100.0 * part:.0f} %"
            for part in (effect.weight, effect.recurrence)
        )
        head = title_of(effect.name), meaning(effect), share, again
        tail = f"{effect.gap.before:.3f} → {effect.gap.after:.3f}", effect.name
        for name, estimate in effect.parameters.items():
            spread = "" if estimate.stderr is None else f" ± {SURE * estimate.stderr:.2g}"
            zero = ", not distinguishable from zero" if is_zero(estimate) else ""
            size = f"{name} = {estimate.value:.4g}{spread} {estimate.unit}".strip() + zero
            rows.append((*head, size, *tail))
            head, tail = ("",) * 4, ("",) * 2
    page.table(
        ["effect", "what it does", "explains", "recurs", "parameter, 95 % interval", "gap", "name"],
        rows,
        "What explains most stands first: its share of what all of them explain on samples that"
        " decided nothing. Recurs: share of resamples of time and flights that choose it again.",
    )
    for effect in report.effects:
        for other in effect.alternatives:
            how = f"margin {other.margin:.1f}"
            if other.share:
                how = f"in its place in {100.0 * other.share:.0f} % of resamples"
            page.text(
                f"{title_of(effect.name)} could also be {title_of(other.name)} ({how}); to tell"
                f" them apart fly {other.manoeuvre}."
            )


def _further(page: Page, gap: Gap) -> None:
    """Where an observer that follows what is slow helps little."""
    page.text(
        "Further ahead, where physics shows: "
        + ", ".join(
            f"{far.removesuffix('ms')} ms {one.before:.2f}"
            + ("" if one.after is None else f" → {one.after:.2f}")
            for far, one in gap.further.items()
        )
        + " times noise over all channels."
    )


def _channels(page: Page, gap: Gap) -> None:
    after = gap.validation.after is not None
    rows: list[tuple[str | float | None, ...]] = []
    for name, channel in gap.channels.items():
        own = channel.own_unit
        ratios = [channel.before, channel.after] if after else [channel.before]
        errors = [own.before, own.after] if after else [own.before]
        rows.append((label(name), *ratios, *errors, own.noise_floor, own.unit))
    ratio = ["gap before", "gap after"] if after else ["gap"]
    error = ["error before", "error after"] if after else ["error"]
    page.table(
        ["channel", *ratio, *error, "noise floor", "unit"],
        rows,
        "Root mean square of errors 20 and 50 ms ahead; the gap is error over noise floor. Below 1"
        " a model knows more than the black box that the floor comes from.",
    )


def _closer(page: Page, before: Comparison, after: Comparison | None, worst: Place | None) -> None:
    """The worst channel over time and frequency."""
    if worst is None:
        return
    page.heading("A closer look")
    stretch = worst_stretch(before.errors, before.floors, worst.channel)
    if stretch is not None:
        page.figure(
            worst_overlay(stretch, before, after),
            "The stretch in which the model is wrong most; grey: 95 % of noise.",
        )
    clear = (place.channel for place in before.places if place.significance >= CLEAR)
    for channel in [*dict.fromkeys(clear)][:SPECTRA]:
        first = spectrum_of(before.errors, before.floors, channel)
        second = None if after is None else spectrum_of(after.errors, before.floors, channel)
        if first is not None:
            page.figure(
                residual_spectrum(first, second),
                "Errors one row ahead by frequency: what stands above noise is not explained"
                " (vibration is not meant to be).",
            )


def _limits(page: Page, report: DiscrepancyReport) -> None:
    if not report.not_shown and not report.lost:
        return
    page.heading("What these recordings cannot show")
    if report.not_shown:
        page.text("One flight with these parts would show the rest:")
        page.table(
            ["part", "fly", "shows"],
            [
                (str(number), fly, ", ".join(title_of(name) for name in names))
                for number, (fly, names) in enumerate(flight_plan(report.not_shown), 1)
            ],
        )
        with page.more("How badly each would be known from these recordings"):
            page.table(
                ["effect", "parameter", "standard error here", "usual size", "unit"],
                [
                    (title_of(n.name), n.parameter, n.stderr, n.plausible, n.unit)
                    for n in report.not_shown
                ],
            )
    page.bullets(
        f"{title_of(name)}: not looked for, {why_lost(why)}" for name, why in report.lost.items()
    )


def _worst(rows: list[Place]) -> Place | None:
    return rows[0] if rows and rows[0].significance >= CLEAR else None


# Comparisons and searches as the Python API shows them.


def comparison(one: Comparison) -> Shown:
    """Where the model errs, channel by regime; each figure of the report."""
    places = one.places
    names = ("channel", "regime", "rms", "expected_rms", "unit", "significance", "seconds")
    columns = {name: [getattr(place, name) for place in places] for name in names}
    pictures = {
        "where": partial(where_map, [("error over noise", places)]),
        "time": partial(time_map, one),
        "horizons": partial(by_horizon, one),
        **_worst_picture(one, None),
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
        does, share = meaning(effect), np.nan if effect.weight is None else effect.weight
        for name, each in effect.parameters.items():
            row = (effect.name, title_of(effect.name), does, name, each.value, each.stderr)
            for column, cell in zip(columns.values(), (*row, each.unit, share), strict=True):
                column.append(cell)
    maps = [("before", proof.before.places), ("after", proof.after.places)]
    pictures = {
        "gap": partial(waterfall, proof.steps),
        "where": partial(where_map, maps),
        "horizons": partial(by_horizon, proof.before, proof.after),
        **_worst_picture(proof.before, proof.after),
    }
    return Shown(repr(one), columns, one.warnings, pictures)


def _worst_picture(before: Comparison, after: Comparison | None) -> dict[str, partial[Figure]]:
    """The channel that is worst, where it is worst."""
    if not before.places:
        return {}
    stretch = worst_stretch(before.errors, before.floors, before.places[0].channel)
    if stretch is None:
        return {}
    return {"worst": partial(worst_overlay, stretch, before, after)}
