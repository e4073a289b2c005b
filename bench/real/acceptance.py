"""What flights of a set must show, a line each: passed or not, and the number behind it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

Case = Mapping[str, Any]
Line = tuple[bool, str]

CONSTANTS = ("c0", "c1", "c2")
OFF, APART, THRUST_APART = 0.25, 0.10, 0.01
"""From the reference made apart, between disjoint splits, and of thrust_per_mass between these."""
INSIDE = 0.9
"""Share of the pairs of constants that agree within their stated 95 %."""
EXPLAINED = {True: 0.90, False: 0.75}
"""Of held-out rates from 4 to 18 Hz, with recorded rotor speeds and from PWM."""
AHEAD = {"roll": 60.0, "pitch": 60.0, "yaw": 80.0}
"""Fit in % of held-out rates 50 ms ahead."""
GAP = 2.0
WORSE = 1.02
SPIN_UP = "rotor_acceleration_torque"
SPIN_UP_KG_M2 = (2e-8, 9e-8)
EXPECTED = {"brushless": (SPIN_UP, "velocity_moment"), "brushed": (SPIN_UP,)}
NEVER = {"brushless": ("motor_braking_asymmetry", "attitude_filter_lean")}
HEAVIER_PERCENT = (14.0, 20.0)


def constants(label: str, case: Case, reference: Case) -> Iterator[Line]:
    """c0 and c1 of one split beside the reference."""
    for axis, name in (("roll", "c0"), ("pitch", "c1")):
        ratio = case["constants"][name] * reference["per_constant"] / reference[axis]["gain"]
        yield (
            abs(ratio - 1.0) <= OFF,
            f"{label}: {name} is {ratio:.2f} of the reference ({1 - OFF:g}..{1 + OFF:g})",
        )


def predictions(
    label: str, case: Case, explained: Mapping[str, float], measured: bool
) -> Iterator[Line]:
    """Held-out rates of one split: what is explained from 4 to 18 Hz, and 50 ms ahead."""
    for axis, share in explained.items():
        least = EXPLAINED[measured]
        yield (
            share >= least,
            f"{label}: {axis} explained from 4 to 18 Hz {share:.2f} (at least {least:g})",
        )
    for axis, least in AHEAD.items():
        fit = case["validation"].get(f"gyro_{axis}_fit_percent_50ms", float("nan"))
        yield fit >= least, f"{label}: {axis} 50 ms ahead {fit:.0f} % (at least {least:g})"


def agreement(label: str, cases: Sequence[Case]) -> Iterator[Line]:
    """Constants of splits that share no flight."""
    if len(cases) < 2:
        return
    limits = {"c0": APART, "c1": APART, "thrust_per_mass": THRUST_APART}
    for name, most in limits.items():
        values = [case["constants"][name] for case in cases]
        apart = max(values) / min(values) - 1.0
        yield (
            apart <= most,
            f"{label}: {name} of disjoint flights {100 * apart:.1f} % apart"
            f" (at most {100 * most:g})",
        )
    inside = [
        abs(one["constants"][name] - other["constants"][name])
        <= 1.96 * (one["stderr"][name] ** 2 + other["stderr"][name] ** 2) ** 0.5
        for one, other in itertools.combinations(cases, 2)
        for name in CONSTANTS
        if one["stderr"][name] and other["stderr"][name]
    ]
    if inside:
        yield (
            sum(inside) >= INSIDE * len(inside),
            f"{label}: {sum(inside)} of {len(inside)} pairs within their 95 % ({100 * INSIDE:g} %)",
        )


def findings(label: str, flown: str, found: Case) -> Iterator[Line]:
    """What ``discrepancy`` says of one split. flown: the set."""
    after = found["gap"]["after"]
    yield after <= GAP, f"{label}: gap after naming {after:.2f} (at most {GAP:g})"
    channels = found["channels"]
    worse = [name for name, one in channels.items() if one["after"] > WORSE * one["before"]]
    yield not worse, f"{label}: worse channels: {', '.join(worse) or 'none'}"
    yield bool(found["where"]) or after <= 1.0, f"{label}: what is left is located"
    for name in EXPECTED.get(flown, ()):
        yield name in found["effects"], f"{label}: {name} is named"
    if SPIN_UP in found["effects"] and flown in EXPECTED:
        ((value),) = (one["value"] for one in found["effects"][SPIN_UP].values())
        low, high = SPIN_UP_KG_M2
        yield low <= value <= high, f"{label}: {SPIN_UP} {value:.2g} kg m^2 ({low:g}..{high:g})"
    for name in NEVER.get(flown, ()):
        yield name not in found["effects"], f"{label}: {name} is not named"


def payload(found: Case, without: Case) -> Iterator[Line]:
    """The load on a cable. without: what is named on the craft's own flights."""
    percent = found["effects"].get("mass_change", {}).get("percent", {}).get("value", float("nan"))
    low, high = HEAVIER_PERCENT
    yield low <= percent <= high, f"payload: mass_change {percent:.1f} % ({low:g}..{high:g})"
    new = set(found["effects"]) - set(without["effects"]) - {"mass_change", "slung_load"}
    yield not new, f"payload: other new names: {', '.join(sorted(new)) or 'none'}"
