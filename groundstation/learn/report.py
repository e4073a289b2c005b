"""The craft on a page: what it is, how well it is predicted, its gains before and after, what is
open, and everything behind it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundstation.control.step_analysis import Flown as Steps
from groundstation.discrepancy.report_html import evidence_bars, meaning, waterfall
from groundstation.dynamics.meanings import meaning_of, title_of
from groundstation.learn.found import open_words
from groundstation.learn.gains import mean_missed
from groundstation.learn.journal import JOURNAL
from groundstation.learn.outcome import Outcome, said_named
from groundstation.learn.story import BODY_MODEL, GAINS
from groundstation.report.page import FAINT, IMPROVED, MEASURED, MODELLED, Page, figure
from groundstation.shell import LOG, SCRIPT
from groundstation.telemetry.packet import SAMPLE_PERIOD_S
from groundstation.text import listed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
