"""What came of it: gains before and after, what was hidden, and the craft on a page."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from groundstation.control.step_analysis import Flown as Steps
from groundstation.discrepancy.report import evidence_bars, meaning, waterfall
from groundstation.discrepancy.report_json import DiscrepancyReport, EffectFound
from groundstation.documents import decode_toml, read_document
from groundstation.dynamics.meanings import meaning_of, title_of
from groundstation.dynamics.model import Model, load_model
from groundstation.errors import BadInputError
from groundstation.learn.planning import JOURNAL, Journal
from groundstation.learn.story import (
    BODY_MODEL,
    GAINS,
    flown_steps,
    mean_missed,
    named_effects,
    open_names,
    open_words,
    read_found,
    said_effect,
)
from groundstation.report.page import FAINT, IMPROVED, MEASURED, MODELLED, Page, figure
from groundstation.shell import LOG, SCRIPT
from groundstation.telemetry.packet import SAMPLE_PERIOD_S
from groundstation.text import listed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# What came of it; where effects were hidden, the seal is opened and every name held against it.


WITHIN = 1.96
"""Standard errors that hold 95 % of estimates."""


@dataclass(frozen=True, slots=True)
class Size:
    """One number of a hidden effect beside what was found of it (None: not named)."""

    effect: str
    parameter: str
    true: float
    value: float | None
    stderr: float | None

    @property
    def inside(self) -> bool:
        """Within the stated 95 %."""
        if self.value is None or self.stderr is None:
            return False
        return abs(self.value - self.true) <= WITHIN * self.stderr


@dataclass(frozen=True, slots=True)
class Outcome:
    """hidden: sizes of what a seed hid; None where nothing was. steps: before and after."""

    journal: Journal
    folder: Path
    model: Model
    found: DiscrepancyReport | None
    found_name: str
    steps: tuple[Steps, Steps] | None
    hidden: tuple[Size, ...] | None

    @property
    def effects(self) -> list[EffectFound]:
        return [] if self.found is None else named_effects(self.found)

    @property
    def named(self) -> set[str]:
        return {one.name for one in self.effects}

    @property
    def wrong(self) -> list[str]:
        """What did not come out, where it can be judged: empty, or each in words."""
        faults = []
        if self.names_right is False:
            faults.append("names")
        if self.steps is not None and self.journal.gains.startswith("written"):
            before, after = map(mean_missed, self.steps)
            faults += ["steps"] if after >= before else []
        return faults

    @property
    def names_right(self) -> bool | None:
        """Every hidden effect and nothing else; None where nothing is known of it."""
        if self.hidden is None:
            return None
        return {size.effect for size in self.hidden} == self.named

    def lines(self) -> list[str]:
        """For a terminal, after the last flight."""
        if self.hidden is None:
            return []
        lines = ["the seal is opened:"]
        for one in self.hidden:
            found = "not named" if one.value is None else f"found {one.value:.4g}"
            spread = "" if one.stderr is None else f" ± {one.stderr:.2g}"
            mark = "yes" if one.inside else "NO "
            lines.append(f"  {mark} {one.effect} {one.parameter} {one.true:.4g}: {found}{spread}")
        lines += [
            f"  NO  {name}: named, and not there"
            for name in sorted(self.named - {one.effect for one in self.hidden})
        ]
        return lines

    def as_dict(self) -> dict[str, Any]:
        """For ``learn --json``."""
        gap = None if self.found is None else self.found.gap.validation
        return {
            "craft": self.journal.task.vehicle,
            "named": sorted(self.named),
            "effects": {one.name: msgspec.to_builtins(one.parameters) for one in self.effects},
            "open": {} if self.found is None else open_names(self.found),
            "gap": None if gap is None else {"before": gap.before, "after": gap.after},
            "gains": self.journal.gains,
            "step_rms": None
            if self.steps is None
            else dict(zip(("before", "after"), map(mean_missed, self.steps), strict=True)),
            "hidden": None
            if self.hidden is None
            else [{**asdict(one), "inside": one.inside} for one in self.hidden],
            "names_right": self.names_right,
            "flights": len(self.journal.flights),
            "air_s": sum(one.seconds for one in self.journal.flights),
            "batteries": self.journal.batteries,
            "seconds": round(self.journal.seconds, 1),
        }


def outcome_of(journal: Journal, folder: Path) -> Outcome:
    """From the files of a folder in which everything was flown."""
    last = max(folder.glob("found?.json"), default=None)
    found = None if last is None else read_found(last)
    model = BODY_MODEL if last is None else f"{last.stem}.model.json"
    loaded = load_model(str(folder / model))
    doublets = [one for one in journal.flights if one.file.startswith("steps_") and not one.aborted]
    steps = None
    if len(doublets) > 1:
        before, after = (flown_steps(folder, doublets[n], loaded) for n in (0, -1))
        steps = before, after
    hidden = None if journal.task.hide is None else _hidden(folder, found)
    return Outcome(journal, folder, loaded, found, "" if last is None else last.stem, steps, hidden)


def _hidden(folder: Path, found: DiscrepancyReport | None) -> tuple[Size, ...]:
    path = folder / "sealed.toml"
    try:
        effects = decode_toml(read_document(path), dict)["stand_in"]["effects"]
        true_sizes = [
            (effect, name, float(true))
            for effect, parameters in effects.items()
            for name, true in parameters.items()
            if name != "rotor"
        ]
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise BadInputError(f"{path}: does not say what was hidden ({error})") from error
    named = {} if found is None else {one.name: one.parameters for one in found.effects}
    sizes = []
    for effect, parameter, true in true_sizes:
        one = named.get(effect, {}).get(parameter)
        value, stderr = (None, None) if one is None else (one.value, one.stderr)
        sizes.append(Size(effect, parameter, true, value, stderr))
    return tuple(sizes)


def said_named(outcome: Outcome) -> str:
    """What was named, in words."""
    named = "; ".join(said_effect(one.name, one.parameters) for one in outcome.effects)
    return named or "nothing that the base model lacks"


# The craft on a page: what it is, how well it is predicted, its gains before and after, what is
# open, and everything behind it.


REPORT = "report.html"


def report_page(outcome: Outcome) -> Page:
    """From the outcome and the files of its folder."""
    task = outcome.journal.task
    page = Page(f"What was learnt of a {task.vehicle}", f"groundstation learn --link {task.link}")
    _summary(page, outcome)
    _craft(page, outcome)
    _predicted(page, outcome)
    _gains(page, outcome)
    _open(page, outcome)
    _behind(page, outcome)
    return page


def _summary(page: Page, outcome: Outcome) -> None:
    flights = outcome.journal.flights
    named = [f"{title_of(one.name)} ({meaning(one)})" for one in outcome.effects]
    words = f"Found: {listed(named) if named else said_named(outcome)}."
    if outcome.found is not None:
        gap = outcome.found.gap.validation
        after = gap.before if gap.after is None else gap.after
        words += (
            f" On a flight on which nothing was chosen, predictions miss by {after:.2f} times"
            f" what noise leaves, {gap.before:.2f} before."
        )
    words += f" Gains: {outcome.journal.gains}."
    good = outcome.names_right is not False and outcome.journal.gains.startswith("written")
    page.verdict(words, "good" if good else "neutral")
    page.next_step(
        ("fly with the new gains" if good else "keep the former gains; see what is still open")
        + ", or let 'groundstation plan' say what to fly for a better model."
    )
    page.text(
        f"{len(flights)} flights, {sum(one.seconds for one in flights):.0f} s on"
        f" {outcome.journal.batteries} of {outcome.journal.task.batteries} batteries, learnt in"
        f" {outcome.journal.seconds:.0f} s."
    )
    if outcome.hidden is not None:
        _truth(page, outcome)


def _truth(page: Page, outcome: Outcome) -> None:
    assert outcome.hidden is not None
    page.text(
        f"This software craft was given effects by seed {outcome.journal.task.hide}; the file was"
        " opened after everything had been said."
    )
    rows = [
        [
            one.effect,
            one.parameter,
            one.true,
            one.value,
            one.stderr,
            "not named" if one.value is None else "yes" if one.inside else "NO",
        ]
        for one in outcome.hidden
    ]
    too_many = sorted(outcome.named - {one.effect for one in outcome.hidden})
    rows += [[name, "", None, None, None, "not there"] for name in too_many]
    page.table(["hidden", "number", "true", "found", "standard error", "within 95 %"], rows)


def _craft(page: Page, outcome: Outcome) -> None:
    page.heading("What it is")
    account = outcome.model.fit["body"]["estimates"]
    errors = dict(zip(account["names"], account["stderr"], strict=True))
    body = outcome.model.body
    assert body is not None
    rows = []
    for name in ("c0", "c1", "c2", "thrust_per_mass"):
        unit, words = meaning_of(name)
        value, error = getattr(body, name), errors.get(name)
        percent = None if error is None else 100 * error / abs(value)
        rows.append([name, words, value, unit, percent])
    page.table(
        ["constant", "meaning", "value", "unit", "standard error of the fit, %"],
        rows,
        "Values as the search left them; the error is that of the body's fit.",
    )
    if outcome.found is None or not outcome.effects:
        page.text("No effect beyond the base model was found.")
        return
    page.table(
        ["effect", "what it does", "number", "value", "standard error", "unit", "its share, %"],
        [
            [
                title_of(one.name),
                meaning(one),
                key,
                number.value,
                number.stderr,
                number.unit,
                None if one.weight is None else 100 * one.weight,
            ]
            for one in outcome.effects
            for key, number in one.parameters.items()
        ],
        "Share: of what all effects together explain on the proof flight.",
    )
    page.figure(
        evidence_bars(outcome.found.candidates),
        "What each effect alone would explain, before any was added.",
    )


def _predicted(page: Page, outcome: Outcome) -> None:
    page.heading("How well it is predicted")
    if outcome.found is None:
        page.text("Nothing was searched.")
        return
    steps = [("body alone", outcome.found.gap.validation.before)]
    steps += [(one.name, one.gap.after) for one in outcome.found.effects]
    page.figure(
        waterfall(steps),
        "Error of predictions 20 and 50 ms ahead on the proof flight, over what noise leaves.",
    )
    page.table(
        ["channel", "unit", "error before", "after", "noise alone"],
        [
            [
                name.replace("_", " "),
                one.own_unit.unit,
                one.own_unit.before,
                one.own_unit.after,
                one.own_unit.noise_floor,
            ]
            for name, one in outcome.found.gap.channels.items()
        ],
    )


def _gains(page: Page, outcome: Outcome) -> None:
    page.heading("Gains before and after")
    page.verdict(
        f"{outcome.journal.gains[:1].upper()}{outcome.journal.gains[1:]}.",
        "good" if outcome.journal.gains.startswith("written") else "neutral",
    )
    if outcome.steps is None:
        return
    flown = [one for one in outcome.journal.flights if not one.aborted][-1].gains
    page.table(
        ["gain", "before", "designed"],
        [[name, old, flown[name]] for name, old in outcome.journal.former.items()],
    )
    before, after = outcome.steps
    page.figure(
        steps_figure(before, after),
        "Mean response to the same doublets, flown with the gains before and with the designed"
        " ones; dashed what the found model predicts.",
    )
    page.table(
        [
            "axis",
            "RMS before",
            "after",
            "predicted before",
            "predicted after",
            "overshoot before, %",
            "after, %",
            "settled before, s",
            "after, s",
        ],
        [
            [
                old.axis,
                *(_rms(one) for one in (old.measured, new.measured)),
                *(_rms(one) for one in (old.predicted, new.predicted)),
                old.measured.overshoot_pct,
                new.measured.overshoot_pct,
                old.measured.settling_s,
                new.measured.settling_s,
            ]
            for old, new in zip(before.axes, after.axes, strict=True)
            for _rms in [lambda one, step=old.step: None if one is None else one.rms / step]
        ],
        f"RMS: of the step's size. Mean of the axes: {mean_missed(before):.3f} before,"
        f" {mean_missed(after):.3f} after.",
    )


def steps_figure(before: Steps, after: Steps) -> Figure:
    """One panel an axis: both flights over each other, with what the model predicts of each."""
    made, panels = figure(rows=1, columns=len(after.axes), height=3.0, sharey=True)
    for panel, old, new in zip(panels, before.axes, after.axes, strict=True):
        panel.axhline(1.0, color=FAINT, linewidth=1.0)
        for one, color, name in ((old, MODELLED, "before"), (new, IMPROVED, "designed")):
            time = np.arange(len(one.response)) * SAMPLE_PERIOD_S
            panel.plot(time, one.response, color=color, label=name)
            if one.predicted_response is not None:
                panel.plot(time, one.predicted_response, "--", color=MEASURED, linewidth=0.8)
        panel.set_title(old.axis)
        panel.set_xlabel("s")
        panel.legend(loc="lower right")
    panels[0].set_ylabel("response / step")
    return made


def _open(page: Page, outcome: Outcome) -> None:
    page.heading("What is still open")
    found = outcome.found
    if found is None:
        return
    lines = [*open_words(found), *(one.words for one in found.left)]
    page.bullets(lines or ["no named effect has another name that explains as much"])
    if found.not_shown:
        page.table(
            [
                "not shown by these flights",
                "number",
                "standard error",
                "usual size",
                "unit",
                "to see it",
            ],
            [
                [one.name, one.parameter, one.stderr, one.plausible, one.unit, one.manoeuvre]
                for one in found.not_shown
            ],
        )


def _behind(page: Page, outcome: Outcome) -> None:
    page.heading("Everything behind it")
    page.table(
        ["flight", "for", "manoeuvres", "s", "battery", "cut short"],
        [
            [
                one.file,
                one.purpose,
                ", ".join(row["fly"] for row in one.timeline),
                one.seconds,
                one.battery,
                one.aborted,
            ]
            for one in outcome.journal.flights
        ],
    )
    page.bullets(outcome.journal.said)
    names = [one.file for one in outcome.journal.flights]
    names += [BODY_MODEL, "body.html", *(f"plan{n}.json" for n in (1, 2))]
    names += [f"{outcome.found_name}{end}" for end in (".html", ".json", ".model.json")]
    names += [GAINS, SCRIPT, LOG, JOURNAL, "craft.toml", "sealed.toml"]
    there = [name for name in dict.fromkeys(names) if (outcome.folder / name).exists()]
    page.links([(name, name) for name in there])
