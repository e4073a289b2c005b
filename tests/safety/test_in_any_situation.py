"""What people, programs, radios, crafts, disks and the machine do, in any order, to the installed
daemon, the official library and the real programs: after "stopped" no rotor turns unless a person
asks again, no former gains are lost, and whatever flies comes down as it should.

The crafts are in this process, and their truth is looked at after each of their steps of 10 ms.
``SAFETY_STEPS`` says how many steps at least, each time others (300, the same, some minutes).
"""

import os
import random
import signal
import tempfile
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

from support.situations import Situation, counted

USUAL = 300
STEPS = int(os.environ.get("SAFETY_STEPS", USUAL))
STEPS_EACH = 40
LET_FLY, LET_LAND = 0.35, 0.6
"""How often one on the floor is flown, and how often what is done to one in the air is given the
time to end in a landing."""
MUST_HAPPEN = (
    *("Stop", "Stop in the air", "Land", "Land in the air", "stopped", "flights", "landings"),
    *("fell", "leases", "client begun", "pid fly begun", "learn begun", "job begun"),
    *("daemon killed", "daemon ended", "restarted craft", "exchanged craft", "link lost"),
)
PROGRAMS = ("pid fly", "learn")


def twice(now, program):
    if not now.signal(signal.SIGINT, program):
        return False
    now.wait(0.3)
    now.signal(signal.SIGINT, program)
    return True


HAPPENS = {
    # what flies: again and again, for whatever else is done ends it
    "another client flies": lambda now: now.hover(0.0) and now.until_it_flies(),
    "a client flies": lambda now: now.hover(0.0) and now.until_it_flies(),
    "a client hovers later": lambda now: now.hover(1.5),
    "pid fly flies": lambda now: now.pid_fly(True, 110.0) and now.until_it_flies(),
    "pid fly with new gains flies": lambda now: now.pid_fly(False, 130.0) and now.until_it_flies(),
    "pid fly is begun": lambda now: now.pid_fly(True, 110.0),
    "learn flies": lambda now: now.learn() and now.until_it_flies(),
    "a job flies": lambda now: now.job() and now.until_it_flies(),
    "something takes off": Situation.until_it_flies,
    "a moment": lambda now: now.wait(0.2),
    "a while": lambda now: now.wait(1.5),
    # what people do
    "Stop": Situation.stop,
    "Stop again": Situation.stop,
    "Land": Situation.land,
    "Arm": Situation.arm,
    "a job is cancelled": Situation.cancel,
    **{f"Ctrl-C, {one}": lambda now, one=one: now.signal(signal.SIGINT, one) for one in PROGRAMS},
    **{f"Ctrl-C twice, {one}": lambda now, one=one: twice(now, one) for one in PROGRAMS},
    **{f"SIGTERM, {one}": lambda now, one=one: now.signal(signal.SIGTERM, one) for one in PROGRAMS},
    # what a client does
    **{f"client: {how}": lambda now, how=how: now.client(how)
       for how in ("release", "land", "stop", "dies")},
    "client writes": lambda now: now.client("write", value=115.0),
    "client writes that": lambda now: now.client("write", value=125.0),
    "client is silent for 0.3 s": lambda now: now.client("silent", seconds=0.3),
    "client is silent for 1.0 s": lambda now: now.client("silent", seconds=1.0),
    # what machines do
    **{f"SIGKILL, {one}": lambda now, one=one: now.signal(signal.SIGKILL, one) for one in PROGRAMS},
    **{f"{one} stands still for {s} s": lambda now, one=one, s=s: now.hold(one, s)
       for one in PROGRAMS for s in (0.3, 1.0)},
    **{f"daemon stands still for {s} s": lambda now, s=s: now.hold_daemon(s) for s in (0.3, 2.5)},
    "daemon is killed": lambda now: now.end_daemon(signal.SIGKILL),
    "daemon is ended": lambda now: now.end_daemon(signal.SIGTERM),
    "daemon is begun": Situation.begin_daemon,
    **{f"link is lost for {s} s": lambda now, s=s: now.stall(s) for s in (0.3, 1.2, 3.0)},
    "craft is switched off and on": Situation.restart,
    "craft is exchanged": Situation.exchange,
    "battery is low": Situation.drain,
    "disk is full": Situation.fill_disk,
}  # fmt: skip
"""By what it is called; what it says: whether there was anything to do it to."""
TAKES_OFF = {"a client flies": 12, "another client flies": 12, "pid fly flies": 3,
             "pid fly with new gains flies": 3, "learn flies": 1, "a job flies": 1}  # fmt: skip
