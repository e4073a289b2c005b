"""What is done, in order: each flight and each command; what is in the folder is not done again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.control.design import RMS, cascade_limits, design_cascade
from groundstation.control.firmware_loop import gains_text, load_gains
from groundstation.control.firmwares import firmware_of_vehicle
from groundstation.control.programme import (
    AWAY,
    BEGINS,
    BY_HAND,
    FAST,
    LANDS,
    TILTED,
    TURNED,
    Programme,
)
from groundstation.control.step_analysis import Flown, FlownAxis, analyse_recording
from groundstation.discrepancy.report_json import DiscrepancyReport, EffectFound, PossibleEffect
from groundstation.documents import decode_json, read_document
from groundstation.dynamics.effect import to_point
from groundstation.dynamics.model import Model, load_model, model_vehicle
from groundstation.dynamics.registry import EFFECTS
from groundstation.errors import BadInputError, GroundStationError
from groundstation.identification.likelihood.motion import KEYS
from groundstation.learn.planning import (
    BEING_WRITTEN,
    BODY,
    HOVER,
    LANDING_S,
    PREFLIGHT_S,
    PROOF,
    TAKE_OFF_S,
    Journal,
    Landed,
    Limits,
    Pilot,
    Planned,
    flight_of,
    plan_flight,
    rehearsal,
)
from groundstation.paths import write_whole
from groundstation.recording.formats import open_for_analysis
from groundstation.shell import Shell
from groundstation.telemetry.arrays import AXES
from groundstation.text import listed

# What a search found, as names and in words: what is worth a name, and what is still open.


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


# Gains for the model that was found, and what steps that were flown say of them.


CLIENT = "learn"
OVERSHOOT_MORE = 5.0
"""Points of a step by which an axis may overshoot more than with the gains before."""
ANGLE_DEG, HOLD_S, REPEATS = 10.0, 0.7, 2
BEFORE, AFTER = "steps_before.mcap", "steps_after{}.mcap"
"""Flights of steps: with the gains before, and with new ones, numbered from 1."""


class StepFlight(Programme):
    """Doublets of every axis, with what the journal wants to know."""

    purpose = "doublets, to see how the gains follow"

    @property
    def seconds(self) -> float:
        return self.held_seconds

    def timeline(self) -> list[dict[str, Any]]:
        fly = f"{self.repeats} doublets an axis"
        return [{"at_s": 0.0, "seconds": self.seconds, "fly": fly}]


def step_flight(limits: Limits) -> StepFlight:
    """The same for all gains of a craft."""
    return StepFlight(angle_deg=limits.lean(ANGLE_DEG, HOLD_S), hold_s=HOLD_S, repeats=REPEATS)


def designed_gains(model: Model) -> dict[str, float]:
    """Of each axis the gains of ``pid design``.

    An axis keeps its stock gains where by the model they follow a step as closely. Raises
    BadInputError where every axis does.
    """
    found: dict[str, float] = {}
    faults = []
    for axis in AXES:
        try:
            (one,) = design_cascade(model, [axis], cascade_limits())
        except BadInputError as error:
            faults.append(str(error))
            continue
        found |= one.gains if one.nominal[RMS] < one.stock_nominal[RMS] else {}
    if not found:
        raise BadInputError(
            "; ".join(faults) or "by the model the stock gains follow steps best on every axis"
        )
    return found


def flown_steps(folder: Path, flight: Landed, model: Model) -> Flown:
    """The doublets of a flight, measured, and as a model predicts them."""
    return analyse_recording(open_for_analysis(folder / flight.file), model, flight.gains, CLIENT)


def missed(axis: FlownAxis) -> float:
    """RMS of an axis's steps as a share of their size."""
    return axis.measured.rms / axis.step


def mean_missed(flown: Flown) -> float:
    """The same, mean of the axes."""
    return float(np.mean([missed(one) for one in flown.axes]))


def of_better_axes(gains: dict[str, float], before: Flown, after: Flown) -> dict[str, float]:
    """The gains of those axes that followed their steps more closely with them, and overshot them
    by no more than ``OVERSHOOT_MORE`` points more."""
    better = {
        new.axis
        for old, new in zip(before.axes, after.axes, strict=True)
        if missed(new) < missed(old)
        and new.measured.overshoot_pct - old.measured.overshoot_pct <= OVERSHOOT_MORE
    }
    return {name: value for name, value in gains.items() if axis_of(name) in better}


