"""Findings of a search that never ran, beside real comparisons: for tests of reports."""

from groundstation.discrepancy.engine import Discrepancy
from groundstation.discrepancy.findings import (
    Alternative,
    Candidate,
    Findings,
    FoundEffect,
    Leftover,
    NotShown,
    Reason,
    Refusal,
    Verdict,
)
from groundstation.discrepancy.proof import Explained, Proof
from groundstation.discrepancy.report_json import discrepancy_report
from groundstation.dynamics.model import Estimate
from support.flights import BASE, MEDIUM, affected, hidden, judged

NAME = "velocity_moment"
IMPLAUSIBLE = Refusal(Reason.IMPLAUSIBLE, "not plausible")
INSIGNIFICANT = Refusal(Reason.INSIGNIFICANT, "not <significant>")


def findings(verdict=Verdict.EFFECTS_FOUND, residual=None):
    """One effect found, or none."""
    found = FoundEffect(
        NAME,
        1,
        {"moment": Estimate(15.0, 0.2, "rad/s^2 per m/s")},
        {"likelihood_ratio": 5000.0, "t": 60.0, "held_out": 2300.0},
        (Alternative("rate_damping", 9.0, "hover doublets"),),
        ("gyro_x", "gyro_y"),
        affected(NAME),
        gap_before=4.0,
        gap_after=1.0,
    )
    some = verdict is Verdict.EFFECTS_FOUND
    return Findings(
        verdict=verdict,
        effects=(found,) if some else (),
        base=BASE,
        given=BASE,
        moved=BASE,
        base_changes=(),
        model=affected(NAME) if some else BASE,
        candidates=(
            Candidate(NAME, {}, 5000.0, 60.0, 2300.0, some, None if some else IMPLAUSIBLE),
            Candidate("rate_damping", {}, 900.0, 20.0, 0.0, False, INSIGNIFICANT),
        ),
        not_shown=(NotShown("ground_effect", "gain", 2.0, 0.25, "", "take off and land"),),
        lost={"attitude_filter_lean": "attitude"},
        residual=residual or Leftover("white"),
        warnings=("motor assumed known by 2 %",),
    )


def proof(found):
    """The given model and the found one on a flight with the effect."""
    before = judged(effects=hidden(NAME, MEDIUM[NAME]))
    after = before.with_model(found.model)
    steps = [("given model", before.gap)]
    steps += [(one.name, after.beside(before)) for one in found.effects]
    explained = Explained(0.9, 0.0, 0.06, 0.04) if found.effects else None
    return Proof(before, after, before, after, (before, after), tuple(steps), explained)


def report(found, proven):
    """The report on them."""
    return discrepancy_report(
        Discrepancy(found, proven),
        recordings=["a.mcap"],
        validation=["b.mcap"],
        model="base.json",
        created_by="test",
    )
