"""The report of an identification: what to do next, what was found, how sure it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.meanings import (
    DESIGN,
    POOR,
    Use,
    arx_meaning,
    meaning_of,
    suitability,
    title_of,
    verdict,
)
from groundstation.dynamics.model import Model, Turning
from groundstation.dynamics.sensors import shown_rotors
from groundstation.errors import BadInputError
from groundstation.identification.arx import with_arx_attitude
from groundstation.identification.estimate import (
    CorrelationTest,
    Estimates,
    Evidence,
    Identified,
    ResidualTest,
    Step,
    Trace,
    numbers_of,
)
from groundstation.identification.runs import EVERYTHING, Run, require_known
from groundstation.prediction.prediction import SETTLE_S, fly_ahead, observe_run
from groundstation.report.page import (
    BAD,
    BAND,
    GOOD,
    MEASURED,
    MODELLED,
    NEUTRAL,
    ON_BRIGHT,
    ON_DARK,
    SERIES,
    Advice,
    Cell,
    Page,
    Result,
    Shown,
    figure,
    legend_above,
    thinned,
)
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.text import listed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


SLOW_HZ = 400.0
"""Below, samples do not show every setting of the motors."""
MOVES = {
    "c0": ("roll", "fly roll doublets of 10 degrees and more, several a second"),
    "c1": ("pitch", "fly pitch doublets of 10 degrees and more, several a second"),
    "c2": ("yaw", "fly yaw steps of 60 degrees both ways, several in ten seconds"),
}


def good_for(model: Model, account: Mapping[str, Any]) -> tuple[str, str]:
    """What a fit found and how sure, with what that is good for, and what kind of verdict it is.
    account: the fit's, which the model's own need not have yet."""
    if account["what"] == "motor":
        return _motor(account)
    if account["what"] == "arx":
        return _arx(account)
    found = suitability(msgspec.structs.replace(model, fit={"body": dict(account)}))
    shares = [(axis, one.share) for axis, one in found.items() if one.use != Use.NOTHING]
    known = ", ".join(f"{axis} to {100 * share:.2g} %" for axis, share in shares if share)
    uses = [one.use for one in found.values()]
    kind = "good" if min(uses) == Use.DESIGN else "neutral"
    if max(uses) < Use.FIRST_DESIGN:
        kind = "bad"
    return f"{verdict(found)}. Known, by standard error: {known or 'none'}.", kind


def next_of(account: Mapping[str, Any]) -> str:
    """What to do now."""
    if account["what"] == "motor":
        return "fit the body with it: groundstation fit body FLIGHTS --model THIS -o BODY"
    if account["what"] == "arx":
        return "compare it with the body model on another flight: groundstation compare."
    if account.get("quality") == POOR:
        return "look for what is missing: groundstation discrepancy FLIGHTS --model THIS."
    if left := account.get("left_out"):
        names = listed([title_of(name) for name in left])
        held, files = account.get("held_out"), account.get("recordings", ())
        words = ["groundstation fit body", *([one["file"] for one in files] or ["FLIGHTS"])]
        if isinstance(held, list):
            words += ["--validate", *(one["file"] for one in held)]
        again = " ".join([*words, "-o NEW_FILE", "--with", ",".join(left)])
        return f"what these flights show besides ({names}) into the file: {again}"
    if weak := _weakest(account):
        return f"{_remedy(account, weak)}, and fit both recordings together."
    return "look for what is missing: groundstation discrepancy, with another flight as --validate."


def advice_of(account: Mapping[str, Any], failed: Sequence[str]) -> list[Advice]:
    """What must not be overlooked, the gravest first. failed: channels in whose residuals the
    input still shows."""
    found = []
    shares = _shares(account)
    for name, reason in account.get("not_identified", {}).items():
        axis = MOVES[name][0]
        what = f"{axis.capitalize()} is not identified: {reason}"
        meant = f"The file has the profile's {name}; its {axis} is a guess"
        found.append(Advice(what, meant, _remedy(account, name).capitalize()))
    for name, share in shares.items():
        if name in MOVES and name not in account.get("not_identified", {}) and share > DESIGN:
            axis, fly = MOVES[name]
            what = f"{axis.capitalize()} is known to {100 * share:.0f} % only"
            meant = "Gains that are designed on it may be off by as much"
            found.append(Advice(what, meant, fly.capitalize()))
    if account["what"] == "body" and 0.0 < account.get("rate_hz", 0.0) < SLOW_HZ:
        hz = account["rate_hz"]
        what = f"{hz:.0f} samples a second show one in {500.0 / hz:.1f} of the motors' settings"
        meant = "What the craft was told between them is unknown, and counts in the errors"
        found.append(Advice(what, meant, "Record 500 a second, or rotor speeds"))
    if failed:
        what = f"The input still shows in what is left of {listed(list(failed))}"
        meant = "Something acts there that the model does not have"
        found.append(Advice(what, meant, "Search with groundstation discrepancy"))
    return found


def _motor(account: Mapping[str, Any]) -> tuple[str, str]:
    shares = _shares(account)
    name, share = max(shares.items(), key=lambda one: one[1])
    text = f"The motor is known to {100 * share:.2g} % ({name}, the least certain)"
    held = account.get("validation")
    if held:
        fits = [one["rotor_fit_percent"] for one in held]
        text += f", and its speed on unseen data fits by {min(fits):.1f} %"
    if share <= DESIGN and not (held and min(fits) < 0.0):
        return f"{text}: good enough for body fits and design.", "good"
    return f"{text}: a start.", "bad"


def _arx(account: Mapping[str, Any]) -> tuple[str, str]:
    chosen = ", ".join(f"{axis} {one['chosen']}" for axis, one in account["axes"].items())
    failed = [
        axis for axis, one in account["axes"].items() if not one["cross_correlation"]["passes"]
    ]
    if failed:
        left = f"the input still shows in what is left of {listed(failed)}"
        return f"Chosen: {chosen}; {left}: for a first, cautious design.", "bad"
    return f"Chosen: {chosen}; nothing of the input is left: good enough to design with.", "good"


def _shares(account: Mapping[str, Any]) -> dict[str, float]:
    """Standard error over value of each constant."""
    return {
        name: float(error / abs(value)) if value else float(np.inf)
        for name, value, error in numbers_of(account)
        if "." not in name and not name.endswith("_s")
    }


def _weakest(account: Mapping[str, Any]) -> str | None:
    """The constant that is known worst, where that is not good enough."""
    unknown = account.get("not_identified", {})
    shares = {
        name: np.inf if name in unknown else share
        for name, share in _shares(account).items()
        if name in MOVES
    }
    name = max(shares, key=lambda one: shares[one], default=None)
    return name if name is not None and shares[name] > DESIGN else None


def _remedy(account: Mapping[str, Any], name: str) -> str:
    """What to fly, or to record where no manoeuvre helps, so that a constant is told."""
    record = account.get("record", {}).get(name)
    return f"record {record}" if record else MOVES[name][1]


# An identified model on recorded inputs: what it would have measured.


CHANNELS = (
    *(f"gyro {axis} (deg/s)" for axis in "xyz"),
    *(f"accelerometer {axis} (g)" for axis in "xyz"),
    *(f"{axis} (deg)" for axis in ("roll", "pitch", "yaw")),
)


@dataclass(frozen=True, slots=True, repr=False)
class Replayed(Result):
    """Modelled channels of a run, row by row, as the telemetry would report them.

    gyro: (n, 3) rad/s. accelerometer: (n, 3) m/s^2. attitude: (n, 3) rad, yaw unwrapped.
    rotor_rev_s: (n, 4). flown: (n,) rows that were simulated; the others, on the ground or of a
    window that began there, repeat what was measured. run: what was measured.
    """

    gyro: Array
    accelerometer: Array
    attitude: Array
    rotor_rev_s: Array
    flown: NDArray[np.bool_]
    run: Run
    SHOWN_BY: ClassVar[str] = "groundstation.identification.report:replayed"

    def _what(self) -> str:
        share = 100.0 * float(self.flown.mean())
        return f"{self.run.name}: {len(self.flown)} samples, {share:.0f} % simulated"


def simulate_run(
    model: Model, run: Run, window_s: float = 0.5, turning: Turning = "body"
) -> Replayed:
    """Fly a body model, with its effects, on a run's PWM and battery voltage.

    The motors run through; every ``window_s`` the rest starts afresh from the state that was
    observed until then, because no model of an unstable craft can follow a flight for long.
    turning: what turns the craft, the body or the model's ARX polynomials.

    Raises BadInputError where the run lacks PWM, battery voltage, gyro or attitude.
    """
    require_known(run, ("duty", "supply_v", "gyro", "attitude"), "nothing can be flown without it")
    if window_s < run.period_s:
        raise BadInputError(f"window of {window_s} s is shorter than a row ({run.period_s:.4f} s)")
    seen = observe_run(model, run)
    gyro, accelerometer = run.gyro.copy(), run.accelerometer.copy()
    attitude = np.unwrap(run.attitude, axis=0)
    flown = np.zeros(len(run), np.bool_)
    rows = min(max(1, round(window_s / run.period_s)), len(run) - 1)
    starts = np.arange(0, len(run) - 1, rows)
    for group, ahead in ((starts[:-1], rows), (starts[-1:], len(run) - 1 - int(starts[-1]))):
        done = fly_ahead(run, seen, group, np.arange(1, ahead + 1))
        if turning == "arx":
            done = with_arx_attitude(done, model, run)
        at = group[:, None] + done.horizons
        real = seen.flying[at] & seen.flying[group][:, None]
        gyro[at[real]] = done.gyro[real]
        accelerometer[at[real]] = done.accelerometer[real]
        attitude[at[real]] = done.attitude[real]
        flown[at[real]] = True
    attitude = np.unwrap(attitude, axis=0)
    shown = shown_rotors(model, seen.drive.rotor_rev_s, run.period_s)
    return Replayed(gyro, accelerometer, attitude, shown, flown, run)


def angle_rms(model: Model, runs: Sequence[Run], window_s: float) -> Array:
    """RMS (3,) of roll, pitch, yaw in rad of free runs of ``window_s``, over what was flown: the
    errors of thesis Table 7.2, which does not say how long its runs were. The first of each
    recording is left out: the state it starts from is not observed yet.

    Raises BadInputError as ``simulate_run``, and where nothing was flown or a run diverges.
    """
    errors = []
    for run in runs:
        done = simulate_run(model, run, window_s)
        rows = np.flatnonzero(done.flown)
        rows = rows[rows > max(window_s, SETTLE_S) / run.period_s]
        turn = run.attitude[rows] - done.attitude[rows]
        if not np.isfinite(turn).all():
            raise BadInputError(f"{run.name}: free runs of {window_s:g} s end nowhere")
        errors.append(np.angle(np.exp(1j * turn)))
    every = np.vstack(errors)
    if not len(every):
        raise BadInputError("by the model's thrust the craft never leaves the ground")
    return np.sqrt(np.mean(np.square(every), axis=0))


def channels_of(gyro: Array, accelerometer: Array, attitude: Array) -> Array:
    """(n, 9) in the units of ``CHANNELS``."""
    return np.column_stack(
        [np.degrees(gyro), accelerometer / STANDARD_GRAVITY, np.degrees(attitude)]
    )


def errors_of(run: Run, done: Replayed) -> Array:
    """Measured less modelled, (n, 9) in the units of ``CHANNELS``; angles wrapped.

    NaN in rows that were not simulated.
    """
    error = channels_of(run.gyro, run.accelerometer, run.attitude)
    error -= channels_of(done.gyro, done.accelerometer, done.attitude)
    error[:, 6:] = (error[:, 6:] + 180.0) % 360.0 - 180.0
    error[~done.flown] = np.nan
    return error


def rms_of(errors: Array) -> Array:
    """Root mean square per channel over what is known, NaN where nothing is."""
    known = np.isfinite(errors)
    count = known.sum(axis=0)
    square = np.where(known, errors, 0.0) ** 2
    return np.where(count, np.sqrt(square.sum(axis=0) / np.maximum(count, 1)), np.nan)


MOST_PERCENT = 1e4
Meaning = Callable[[str], tuple[str, str]]
TITLES = {"motor": "Motor", "body": "Body", "arx": "ARX models"}


def report(model: Model, account: dict[str, Any], evidence: Evidence) -> Page:
    """The whole page. account: as the model file keeps it, with its recordings."""
    names = ", ".join(one["file"] for one in account["recordings"])
    chosen = "" if account["selection"] == str(EVERYTHING) else f", {account['selection']}"
    page = Page(
        f"{TITLES[account['what']]} of {model.vehicle}",
        f"{account['method']}, {account['samples']} samples of {names}{chosen}; made by"
        f" {model.created_by}",
    )
    page.verdict(*good_for(model, account))
    page.next_step(next_of(account))
    failed = [one.channel for one in evidence.residuals if not one.cross.passes]
    page.advice(advice_of(account, failed), account["warnings"])
    if account.get("findings"):
        page.heading("Rotors")
        page.bullets(account["findings"])
    for title, estimates in evidence.estimates.items():
        page.heading("Parameters" if len(evidence.estimates) == 1 else f"Parameters: {title}")
        meaning: Meaning = meaning_of
        if account["what"] == "arx":
            axis = (model.arx or {})[title.partition(" ")[0]]
            meaning = partial(arx_meaning, axis=axis, rates=account["channel"] == "gyro")
        _parameters(page, estimates, account, meaning)
    page.heading("Measured and modelled")
    page.text("Rows that no fit has seen, where the channel moves most.")
    for one in evidence.traces:
        page.figure(trace(one), f"{one.channel}: {one.note}.")
    _held_out(page, account)
    if evidence.preparation is not None:
        page.heading("Before the fit")
        for drawn, words in evidence.preparation():
            page.figure(drawn, words)
    if evidence.steps:
        page.heading("Step responses")
        page.figure(
            steps(evidence.steps),
            "Answer to a lasting unit torque. A free body must keep turning the way it is pushed:"
            " broken lines do not. The chosen model is drawn thick.",
        )
    if account["what"] == "arx":
        _tables(page, account)
    page.heading("Residuals")
    page.text(
        "Correlation of what the model leaves with itself and with earlier inputs; 99 of 100"
        " values lie inside the grey band where nothing is left to explain. In closed loop only"
        " inputs from before count: later ones follow from the residual, through the controller."
        " With a slow input neighbouring values leave the band together; the verdict allows for it."
    )
    for test in evidence.residuals:
        white = "white" if test.whiteness.passes else "not white"
        left = "nothing of the input is left" if test.cross.passes else "the input still shows"
        page.figure(residual(test), f"{test.channel}: {white}, {left}.")
    held = account["held_out"] if isinstance(account["held_out"], list) else []
    used = ((account["recordings"], "fitted"), (held, "held out"))
    page.heading("Recordings")
    page.table(
        ["file", "sha256", "used"],
        [[one["file"], one["sha256"], how] for some, how in used for one in some],
        "" if held else f"Held out: the {account['held_out']} of all rows.",
    )
    return page


def _parameters(
    page: Page, estimates: Estimates, account: dict[str, Any], meaning_in_words: Meaning
) -> None:
    """meaning_in_words: (unit, meaning) of a name."""
    interval = estimates.interval()
    rows: list[list[Cell]] = []
    for i, (name, value, error) in enumerate(estimates.rows):
        unit, meaning = meaning_in_words(name)
        unknown = name in account.get("not_identified", {})
        if "." in name and abs(value) < 1.96 * error:
            meaning += "; not distinguishable from zero"
        elif unknown:
            meaning += "; not identified: the file has the profile's"
        share = 100 * error / abs(value) if value and not unknown else None
        rows.append([name, value, error, unit, share, *interval[i].tolist(), meaning])
    head = ["parameter", "value", "standard error", "unit", "%", "95 % from", "to", "meaning"]
    page.table(head, rows)
    if len(estimates.names) > 1:
        page.figure(
            certainty(estimates),
            "Left: correlation of the estimates; near +1 or -1, the data tell the two only"
            " together. Right: standard error as a share of the value.",
        )


def _held_out(page: Page, account: dict[str, Any]) -> None:
    held, fitted = account.get("validation"), account.get("identification")
    if isinstance(held, dict) and isinstance(fitted, dict):
        rows = [[name.replace("_", " "), fitted.get(name), value] for name, value in held.items()]
        page.table(
            ["figure", "on the fitted rows", "held out"],
            rows,
            "Rates in rad/s, specific force in m/s^2. Fit %: 100 is perfect, 0 no better than"
            " the mean.",
        )
    elif isinstance(held, list):
        page.table(
            ["held-out run", "fit %", "RMS, rev/s"],
            [[one["recording"], one["rotor_fit_percent"], one["rotor_rms_rev_s"]] for one in held],
        )


def _tables(page: Page, account: dict[str, Any]) -> None:
    for axis, one in account["axes"].items():
        page.heading(f"Structures: {axis}")
        head = list(one["table"][0])
        rows = [
            [("yes" if cell else "no") if isinstance(cell, bool) else cell for cell in row.values()]
            for row in one["table"]
        ]
        page.table(
            [name.replace("_", " ").replace("rad s", "rad/s") for name in head],
            rows,
            f"All, the best by free run on held-out data first; chosen: {one['chosen']}.",
        )
    other = account["other_axis"]
    page.text(
        f"Roll's model on pitch data, free run: RMS {other['roll_model_on_pitch']:.4g}; pitch's on"
        f" roll data: {other['pitch_model_on_roll']:.4g}."
    )


def trace(shown: Trace) -> Figure:
    """Measured and modelled, and what lies between."""
    made, (above, below) = figure(height=3.6, rows=2, sharex=True, height_ratios=[3, 1])
    above.plot(shown.time_s, shown.measured, color=MEASURED, label="measured")
    above.plot(shown.time_s, shown.modelled, color=MODELLED, label="modelled")
    above.set_ylabel(f"{shown.channel}\n{shown.unit}")
    legend_above(above)
    below.plot(shown.time_s, shown.measured - shown.modelled, color=NEUTRAL)
    below.set_ylabel(f"error\n{shown.unit}")
    below.set_xlabel("time, s")
    return made


def residual(test: ResidualTest) -> Figure:
    """Correlations of what is left with itself and with the input."""
    made, (left, right) = figure(height=2.6, columns=2)
    _stems(left, test.whiteness, "with itself, rows earlier")
    _stems(right, test.cross, f"with {test.against}, rows earlier")
    left.set_ylabel("correlation")
    left.set_title(test.channel)
    return made


def _stems(axes: Axes, test: CorrelationTest, label: str) -> None:
    axes.axhspan(-test.bound, test.bound, color=BAND, zorder=0)
    outside = np.abs(test.values) > test.bound
    for mask, color in ((~outside, GOOD), (outside, BAD)):
        axes.vlines(test.lags[mask], 0, test.values[mask], color=color, linewidth=2.2)
    axes.axhline(0, color=MEASURED, linewidth=0.7)
    reach = 1.15 * max(2.0 * test.bound, float(np.abs(test.values).max()))
    axes.set_ylim(-reach, reach)
    axes.set_xlabel(label)


def certainty(estimates: Estimates) -> Figure:
    """Correlation of estimates, and their errors as shares of their values."""
    labels = [name.replace(".", "\n") for name in estimates.names]
    made, (left, right) = figure(
        height=max(2.8, 0.5 * len(labels) + 1.0), columns=2, width_ratios=[1.0, 1.1]
    )
    left.imshow(estimates.correlation, cmap="coolwarm", vmin=-1, vmax=1, aspect="auto")
    ticks = range(len(labels))
    left.set_xticks(ticks, labels, rotation=60, ha="right", fontsize=7)
    left.set_yticks(ticks, labels, fontsize=7)
    left.grid(visible=False)
    left.set_title("correlation")
    for i in ticks:
        for j in ticks:
            value = estimates.correlation[i, j]
            color = ON_DARK if abs(value) > 0.7 else ON_BRIGHT
            left.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=7, color=color)
    shares = 100 * estimates.stderr / np.maximum(np.abs(estimates.values), 1e-300)
    shares = np.minimum(shares, MOST_PERCENT)  # an effect that is not there is 0
    right.barh(ticks, shares, color=SERIES[0], height=0.6)
    right.set_xscale("log")
    right.set_xlim(
        10.0 ** np.floor(np.log10(shares.min())), 10.0 ** np.ceil(np.log10(shares.max()))
    )
    right.xaxis.set_major_formatter("{x:g}")
    right.xaxis.set_minor_formatter("")
    right.invert_yaxis()
    right.set_yticks(ticks, labels, fontsize=7)
    right.set_xlabel("standard error, % of the value")
    right.set_title("uncertainty")
    right.set_axisbelow(True)
    return made


def steps(shown: Sequence[Step]) -> Figure:
    """Responses of ARX models to a unit step, axis by axis."""
    axes_names = list(dict.fromkeys(step.axis for step in shown))
    made, every = figure(height=3.0, columns=len(axes_names))
    for axes, name in zip(every, axes_names, strict=True):
        here = [step for step in shown if step.axis == name]
        reach = max(float(np.abs(here[0].output).max()), 1e-300)
        for color, step in zip(SERIES, here, strict=False):
            axes.plot(
                step.time_s,
                step.output / reach,
                color=color,
                linewidth=2.6 if step.chosen else 1.2,
                linestyle="-" if step.plausible else "--",
                label=step.label,
            )
        lowest = min(float(step.output.min()) / reach for step in here)
        axes.set_ylim(max(1.2 * lowest, -1.3) - 0.6, 1.6)
        axes.set_title(name)
        axes.set_xlabel("time, s")
        axes.legend(loc="lower right")
    every[0].set_ylabel("output over the chosen one's end")
    return made


SHOWN_S = 5.0


def identified(one: Identified) -> Shown:
    """The estimates with their errors; each figure of the report."""
    columns: dict[str, list[object]] = {
        name: [] for name in ("part", "name", "value", "stderr", "low", "high")
    }
    pictures: dict[str, Callable[[], Figure]] = {}
    for part, estimates in one.evidence.estimates.items():
        for row, ends in zip(estimates.rows, estimates.interval().tolist(), strict=True):
            for column, cell in zip(columns.values(), (part, *row, *ends), strict=True):
                column.append(cell)
        if len(estimates.names) > 1:
            several = len(one.evidence.estimates) > 1
            name = f"certainty {part}" if several else "certainty"
            pictures[name] = partial(certainty, estimates)
    pictures |= {each.channel: partial(trace, each) for each in one.evidence.traces}
    for each in one.evidence.residuals:
        pictures[f"residuals of {each.channel}"] = partial(residual, each)
    if one.evidence.steps:
        pictures["step responses"] = partial(steps, one.evidence.steps)
    return Shown(f"{one}: {good_for(one.model, one.account)[0]}", columns, one.warnings, pictures)


def replayed(one: Replayed) -> Shown:
    """Every sample of each channel; measured and simulated where they move most."""
    run = one.run
    columns: dict[str, Any] = {"time_s": run.time_s - run.recording_start_s}
    for name in ("gyro", "accelerometer", "attitude"):
        for axis in range(3):
            columns[f"{name}_{'xyz'[axis]}"] = getattr(one, name)[:, axis]
    columns["flown"] = one.flown
    first = int(np.argmax(one.flown))
    rows = slice(first, first + round(SHOWN_S / run.period_s))
    return Shown(repr(one), columns, (), {"channels": partial(_overlay, one, rows)})


def _overlay(done: Replayed, rows: slice) -> Figure:
    """Measured and simulated, nine channels."""
    run = done.run
    measured = channels_of(run.gyro, run.accelerometer, run.attitude)[rows]
    modelled = channels_of(done.gyro, done.accelerometer, done.attitude)[rows]
    time = run.time_s[rows] - run.recording_start_s
    drawn, axes = figure(9.5, 7.0, rows=3, columns=3, sharex=True)
    for i, name in enumerate(CHANNELS):
        t, one, other = thinned(time, measured[:, i], modelled[:, i])
        axes[i].plot(t, one, color=MEASURED, label="measured")
        axes[i].plot(t, other, color=MODELLED, label="simulated")
        axes[i].set_title(name)
    for axis in axes[6:]:
        axis.set_xlabel("time, s")
    drawn.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return drawn
