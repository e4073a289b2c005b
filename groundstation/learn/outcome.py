"""What came of it; where effects were hidden, the seal is opened and every name held against it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from groundstation.control.step_analysis import Flown as Steps
from groundstation.discrepancy.report_json import DiscrepancyReport, EffectFound
from groundstation.documents import decode_toml, read_document
from groundstation.dynamics.model import Model, load_model
from groundstation.errors import BadInputError
from groundstation.learn.found import named_effects, open_names, read_found, said_effect
from groundstation.learn.gains import flown_steps, mean_missed
from groundstation.learn.journal import Journal
from groundstation.learn.story import BODY_MODEL

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
            else [
                {
                    "effect": s.effect,
                    "parameter": s.parameter,
                    "true": s.true,
                    "value": s.value,
                    "stderr": s.stderr,
                    "inside": s.inside,
                }
                for s in self.hidden
            ],
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