def told_overshoots(before: Flown, after: Flown) -> str:
    """Of every axis before and after, in words, with what the model predicted."""
    parts = []
    for old, new in zip(before.axes, after.axes, strict=True):
        says = "" if new.predicted is None else f" ({new.predicted.overshoot_pct:.0f} predicted)"
        parts.append(
            f"{new.axis} {old.measured.overshoot_pct:.0f} to {new.measured.overshoot_pct:.0f}{says}"
        )
    return f"overshoot in %: {', '.join(parts)}"


def axis_of(gain: str) -> str:
    """Of a parameter's name: 'roll' of 'pid_rate.roll_kp'."""
    return gain.partition(".")[2].partition("_")[0]


BATTERY_S = 300.0
"""In the air on one battery: the firmware lands a Crazyflie after some 6 to 7 minutes."""
DESIGNED_S = 60.0
"""Of a flight that is designed."""
ROUNDS = 2
"""Designed flights at most: one for everything, one for names that the first could not settle."""
BODY_MODEL, GAINS = "body.json", "gains.toml"
BY_GAINS = (TILTED, TURNED, BY_HAND, AWAY, FAST)
"""How the reasons begin for which a flight with new gains is their last."""
MODEL = "model.json"
"""The last one, with what it lacked."""
PROOF_FLIGHT = "proof.mcap"


