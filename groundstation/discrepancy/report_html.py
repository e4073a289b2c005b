"""The comparison and discrepancy reports as pages."""

from __future__ import annotations

from groundstation.comparison.comparison import Comparison, Place, spectrum_of, worst_stretch
from groundstation.discrepancy.proof import Proof
from groundstation.discrepancy.report_figures import (
    by_horizon,
    evidence_bars,
    label,
    residual_spectrum,
    time_map,
    waterfall,
    where_map,
    worst_overlay,
)
from groundstation.discrepancy.report_json import (
    CompareReport,
    DiscrepancyReport,
    Gap,
    why_lost,
)
from groundstation.discrepancy.report_words import (
    SURE,
    advice_of,
    by_weight,
    compared_in_words,
    compared_next,
    flight_plan,
    found_in_words,
    is_zero,
    meaning,
    next_in_words,
    possible_in_words,
)
from groundstation.dynamics.meanings import title_of
from groundstation.report.page import Page

CLEAR = 3.0
"""Standard deviations of noise energy from which a place is worth naming."""
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
    _good_for(page, report.good_for)
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
    _effects(page, report)
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
    kind = {"effects_found": "good" if clean else "neutral", "unexplained": "bad"}
    page.verdict(found_in_words(report), kind.get(report.verdict, "good"))
    page.next_step(next_in_words(report))
    _good_for(page, report.good_for)
    notes = list(report.warnings)
    if report.residual == "structured":
        left = report.residual_detail
        hertz = ", ".join(f"{f:.3g}" for f in left.frequencies_hz)
        notes.append(
            f"What is left is not noise: structure in {label(left.channel)}"
            + (f" at {hertz} Hz" if hertz else "")
            + (f", most like {left.signal}" if left.signal else "")
        )
    page.advice(advice_of(report), notes)


def _good_for(page: Page, verdict: str) -> None:
    if verdict:
        page.text(f"What the model is good for: {verdict[:1].lower()}{verdict[1:]}.")


def _effects(page: Page, report: DiscrepancyReport) -> None:
    if report.effects:
        _named(page, report)
    else:
        page.text("No effect passed every test.")
    for line in possible_in_words(report):
        page.text(f"{line[:1].upper()}{line[1:]}.")


def _named(page: Page, report: DiscrepancyReport) -> None:
    rows = []
    for effect in by_weight(report.effects):
        for number, (name, estimate) in enumerate(effect.parameters.items()):
            first = number == 0
            spread = "" if estimate.stderr is None else f" ± {SURE * estimate.stderr:.2g}"
            zero = ", not distinguishable from zero" if is_zero(estimate) else ""
            share, again = (
                "" if part is None else f"{100.0 * part:.0f} %"
                for part in (effect.weight, effect.recurrence)
            )
            rows.append(
                (
                    title_of(effect.name) if first else "",
                    meaning(effect) if first else "",
                    share if first else "",
                    again if first else "",
                    f"{name} = {estimate.value:.4g}{spread} {estimate.unit}".strip() + zero,
                    f"{effect.gap.before:.3f} → {effect.gap.after:.3f}" if first else "",
                    effect.name if first else "",
                )
            )
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
        row: tuple[str | float | None, ...] = (label(name), channel.before)
        row += (channel.after,) if after else ()
        row += (own.before,)
        row += (own.after,) if after else ()
        rows.append((*row, own.noise_floor, own.unit))
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
    seen: list[str] = []
    for place in before.places:
        if place.significance >= CLEAR and place.channel not in seen:
            seen.append(place.channel)
    for channel in seen[:SPECTRA]:
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


def _place(row: Place) -> str:
    ratio = row.rms / row.expected_rms
    return f"{label(row.channel)}, {row.regime} ({ratio:.1f} times the noise)"