LANDS = (
    *("Land", "client: release", "client: land", "client: dies", "client is silent for 1.0 s"),
    *(f"{how}, {one}" for one in PROGRAMS for how in ("Ctrl-C", "SIGTERM", "SIGKILL")),
    *(f"{one} stands still for 1.0 s" for one in PROGRAMS),
    *("a job is cancelled", "daemon is ended", "disk is full", "battery is low"),
)
"""What a landing follows, where nothing else is done until then."""
USUALLY = 4
WEIGHTS = {
    **{
        "learn flies": 1,
        "a job flies": 1,
        "pid fly flies": 2,
        "pid fly with new gains flies": 2,
    },
    **{"link is lost for 0.3 s": 2, "link is lost for 1.2 s": 2, "disk is full": 2},
    **{"craft is exchanged": 2, "craft is switched off and on": 2, "link is lost for 3.0 s": 2},
    **{"something takes off": 2, "a while": 2, "Land": 8},
}
"""How often it is chosen, where not usually: some of it takes many seconds."""


class AnySituation(RuleBasedStateMachine):
    """What happens is chosen whatever has happened: that takes its own time, and is never the same
    twice."""

    def __init__(self):
        super().__init__()
        self.situation, self._ends = None, ExitStack()

    @initialize(
        vehicle=st.sampled_from(["crazyflie21", "crazyflie21", "brushless"]),
        seed=st.integers(0, 2**32 - 1),
    )
    def begin(self, vehicle, seed):
        # hypothesis takes 0 again and again
        self.random = random.Random(f"{seed} {counted['machines']}")
        if counted["steps"] < STEPS:
            counted["machines"] += 1
            folder = Path(self._ends.enter_context(tempfile.TemporaryDirectory()))
            self.situation = Situation(folder, vehicle, counted["machines"])
            self._ends.push(self.situation)
            self.situation.__enter__()

    def teardown(self):
        with self._ends:
            if self.situation is not None:
                self.require(self.situation.end())

    @rule()
    def step(self):
        """Chosen by the machine's seed: of many rules, and of the values of one, hypothesis leaves
        out half and repeats some."""
        done, now = False, self.situation
        if now is None or counted["steps"] >= STEPS:
            return
        flies, lands = now.craft.truth.flies, False
        if flies and self.random.random() < LET_LAND:
            lands, weights = True, dict.fromkeys(LANDS, 1)
        elif not flies and self.random.random() < LET_FLY:
            weights = TAKES_OFF
        else:
            weights = {what: WEIGHTS.get(what, USUALLY) for what in HAPPENS}
        while not done:
            (what,) = self.random.choices(list(weights), list(weights.values()))
            now.say(f"- {what}")
            done = HAPPENS[what](now)
            if not done:
                weights = {**weights, what: 0, "Stop": 1}
        counted["steps"] += 1 + what.endswith("flies")
        if lands:
            now.until_it_is_down()
        self.require(now.faults())

    def require(self, faults):
        told = "\n  ".join(["", *faults, "after", *self.situation.said])
        assert not faults, told


@pytest.mark.timeout(900 + 3 * STEPS)
def test_no_situation_moves_a_motor_after_a_stop_loses_gains_or_drops_what_should_land():
    run_state_machine_as_test(
        AnySituation,
        settings=settings(
            max_examples=1 + STEPS // 4,  # what comes when there were enough steps takes no time
            stateful_step_count=STEPS_EACH,
            phases=[Phase.generate],  # no second time is the same
            report_multiple_bugs=False,
            derandomize=STEPS == USUAL,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        ),
    )
    print(", ".join(f"{value} {name}" for name, value in sorted(counted.items())))
    assert counted["steps"] >= STEPS
    never = [one for one in MUST_HAPPEN if not (counted[one] or counted[f"{one} in the air"])]
    assert not never, f"something never happened: {never}"
    assert counted["landings"] > max(counted["not judged"], STEPS // 50)
