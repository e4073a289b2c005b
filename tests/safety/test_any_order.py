"""What an operator, clients, radios, crafts and the machine do, in any order: after a stop nothing
that asks for motors reaches any craft, "stopped" is said of motors that stand, nothing is stored on
a craft whose motors turn, and no former gains are lost.

The commander, its stop, its lease and its outbox are the real ones, the crafts the software craft's
firmware; time is what the test says. ``SAFETY_STEPS`` says how many steps at least (a thousand).
"""

import asyncio
import contextlib
import os
import tempfile
from pathlib import Path

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from firmware_sim.contents import CLEAR, STORE
from groundstation.errors import GroundStationError
from groundstation.links.command import LIFE_S, LONGEST_S
from groundstation.service.commander import STOOD_S, WATCH_S
from groundstation.service.lease import LANDED, STOPPED
from support.worlds import GAINS, World

STEPS = int(os.environ.get("SAFETY_STEPS", "1000"))
STEPS_EACH = 25
HEIGHT_M, TRIED, RESTORED_S = 0.4, 180.0, 12.0
NAMES = ("steps", "stops", "stopped", "lands", "landed", "thrust", "heights", "arms", "refused",
         "written", "restored", "stored", "cleared")  # fmt: skip
counted = dict.fromkeys(NAMES, 0)