class Learner:
    """One craft being learnt, in a folder. rehearse: who flies a model's file in software. say:
    is given every line."""

    def __init__(
        self,
        journal: Journal,
        shell: Shell,
        pilot: Pilot,
        rehearse: Callable[[Path], Pilot],
        say: Callable[[str], None],
    ) -> None:
        self.journal, self.shell, self.pilot = journal, shell, pilot
        self.folder, self._say = shell.folder, say
        self._rehearse = rehearse
        task = journal.task
        self.limits = Limits(reach_m=task.reach_m, height_m=task.height_m)

    def learn(self) -> None:
        """All of it. Raises GroundStationError where a flight or a command fails: what there is
        stays, and ``learn`` goes on there."""
        flights = ["flight1.mcap", "flight2.mcap"]
        seed = self.journal.task.seed
        self._fly(flights[0], flight_of(HOVER, "hover and motors", self.limits, seed))
        self._tell("hover", self._hover_line)
        self._fly(flights[1], flight_of(BODY, "the body", self.limits, seed + 1))
        self._fit(flights)
        self._tell("body", self._body_line)
        found: DiscrepancyReport | None = None
        model = BODY_MODEL
        for number in range(1, ROUNDS + 1):
            planned = self._plan(number, model, found)
            if not planned.plan.manoeuvres:
                self._tell(f"plan{number}", lambda: "no manoeuvre would tell more that matters")
                break
            flights.append(f"flight{number + 2}.mcap")
            self._fly(flights[-1], planned.plan)
            if number == 1:
                proof = flight_of(PROOF, "proof: nothing is chosen on it", self.limits, seed + 50)
                self._fly(PROOF_FLIGHT, proof)
            found, model = self._search(number, flights), f"found{number}.model.json"
            self._tell(f"search{number}", partial(found_line, found))
            if not open_names(found):
                break
        write_whole(self.folder / MODEL, read_document(self.folder / model))
        self._gains(model)

    # flights

    def _fly(self, file: str, plan: Any, **how: Any) -> None:
        """Fly it, unless it has been. What is cut short is kept under another name."""
        journal, path = self.journal, self.folder / file
        if journal.good(file) is not None and path.exists():
            return
        self._keep_aside(path)  # of a program that was killed
        needs_s = plan.seconds + PREFLIGHT_S
        battery = journal.batteries
        if journal.is_empty or (journal.flights and journal.on_battery_s + needs_s > BATTERY_S):
            battery += 1
            if battery > journal.task.batteries:
                raise GroundStationError(
                    f"{journal.task.batteries} batteries are flown empty: what is known is in"
                    f" {self.folder}; go on with more: --batteries"
                )
            self._say(f"battery {battery}: put a full one in")
            self.pilot.await_battery()
        self._say(f"flying {file}, {plan.seconds:.0f} s: {plan.purpose}")
        seed = 100 * journal.task.seed + len(journal.flights)
        flown = None
        try:
            flown = self.pilot.fly(plan, path, seed=seed, **how)
        finally:
            aborted = "interrupted" if flown is None else flown.aborted
            kept = self._keep_aside(path) if aborted and path.exists() else path
            if path.exists() or kept != path:
                journal.flights.append(
                    Landed(
                        file=kept.name,
                        purpose=plan.purpose,
                        seconds=plan.seconds if flown is None else flown.seconds,
                        battery=battery,
                        timeline=plan.timeline(),
                        aborted=aborted,
                        gains={} if flown is None else flown.gains,
                    )
                )
                journal.save(self.folder)
        if journal.is_empty and journal.flights[-1].file == kept.name:
            self._fly(file, plan, **how)
        elif aborted:
            raise GroundStationError(
                f"{file}: flight cut short: {aborted}; what was flown is in {kept}; `learn` with"
                " the same folder goes on here"
            )

    def _keep_aside(self, path: Path) -> Path:
        if not path.exists():
            return path
        number = 1
        while (other := path.with_name(f"{path.stem}.cut{number}.mcap")).exists():
            number += 1
        path.rename(other)
        return other

    # commands

    def _run(self, makes: str, *words: str) -> None:
        """A command, unless what it makes last is there; a page of one that was ended is not."""
        if (self.folder / makes).exists():
            self.shell.keep("groundstation", *words)
            return
        for left in self.folder.glob(f"{makes.partition('.')[0]}.*"):
            left.unlink()
        self.shell.run("groundstation", *words)

    def _fit(self, flights: list[str]) -> None:
        vehicle = ("--vehicle", self.journal.task.vehicle)
        made = ("-o", BODY_MODEL, "--html", "body.html")
        self._run(BODY_MODEL, "fit", "body", *flights, *vehicle, *made)

    def _plan(self, number: int, model: str, found: DiscrepancyReport | None) -> Planned:
        path = self.folder / f"plan{number}.json"
        if path.exists():
            return Planned.read(path, self.limits)
        self._say("planning the next flight")
        known = {} if found is None else known_errors(found)
        flown = [] if found is not None else [*HOVER, *BODY]
        planned = plan_flight(
            self._rehearse(self.folder / model),
            load_model(str(self.folder / model)),
            self.limits,
            DESIGNED_S,
            seed=self.journal.task.seed + 10 * number,
            known=known,
            flown=flown,
        )
        planned.write(path)
        return planned

    def _search(self, number: int, flights: list[str]) -> DiscrepancyReport:
        name = f"found{number}"
        given = ("--validate", PROOF_FLIGHT, "--model", BODY_MODEL)
        made = f"-o {name}.model.json --html {name}.html --json {name}.json".split()
        self._run(f"{name}.json", "discrepancy", *flights, *given, *made)
        return read_found(self.folder / f"{name}.json")

    # gains

    def _gains(self, model: str) -> None:
        """Fly the steps with the gains before and with the designed ones, without those of an axis
        that does not follow better, until all that are left do; those are written."""
        journal, loaded = self.journal, load_model(str(self.folder / model))
        if journal.gains not in ("", BEING_WRITTEN):
            return
        try:
            gains = self._design(loaded)
        except BadInputError as error:
            self._settle(f"none: {error}")
            return
        steps = step_flight(self.limits)
        self._fly(BEFORE, steps)
        former = self._landed(BEFORE)
        journal.former = {name: former.gains[name] for name in gains}
        before = after = flown_steps(self.folder, former, loaded)
        number, flew = 0, dict[str, float]()
        while gains and gains != flew:
            number, flew = number + 1, gains
            if wrong := self._rehearsed(self.folder / model, steps, gains):
                self._settle(f"put back: not flown, for the model with them does not: {wrong}")
                return
            try:
                self._fly(AFTER.format(number), steps, gains=gains)
            except GroundStationError as error:
                if not journal.flights[-1].aborted.startswith(BY_GAINS):
                    raise  # a link that was lost, say: they fly again when it goes on
                self._settle(f"put back: {error}")
                return
            after = flown_steps(self.folder, self._landed(AFTER.format(number)), loaded)
            gains = of_better_axes(gains, before, after)
        told = f"steps miss by {mean_missed(after):.3f} of their size (RMS),"
        told += f" by {mean_missed(before):.3f} before; {told_overshoots(before, after)}"
        if not gains:
            self._settle(f"put back: {told}; no axis that was changed follows better")
            return
        journal.former = {name: former.gains[name] for name in gains}
        journal.gains = BEING_WRITTEN  # whoever ends it now can still put them back
        journal.save(self.folder)
        self.pilot.write(gains)
        self._keep_gains(loaded, gains)
        kept = [axis for axis in AXES if axis not in map(axis_of, gains)]
        told += f"; {listed(kept)} as before" if kept else ""
        self._settle(f"written: {told}")

    def _rehearsed(self, model: Path, steps: Any, gains: dict[str, float]) -> str:
        """Why the identified model, in software, does not bring this flight with these gains to its
        end; empty where it does."""
        with rehearsal(self._rehearse(model), steps, seed=1, gains=gains) as (flown, _):
            pass
        if not flown.aborted:
            self._say(f"rehearsed in software, {flown.seconds:.0f} s: the model stays in its room")
        return flown.aborted

    def _landed(self, file: str) -> Landed:
        flight = self.journal.good(file)
        assert flight is not None
        return flight

    def _settle(self, what: str) -> None:
        self.journal.gains = what
        self._tell("gains", lambda: what)

    def _design(self, model: Model) -> dict[str, float]:
        """Those in the folder, or new ones. Raises BadInputError where there are none."""
        path = self.folder / GAINS
        if not path.exists():
            self._say("designing gains for the model that was found")
            self._keep_gains(model, designed_gains(model))
        return {k: v for k, v in load_gains(path).items() if isinstance(v, float)}

    def _keep_gains(self, model: Model, gains: dict[str, float]) -> None:
        """The gains file: as designed, and in the end what was written."""
        text = gains_text(gains, firmware_of_vehicle(model_vehicle(model)).name)
        write_whole(self.folder / GAINS, text)

    # words

    def _tell(self, what: str, line: Callable[[], str]) -> None:
        """Say once what is known now."""
        if not any(said.startswith(f"{what}: ") for said in self.journal.said):
            text = f"{what}: {line()}"
            self.journal.said.append(text)
            self.journal.save(self.folder)
            self._say(text)

    def _hover_line(self) -> str:
        recording = open_for_analysis(self.folder / "flight1.mcap")
        samples = recording.samples
        at_ns = {event.get("text"): event["time_ns"] for event in recording.events}
        host_ns = samples.host_time_ns
        rows = (host_ns > at_ns[BEGINS]) & (host_ns < at_ns[LANDS])
        duty = float(np.mean(samples.duty[rows]))
        noise = float(np.degrees(np.std(np.diff(samples.gyro[rows], axis=0))) / np.sqrt(2.0))
        return (
            f"it hovers at {100 * duty:.0f} % of full PWM, the battery is at"
            f" {float(np.nanmedian(samples.battery_v[rows])):.2f} V, the gyro's noise is"
            f" {noise:.2f} deg/s a row; the next flight is for the body"
        )

    def _body_line(self) -> str:
        account = load_model(str(self.folder / BODY_MODEL)).fit["body"]["estimates"]
        told = ", ".join(
            f"{name} {value:.4g} ± {100 * error / abs(value):.1g} %"
            for name, value, error in zip(
                account["names"], account["values"], account["stderr"], strict=True
            )
        )
        return f"{told}; the next flights are for what this model lacks, and for the proof"


