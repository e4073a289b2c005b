"""The seal is opened: what the report says against what was hidden."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from bench.sealed.cases import Case
from bench.sealed.flights import Sealed
from bench.sealed.hidden import (
    CHANNELS,
    LISTED,
    OUTSIDE,
    REGIMES,
    ROTOR_TORQUES,
)

VISIBLE = 5.0
"""Standard errors from which a search is asked to find an effect."""
INTERVAL = 1.96
CLEAR = 1.2
"""Gap over the floor from which a channel counts as touched by what was hidden."""
LOUD = 2.0
"""Gap over the floor from which an effect outside the list has to be called unexplained."""


def judge(case: Case, sealed: Sealed, report: dict[str, Any]) -> dict[str, Any]:
    """One line of results.

    ``counted`` is False where a hidden effect is below five standard errors: by the bound, never
    by what the search says. ``right``: every hidden effect named and nothing that is not there
    (``Sealed.also`` is).
    """
    found = [effect["name"] for effect in report["effects"]]
    asked = _asked(case, sealed)
    wanted = {name for name in asked if sealed.significance[name] >= VISIBLE}
    false = [name for name in found if name not in {**sealed.present, **sealed.also}]
    missed = sorted(wanted - set(found))
    where = report["where"][0] if report["where"] else {}
    return {
        "case": case.name,
        "group": case.group,
        "hidden": sealed.hidden,
        "condition": sealed.condition,
        "significance": {k: round(v, 2) for k, v in sealed.significance.items()},
        "counted": _counted(case, asked, wanted),
        "verdict": report["verdict"],
        "found": found,
        "said": {
            effect["name"]: {k: e["value"] for k, e in effect["parameters"].items()}
            for effect in report["effects"]
        },
        "false": false,
        "missed": missed,
        "right": not false and not missed,
        "rivals": {e["name"]: [o["name"] for o in e["alternatives"]] for e in report["effects"]},
        "recurrence": {e["name"]: e["recurrence"] for e in report["effects"] + report["possible"]},
        "possible": [e["name"] for e in report["possible"]],
        "parameters": _parameters(sealed, report),
        "explained": _explained(_acting(case, sealed), report),
        "loudness": _loudness(report),
        "residual": report["residual"],
        "where": [where.get("channel", ""), where.get("regime", "")],
        "where_right": _excites(
            _acting(case, sealed), where.get("channel", ""), where.get("regime", "")
        ),
    }


def points_at(names: Iterable[str], channel: str) -> bool:
    """Whether one of these effects shows in a channel."""
    plain = channel.replace("_", " ")
    allowed = [name for hidden in names for name in CHANNELS[hidden]]
    return any(plain == name or plain.split(" ")[0] == name for name in allowed)


def _acting(case: Case, sealed: Sealed) -> set[str]:
    """What was hidden; a rotor's inertia hidden as crafts have it acts by both its torques."""
    acting = set(case.names)
    if acting & set(ROTOR_TORQUES):
        acting |= set(ROTOR_TORQUES) & set(sealed.present)
    return acting


def _excites(names: set[str], channel: str, regime: str) -> bool:
    """Whether one of the effects shows in a channel in that regime; outside the list, in any."""
    return any(
        points_at([name], channel) and (name not in REGIMES or regime in REGIMES[name])
        for name in names
    )


def _asked(case: Case, sealed: Sealed) -> set[str]:
    """Names that the search should find, were they large enough."""
    if case.plant == "faithful":
        return set(sealed.present)
    return _acting(case, sealed) & set(LISTED)


def _counted(case: Case, asked: set[str], wanted: set[str]) -> bool:
    hidden = {name for name in case.names if name not in OUTSIDE}
    if hidden & set(ROTOR_TORQUES) and len(case.names) == 1:
        return bool(wanted & set(ROTOR_TORQUES))
    return hidden <= wanted


def _parameters(sealed: Sealed, report: dict[str, Any]) -> list[dict[str, Any]]:
    """Every continuous parameter of a rightly named effect against the truth."""
    out, truths = [], _truths(sealed, _in_model(report))
    for effect in report["effects"]:
        truth = truths.get(effect["name"], {})
        for key, estimate in effect["parameters"].items():
            if key not in truth or key == "rotor" or estimate["stderr"] is None:
                continue
            error, stderr = estimate["value"] - truth[key], estimate["stderr"]
            out.append(
                {
                    "name": effect["name"],
                    "parameter": key,
                    "truth": truth[key],
                    "value": estimate["value"],
                    "stderr": stderr,
                    "inside": abs(error) <= INTERVAL * stderr,
                }
            )
    return out


def _in_model(report: dict[str, Any]) -> set[str]:
    """Effects that the improved model has: those that are named, and those too small for a name."""
    small = {one["name"] for one in report["candidates"] if one["refused_by"] == "negligible"}
    return small | {effect["name"] for effect in report["effects"]}


def _truths(sealed: Sealed, fitted: set[str]) -> dict[str, dict[str, float]]:
    """Parameters as they are beside what else is fitted: a lag of the gyro is then no part of the
    delay."""
    lag = sealed.also.get("gyro_low_pass")
    if lag is None or "gyro_low_pass" not in fitted:
        return sealed.present
    delay_s = sealed.present["dead_time"]["delay_s"] - 1.0 / (2.0 * math.pi * lag["bandwidth_hz"])
    return {**sealed.present, **sealed.also, "dead_time": {"delay_s": delay_s}}


def _explained(names: set[str], report: dict[str, Any]) -> float | None:
    """(before^2 - after^2) / (before^2 - floor^2) over the channels that were off."""
    gained = possible = 0.0
    for channel, gap in report["gap"]["channels"].items():
        before, after, floor = gap["before"], gap["after"], gap["noise_floor"]
        if not points_at(names, channel) or not floor or before < CLEAR * floor:
            continue
        gained += (before**2 - after**2) / floor**2
        possible += (before**2 - floor**2) / floor**2
    return gained / possible if possible else None


def _loudness(report: dict[str, Any]) -> float:
    """The worst channel's gap over its floor before anything was added."""
    ratios = [
        gap["before"] / gap["noise_floor"]
        for gap in report["gap"]["channels"].values()
        if gap["noise_floor"] and math.isfinite(gap["before"])
    ]
    return max(ratios, default=0.0)
