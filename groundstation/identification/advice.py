"""What a fit begins with, in plain words: what it is good for, what to do next, what to mind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from groundstation.dynamics.meanings import DESIGN, Use, suitability, title_of, verdict
from groundstation.dynamics.model import Model
from groundstation.report.page import Advice
from groundstation.text import listed

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
    if left := account.get("left_out"):
        names = listed([title_of(name) for name in left])
        return f"what these flights show besides ({names}) into the file: {_again(account, left)}"
    if weak := _weakest(account):
        return f"{_remedy(account, weak)}, and fit both recordings together."
    return "look for what is missing: groundstation discrepancy, with another flight as --validate."


def _again(account: Mapping[str, Any], effects: Sequence[str]) -> str:
    """The command that fits the same with effects that were left out."""
    held = account.get("held_out")
    files = [one["file"] for one in account.get("recordings", ())] or ["FLIGHTS"]
    words = ["groundstation fit body", *files]
    if isinstance(held, list):
        words += ["--validate", *(one["file"] for one in held)]
    return " ".join([*words, "-o NEW_FILE", "--with", ",".join(effects)])


def advice_of(account: Mapping[str, Any], failed: Sequence[str]) -> list[Advice]:
    """What must not be overlooked, the gravest first. failed: channels in whose residuals the
    input still shows."""
    found = []
    shares = _shares(account)
    for name, reason in account.get("not_identified", {}).items():
        axis = MOVES[name][0]
        found.append(
            Advice(
                f"{axis.capitalize()} is not identified: {reason}",
                f"The file has the profile's {name}; its {axis} is a guess",
                _remedy(account, name).capitalize(),
            )
        )
    for name, share in shares.items():
        if name in MOVES and name not in account.get("not_identified", {}) and share > DESIGN:
            axis, fly = MOVES[name]
            found.append(
                Advice(
                    f"{axis.capitalize()} is known to {100 * share:.0f} % only",
                    "Gains that are designed on it may be off by as much",
                    fly.capitalize(),
                )
            )
    if account["what"] == "body" and 0.0 < account.get("rate_hz", 0.0) < SLOW_HZ:
        hz = account["rate_hz"]
        found.append(
            Advice(
                f"{hz:.0f} samples a second show one in {500.0 / hz:.1f} of the motors' settings",
                "What the craft was told between them is unknown, and counts in the errors",
                "Record 500 a second, or rotor speeds",
            )
        )
    if failed:
        found.append(
            Advice(
                f"The input still shows in what is left of {listed(list(failed))}",
                "Something acts there that the model does not have",
                "Search with groundstation discrepancy",
            )
        )
    return found


def _motor(account: Mapping[str, Any]) -> tuple[str, str]:
    shares = _shares(account)
    name, share = max(shares.items(), key=lambda one: one[1])
    text = f"The motor is known to {100 * share:.2g} % ({name}, the least certain)"
    held = account.get("validation")
    if held:
        fits = [one["rotor_fit_percent"] for one in held]
        text += f", and its speed on unseen data fits by {min(fits):.1f} %"
    good = share <= DESIGN and not (held and min(fits) < 0.0)
    return f"{text}: {'good enough for body fits and design' if good else 'a start'}.", (
        "good" if good else "bad"
    )


def _arx(account: Mapping[str, Any]) -> tuple[str, str]:
    chosen = ", ".join(f"{axis} {one['chosen']}" for axis, one in account["axes"].items())
    failed = [
        axis for axis, one in account["axes"].items() if not one["cross_correlation"]["passes"]
    ]
    left = (
        f"; the input still shows in what is left of {listed(failed)}: for a first, cautious design"
        if failed
        else "; nothing of the input is left: good enough to design with"
    )
    return f"Chosen: {chosen}{left}.", "bad" if failed else "good"


def _shares(account: Mapping[str, Any]) -> dict[str, float]:
    """Standard error over value of each constant."""
    found = account.get("estimates") or {"names": (), "values": (), "stderr": ()}
    return {
        name: float(error / abs(value)) if value else float(np.inf)
        for name, value, error in zip(found["names"], found["values"], found["stderr"], strict=True)
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