class AnyOrder(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        self.world = World()
        self.crafts = [
            self.world.craft("one:1", "brushless", "flow_deck"),
            self.world.craft("other:2", "crazyflie21", "flow_deck"),
        ]
        self.heard = self.crafts[0]  # whose telemetry comes in
        self.folder = tempfile.TemporaryDirectory()
        self.commander = self.world.commander(
            self.heard,
            Path(self.folder.name) / "changed.json",
            self.take_note,
            lambda link: link.motors() if link is self.heard else None,
        )
        self.limits = self.commander.limits
        self.tokens, self.tasks = [], []
        self.restoring = self.world.create_task(self.commander.keep_restored())
        self.count = self.commander.operator.stops  # when somebody's program began
        self.gains = {craft: {self.gain(craft)} for craft in self.crafts}
        self.has_written = set()
        self.stop_s = self.made_s = self.arm_asked_s = -1.0
        self.stamped = True
        self.seen = dict.fromkeys(self.crafts, 0)
        self.turning(0.3)

    def teardown(self):
        try:
            self.require_former_gains()
        finally:
            self.close()

    def close(self):
        async def end():
            self.restoring.cancel()
            for task in [self.restoring, *self.tasks]:
                task.cancel()
            await asyncio.gather(self.restoring, *self.tasks, return_exceptions=True)

        self.world.run_until_complete(end())
        self.world.close()
        self.folder.cleanup()

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

    @rule(count=st.integers(1, 12), hovers=st.booleans())
    def fly_at_a_height(self, count, hovers):
        self.second_client()
        for _ in range(count):
            self.setpoint(0, self.world.now_s, height_m=HEIGHT_M, hovers=hovers)
            self.turning(WATCH_S)

    @rule()
    def a_program_begins(self):
        self.count = self.commander.operator.stops

    @rule()
    def it_wants_to_command(self):
        stopped_since = self.count != self.commander.operator.stops
        try:
            self.tokens.append(self.commander.acquire("a program", self.count).token)
        except GroundStationError:
            counted["refused"] += stopped_since
        else:
            assert not stopped_since, "the motors were stopped since it began"

    @rule(value=st.sampled_from([TRIED, TRIED + 10.0]))
    def a_client_writes(self, value):
        self.second_client()
        if self.tokens:
            self.start(self.written(value))
            self.turning(2 * WATCH_S)

    @rule(clears=st.booleans(), after_s=st.sampled_from([0.0, 0.2, 2.0]))
    def a_client_stores(self, clears, after_s):
        if self.tokens:
            self.start(self.stored(clears))
            self.turning(after_s)

    @rule()
    def a_client_releases(self):
        def release():
            self.commander.release(self.tokens[-1])
            craft = self.commander.link
            self.gains[craft] = {self.gain(craft)}

        if self.tokens:
            self.try_it(release)

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
        self.start(self.commander.operator.arm(True))

    @rule()
    def disarm(self):
        self.start(self.commander.operator.arm(False))

    @rule(after_s=st.sampled_from([0.0, 0.05, 0.15, 0.5, 3.0]))
    def stop(self, after_s):
        self.start(self.pressed())
        self.turning(after_s)

    @rule(after_s=st.sampled_from([0.0, 0.5, 3.0]))
    def land(self, after_s):
        self.start(self.landed())
        self.turning(after_s)

    @rule()
    def second_client_has_its_craft_landed(self):
        if self.tokens:
            self.start(self.commander.land_own(self.tokens[-1]))

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
        craft = self.crafts[which]
        craft.switch_on()
        # where a store was not confirmed, what it loads is written back
        self.gains[craft] = {self.gain(craft)} | (self.gains[craft] if craft.stored else set())

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
                if one.flies:
                    counted["thrust" if one.value else "heights"] += 1
                    assert one.handed_s > self.stop_s, "thrust that was asked for before a stop"
                    # a pause too short to be noticed adds to the age of what had no stamp
                    unnoticed_s = 0.0 if self.stamped else STOOD_S
                    most_s = max(LIFE_S, self.limits.stop_s) + unnoticed_s + 2 * WATCH_S
                    lands_s = 0.0 if one.value else LONGEST_S
                    assert one.at_s - self.made_s <= most_s + lands_s, one.at_s - self.made_s
                elif one.kind == "arm" and one.value:
                    counted["arms"] += 1
                    assert self.arm_asked_s > self.stop_s, "armed after a stop"
            self.seen[craft] = len(craft.delivered)
            for command, turned in craft.asked:
                assert not (turned and command in (STORE, CLEAR)), "stored while a rotor turned"
            craft.asked.clear()

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
        told = await self.commander.operator.stop()
        if told == STOPPED and max(self.made_s, self.arm_asked_s) < asked_s:
            assert not link.turns, "said to have stopped, and a rotor turns"

    async def landed(self):
        counted["lands"] += 1
        counted["landed"] += await self.commander.operator.land() == LANDED

    async def written(self, value):
        craft = self.commander.link
        self.has_written.add(craft)
        before = self.gain(craft)
        await self.commander.write_parameters(self.tokens[-1], {GAINS[0]: value})
        counted["written"] += before != value

    async def stored(self, clears):
        craft, keeps = self.commander.link, self.commander.stored
        await (keeps.clear if clears else keeps.store)(self.tokens[-1], [GAINS[0]])
        counted["cleared" if clears else "stored"] += 1
        if not clears:
            self.gains[craft] = {self.gain(craft)}

    def gain(self, craft):
        return craft.craft.get_parameter(GAINS[0])

    def require_former_gains(self):
        """Everything is over, and each craft in reach for a while."""
        written = [craft for craft in self.crafts if craft in self.has_written]
        for craft in written:
            craft.stalls = False
            craft.craft.arm(False)  # one whose motors idle does not stand
        if written:
            self.turning(RESTORED_S)
        for other in written:
            if self.commander.link is not other:
                self.world.run_until_complete(self.switched(other))
            other.connect()
            self.turning(RESTORED_S)
            counted["restored"] += bool(self.commander.written.restored(other))
            assert self.gain(other) in self.gains[other], "former gains are lost"

    async def switched(self, other):
        await self.commander.leave()
        await self.commander.replace(other)
        self.heard = other
        other.connect()

    def setpoint(self, thrust, made_s, *, stamped=True, height_m=None, hovers=False):
        def send():
            before = self.commander.setpoints
            self.commander.setpoint(
                self.tokens[-1], 0.0, 0.0, 0.0, thrust, height_m, made_s if stamped else None,
                *((0.0, 0.0) if hovers else ()),
            )  # fmt: skip
            assert self.commander.setpoints == before + 1
            if thrust or height_m is not None:
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