def flights_ahead(journal: Journal, limits: Limits) -> tuple[int, float]:
    """How many flights there are to come at most, and s in the air."""
    first = {"flight1.mcap": HOVER, "flight2.mcap": BODY, PROOF_FLIGHT: PROOF}
    seed, up_down_s = journal.task.seed, TAKE_OFF_S + LANDING_S
    seconds = {name: flight_of(one, "", limits, seed).seconds for name, one in first.items()}
    seconds |= {f"flight{n + 2}.mcap": DESIGNED_S + up_down_s for n in range(1, ROUNDS + 1)}
    steps = [BEFORE, *(AFTER.format(n) for n in range(1, len(AXES) + 1))]
    seconds |= dict.fromkeys(steps, step_flight(limits).seconds + up_down_s)
    left = [s for name, s in seconds.items() if journal.good(name) is None]
    return len(left), sum(left)


def told_plan(planned: Planned) -> list[str]:
    """A plan as a timeline for people."""
    if not planned.choices:
        return ["no manoeuvre would tell more that matters of what this model leaves open"]
    lines = [f"{planned.plan.seconds:.0f} s in the air, from the end of the take-off:"]
    for row in planned.as_dict()["timeline"]:
        tells = ", ".join(key.replace(".", " ", 1) for key in row["tells"])
        lines.append(
            f"  {row['at_s']:5.1f} s  {row['fly']:<28} {row['seconds']:.0f} s"
            f"  {row['gain_nats']:6.1f} nats; most of {tells}"
        )
    return lines
