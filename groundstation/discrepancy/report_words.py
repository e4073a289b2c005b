"""What a discrepancy report begins with, in plain words: what was found, how sure it is, what to do
next, and one flight that would show the rest."""

from __future__ import annotations

import re
from collections.abc import Sequence

from groundstation.comparison.comparison import Place
from groundstation.discrepancy.findings import FoundEffect, NotShown
from groundstation.discrepancy.proof import LEFT
from groundstation.discrepancy.report_json import CompareReport, DiscrepancyReport, EffectFound
from groundstation.dynamics.meanings import physics_of, title_of
from groundstation.dynamics.model import Estimate
from groundstation.report.page import Advice
from groundstation.text import listed

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


def by_weight(effects: Sequence[EffectFound]) -> list[EffectFound]:
    """What explains most first; those of which that is not known last, as they were added."""
    return sorted(effects, key=lambda one: -(one.weight if one.weight is not None else -1.0))


def is_zero(estimate: Estimate) -> bool:
    """Whether a parameter cannot be told from zero."""
    return estimate.stderr is not None and abs(estimate.value) < SURE * estimate.stderr


def meaning(effect: EffectFound | FoundEffect) -> str:
    """What it does to the craft, with the size that was found."""
    values = {name: one.value for name, one in effect.parameters.items()}
    return physics_of(effect.name, values) or effect.adds


def chosen_in_words(share: float) -> str:
    """How often resamples choose a name."""
    return f"chosen in {100.0 * share:.0f} % of resamples"


def possible_in_words(report: DiscrepancyReport) -> list[str]:
    """Effects that are fitted along and not named, a line each."""
    lines = []
    for one in report.possible:
        others = [
            f"{title_of(other.name)} in {100.0 * other.share:.0f} %"
            for other in one.alternatives
            if other.share
        ]
        instead = f", in its place {listed(others)}" if others else ""
        why = DOUBTS.get(one.reason, chosen_in_words(one.recurrence))
        lines.append(
            f"possible: {title_of(one.name)}, {why}{instead}; fitted along, its part is counted"
            " with the changed constants"
        )
    return lines


def found_in_words(report: DiscrepancyReport) -> str:
    """What was found and how sure that is: the first line."""
    level = report.gap.validation
    gap = f"prediction errors are {level.before:.1f} times noise"
    if report.verdict == "effects_found":
        effects = by_weight(report.effects)
        names = [f"{title_of(one.name)} ({meaning(one)})" for one in effects[:2]]
        rest = [title_of(one.name) for one in effects[2:]]
        first = f"Missing in the model: {listed([*names, *rest])}."
        return f"{first} {_how_sure(report)}"
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
    return f"Nothing is missing that these recordings could show: {gap}."


def _how_sure(report: DiscrepancyReport) -> str:
    level, what = report.gap.validation, report.explained
    held = (
        "on recordings that no fit has seen"
        if isinstance(report.validation, list)
        else "on the parts of these recordings that no fit has seen"
    )
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
    return f"Checked {held}: {change}{share}."


def next_in_words(report: DiscrepancyReport, written: bool = False) -> str:
    """What to do now: the second line. written: whether the improved model is in a file."""
    level = report.gap.validation
    plan = flight_plan(report.not_shown)
    fly = f"fly the plan below ({plan[0][0]})" if plan else "fly another flight of another kind"
    better = level.after is not None and level.after < level.before
    if report.verdict == "unexplained":
        worst = report.where[0] if report.where else None
        place = f", where {_place(worst.channel, worst.regime)} is worst" if worst else ""
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
        f" clearly so in {_place(worst.channel, worst.regime)}: {ratio:.1f} times noise."
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
    if report.gap.worse:
        names = listed([one.replace("_", " ") for one in report.gap.worse])
        found.append(
            Advice(
                f"The improved model predicts {names} worse than the given one",
                "What was found may stand for something else there",
                "Search with one more recording of another kind",
            )
        )
    large = what is not None and what.left > LARGE_LEFT and level.after is not None
    if large and what is not None and level.after is not None and level.after > LEFT:
        most = report.left[0] if report.left else None
        where = f", most of it in {most.channel.replace('_', ' ')}" if most else ""
        found.append(
            Advice(
                f"{100.0 * what.left:.0f} % of what was wrong is still unexplained{where}",
                "Simulations err by as much beyond noise",
                fly,
            )
        )
    if what is not None and what.disturbance > LARGE_LEFT:
        found.append(
            Advice(
                f"{100.0 * what.disturbance:.0f} % of what was wrong are slow forces and moments"
                " without a name",
                "They are followed, not predicted: a simulation does not have them",
                "Fly in still air, away from walls, with a fresh battery",
            )
        )
    for effect in report.effects:
        if effect.alternatives:
            other = effect.alternatives[0]
            found.append(
                Advice(
                    f"{title_of(effect.name)} could also be {title_of(other.name)}",
                    "These recordings do not tell the two apart",
                    f"Fly {other.manoeuvre}",
                )
            )
    return [_capital(one) for one in found]


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
    seen: dict[str, list[str]] = {part: n for part, n in parts.items() if part != "nothing special"}
    return sorted(seen.items(), key=lambda step: -len(step[1]))


def _still_off(report: DiscrepancyReport) -> list[str]:
    """The two channels that the improved model predicts worst, where noise does not explain it."""
    after = {
        name.replace("_", " "): channel.after
        for name, channel in report.gap.channels.items()
        if channel.after is not None and channel.after > FAR
    }
    return sorted(after, key=lambda name: -after[name])[:2]


def _capital(one: Advice) -> Advice:
    return one._replace(what=one.what[:1].upper() + one.what[1:])


def _place(channel: str, regime: str) -> str:
    return f"{channel.replace('_', ' ')} ({regime})"
