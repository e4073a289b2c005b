"""What an operator, clients, radios, crafts and the machine do, in any order: after a stop nothing
that asks for motors reaches any craft, and "stopped" is said of motors that stand.

The commander, its stop, its lease and its outbox are the real ones, the crafts the software craft's
firmware; time is what the test says. ``SAFETY_STEPS`` says how many steps at least (a thousand).
"""

import asyncio
import contextlib
import os

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from groundstation.errors import GroundStationError
from groundstation.links.base import LinkState
from groundstation.links.command import LIFE_S
from groundstation.service.commander import WATCH_S, Commander
from groundstation.service.config import FailsafeConfig
from groundstation.service.freshness import STOOD_S
from groundstation.service.motor_stop import STOPPED
from support.worlds import World

STEPS = int(os.environ.get("SAFETY_STEPS", "1000"))
STEPS_EACH = 25
counted = {"steps": 0, "stops": 0, "stopped": 0, "thrust": 0, "arms": 0}


class AnyOrder(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        self.world = World()
        self.crafts = [
            self.world.craft("one:1", "brushless"),
            self.world.craft("other:2", "crazyflie21"),
        ]
        self.limits = FailsafeConfig()
        self.heard = self.crafts[0]  # whose telemetry comes in
        self.commander = Commander(
            self.heard,
            self.limits,
            note=self.take_note,
            telemetry=lambda: (LinkState.STREAMING, ""),
            motors=lambda link: link.motors() if link is self.heard else None,
            clock=self.world.time,
        )
        self.tokens, self.tasks = [], []
        self.stop_s = self.made_s = self.arm_asked_s = -1.0
        self.stamped = True
        self.seen = dict.fromkeys(self.crafts, 0)
        self.turning(0.3)

    def teardown(self):
        async def end():
            for task in self.tasks:
                task.cancel()
            await asyncio.gather(*self.tasks, return_exceptions=True)

        self.world.run_until_complete(end())
        self.world.close()

    # -- what is done, in any order ----------------------------------------------------------

    @rule(seconds=st.sampled_from([0.05, 0.1, 0.3, 0.7, 2.2]))
    def wait(self, seconds):
        self.turning(seconds)

    @rule()
    def second_client(self):
        self.try_it(lambda: self.tokens.append(self.commander.acquire("a client").token))

    @rule(thrust=st.sampled_from([20000, 45000]), count=st.integers(1, 6))
    def fly(self, thrust, count):
        self.second_client()
        self.setpoint(0, self.world.now_s)
        for _ in range(count):
            self.setpoint(thrust, self.world.now_s)
            self.turning(WATCH_S)

    @rule(age_s=st.sampled_from([0.1, 0.45, 0.55, 4.0]))
    def fly_late(self, age_s):
        self.setpoint(45000, self.world.now_s - age_s)

    @rule(stood_s=st.sampled_from([0.2, 0.45, 1.0, 4.0]), thrust=st.sampled_from([0, 45000]))
    def daemon_is_paused_while_a_client_says_its_last(self, stood_s, thrust):
        made_s = self.world.now_s
        self.world.pass_time(stood_s)
        self.setpoint(thrust, made_s, stamped=False)
        self.turning(WATCH_S)

    @rule()
    def arm(self):
        self.arm_asked_s = self.world.now_s
        self.start(self.commander.arm(True))

    @rule()
    def disarm(self):
        self.start(self.commander.arm(False))

    @rule(after_s=st.sampled_from([0.0, 0.05, 0.15, 0.5, 3.0]))
    def stop(self, after_s):
        self.start(self.pressed())
        self.turning(after_s)

    @rule()
    def second_client_stops_its_own(self):
        if self.tokens:
            self.start(self.commander.stop_own(self.tokens[0]))

    @rule(which=st.booleans())
    def link_is_lost(self, which):
        self.crafts[which].lose()

    @rule(which=st.booleans())
    def link_is_back(self, which):
        self.crafts[which].connect()

    @rule(which=st.booleans(), stalls=st.booleans())
    def radio_stalls(self, which, stalls):
        self.crafts[which].stalls = stalls

    @rule(which=st.booleans())
    def craft_restarts(self, which):
        self.crafts[which].switch_on()

    @rule()
    def link_is_switched(self):
        other = self.crafts[self.commander.link is self.crafts[0]]
        self.start(self.switched(other))
        self.turning(WATCH_S)

    # -- what holds after each of them -------------------------------------------------------

    @invariant()
    def nothing_moves_a_motor_that_may_not(self):
        counted["steps"] += 1
        for craft in self.crafts:
            for one in craft.delivered[self.seen[craft] :]:
                if one.kind == "setpoint" and one.value:
                    counted["thrust"] += 1
                    assert one.handed_s > self.stop_s, "thrust that was asked for before a stop"
                    # a pause too short to be noticed adds to the age of what had no stamp
                    unnoticed_s = 0.0 if self.stamped else STOOD_S
                    most_s = max(LIFE_S, self.limits.stop_s) + unnoticed_s + 2 * WATCH_S
                    assert one.at_s - self.made_s <= most_s, one.at_s - self.made_s
                elif one.kind == "arm" and one.value:
                    counted["arms"] += 1
                    assert self.arm_asked_s > self.stop_s, "armed after a stop"
            self.seen[craft] = len(craft.delivered)

    def take_note(self, kind, text):
        """Told at the moment at which a stop ends: of the only craft that was commanded."""
        if text.startswith("motors stopped"):
            counted["stopped"] += 1
            assert not self.commander.link.turns, "said to have stopped, and a rotor turns"

    # -- helpers -----------------------------------------------------------------------------

    async def pressed(self):
        link, asked_s = self.commander.link, self.world.now_s
        if link.state.value == "connected":
            self.stop_s = asked_s
            counted["stops"] += 1
        told = await self.commander.stop()
        if told == STOPPED and max(self.made_s, self.arm_asked_s) < asked_s:
            assert not link.turns, "said to have stopped, and a rotor turns"

    async def switched(self, other):
        await self.commander.leave()
        await self.commander.replace(other)
        self.heard = other
        other.connect()

    def setpoint(self, thrust, made_s, *, stamped=True):
        def send():
            before = self.commander.setpoints
            self.commander.setpoint(
                self.tokens[-1], 0.0, 0.0, 0.0, thrust, None, made_s if stamped else None
            )
            assert self.commander.setpoints == before + 1
            if thrust:
                self.made_s, self.stamped = made_s, stamped

        if self.tokens:
            self.try_it(send)

    def try_it(self, work):
        with contextlib.suppress(GroundStationError):
            work()

    def start(self, work):
        self.tasks.append(self.world.create_task(work))
        self.turning(0.001)

    def turning(self, seconds):
        async def turn():
            end_s = self.world.now_s + seconds
            while True:
                self.commander.turn(self.world.now_s)
                self.commander.look(self.world.now_s)
                left_s = end_s - self.world.now_s
                if left_s <= 1e-6:
                    return
                await asyncio.sleep(min(WATCH_S, left_s))

        self.world.run_until_complete(turn())
        for task in [task for task in self.tasks if task.done()]:
            self.tasks.remove(task)
            if not isinstance(task.exception(), GroundStationError):
                task.result()


def test_no_order_of_events_moves_a_motor_after_a_stop():
    run_state_machine_as_test(
        AnyOrder,
        settings=settings(
            max_examples=1 + STEPS * 5 // (STEPS_EACH * 4),  # some end before they have all steps
            stateful_step_count=STEPS_EACH,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        ),
    )
    print(", ".join(f"{value} {name}" for name, value in counted.items()))
    assert counted["steps"] >= STEPS
    assert min(counted.values()) > 0, f"something never happened: {counted}"
