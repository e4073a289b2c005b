"""Findings of a search that never ran, beside real comparisons: for tests of reports."""

import functools

from groundstation.comparison.gap import FURTHER_EVERY_S
from groundstation.discrepancy.engine import Discrepancy
from groundstation.discrepancy.proof import (
    Alternative,
    Candidate,
    Explained,
    Findings,
    FoundEffect,
    Leftover,
    NotShown,
    Proof,
    Reason,
    Refusal,
    Verdict,
)
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
        recurrence=0.97,
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


@functools.cache
def _given():
    """The given model on a flight with the effect, near and further ahead."""
    before = judged(effects=hidden(NAME, MEDIUM[NAME]))
    return before, before.further()


def _with(model):
    """The same of another model."""
    before, far = _given()
    return before.with_model(model), far.with_model(model, FURTHER_EVERY_S)


def proof(found):
    """What predictions say of these findings."""
    before, far = _given()
    after, ahead = _with(found.model) if found.effects else _given()
    steps = [("given model", before.gap)]
    steps += [(one.name, after.beside(before)) for one in found.effects]
    explained = Explained(0.9, 0.0, 0.06, 0.04) if found.effects else None
    pair = before, after
    return Proof(*pair, *pair, pair, (far, ahead), tuple(steps), explained)


def report(found, proven):
    """The report on them."""
    return discrepancy_report(
        Discrepancy(found, proven),
        recordings=["a.mcap"],
        validation=["b.mcap"],
        model="base.json",
        created_by="test",
    )
