"""A daemon, crafts whose truth is seen, a radio between them, and all that people, programs and
machines do to them: each a method, which says whether there was anything to do it to.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from firmware_sim.craft import CraftState, StandIn
from firmware_sim.physics import PARAMETER_NAMES
from firmware_sim.settings import StandInSettings
from firmware_sim.supervisor import CRASHED, LOCKED
from groundstation.errors import GroundStationError
from groundstation.service.client import Pilot, ask
from groundstation.service.lease import STOPPED
from support.crafts import NarrowRadio, ServedCraft
from support.daemons import COMMAND, Daemon
from support.programs import Program, run_program
from support.waiting import HELD_UP_S, PATIENCE_S, Watch, until

AIR_M, FLOOR_M = 0.05, 0.01
"""Higher than the first it flies, lower than the second after it, it has touched down."""
TESTED_MS = 4000
"""The firmware tests its motors when it is switched on: each turns for a moment."""
BEFORE_S = 0.1
"""The speed at a touch-down is the largest of so long before it: the floor has changed the last."""


@dataclass(slots=True)
class Flight:
    """From the floor to the floor. begun_s: when its rotors began, of the monotonic clock.
    sink_m_s, aside_m_s: down and sideways at the touch-down. ended_s: when that was, or 0."""

    begun_s: float
    highest_m: float = 0.0
    sink_m_s: float = 0.0
    aside_m_s: float = 0.0
    ended_s: float = 0.0


@dataclass(slots=True)
class Truth:
    """quiet_since_s: a person was told so that the motors stand, and nobody asked for them since;
    None: somebody may. faults: what should never have been."""

    flights: list[Flight] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    turns: bool = False
    height_m: float = 0.0
    turned: int = 0
    quiet_since_s: float | None = None
    _rotors_s: float = 0.0
    _before: list[CraftState] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def of(self, served: ServedCraft) -> Truth:
        """Look at this one from now on."""
        self._before.clear()
        if self.flights and not self.flights[-1].ended_s:
            self.flights.pop()  # another craft: nobody sees the end of that flight
        self.turns, self.height_m = False, 0.0
        served.each_step = lambda: self._look(served.craft.state())
        return self

    @property
    def flies(self) -> bool:
        return bool(self.flights) and not self.flights[-1].ended_s

    def be_quiet(self) -> None:
        """The motors were said to stand."""
        with self._lock:
            self.quiet_since_s = time.monotonic()

    def may_turn(self) -> None:
        """A person asks for something that may turn the rotors."""
        with self._lock:
            self.quiet_since_s = None

    def _look(self, state: CraftState) -> None:
        now_s, turns = time.monotonic(), any(state.motors) and state.uptime_ms > TESTED_MS
        with self._lock:
            if turns and not self.turns:
                self._rotors_s = now_s
                self.turned += 1
            if turns and self.quiet_since_s is not None:
                after_s = now_s - self.quiet_since_s
                self.faults.append(f"rotors turn {after_s:.2f} s after they were said to stand")
                self.quiet_since_s = None
        self.turns, self.height_m = turns, state.position_m[2]
        self._before.append(state)
        while state.time_s - self._before[0].time_s > BEFORE_S:
            self._before.pop(0)
        self._follow(now_s)

    def _follow(self, now_s: float) -> None:
        if not self.flies:
            if self.height_m > AIR_M:
                self.flights.append(Flight(self._rotors_s))
            return
        flight = self.flights[-1]
        flight.highest_m = max(flight.highest_m, self.height_m)
        if self.height_m < FLOOR_M:
            last = min(self._before, key=lambda one: one.velocity_m_s[2])
            ahead, left, up = last.velocity_m_s
            flight.sink_m_s, flight.aside_m_s = -up, (ahead**2 + left**2) ** 0.5
            flight.ended_s = now_s


class Craft:
    """One with a Flow deck, and its truth. gains: name -> what it may have when all is over."""

    def __init__(self, vehicle: str, seed: int) -> None:
        self.vehicle = vehicle
        self._settings = StandInSettings(
            craft=vehicle, plant="reduced", flow_deck=True, program="wait", resume_s=1e6,
            recharge_s=1e6, seed=seed,
        )  # fmt: skip
        self.truth = Truth()
        self.served: ServedCraft | None = None
        self.switched = 0
        self.gains: dict[str, set[float]] = {}

    def switch_on(self, booted: bool = False) -> None:
        """Off before, where it is on; what it was told is forgotten. booted: long ago."""
        self.switch_off()
        craft = StandIn(self._settings)
        craft.advance(3.0 if booted else 0.0)
        self.gains = {name: {craft.get_parameter(name)} for name in PARAMETER_NAMES}
        self.served = ServedCraft(craft)
        self.truth.of(self.served)
        self.served.start()
        self.switched += 1

    def switch_off(self) -> None:
        if self.served is not None:
            self.served.stop()
            self.served = None

    @property
    def craft(self) -> StandIn:
        assert self.served is not None
        return self.served.craft

    def drain(self) -> None:
        """Its cell is nearly empty from now on: no command does that."""
        with self.craft._lock:
            self.craft._state[0]["charge"] = 0.04


HEIGHT_M, HOVERS_HZ, CLIMB_M_S = 0.3, 50, 0.4


class Hovering(threading.Thread):
    """A client of this process, who holds a height until it is ended.

    stops: the count that it was begun with. after_s: when it asks for the lease. ends: how, of
    release, land, stop and dies. silent_s: it says nothing for so long. write: parameters, next.
    """

    def __init__(self, socket: Path, name: str, stops: int, after_s: float) -> None:
        super().__init__(name=name)
        self.ends, self.silent_s = "", 0.0
        self.write: dict[str, float] = {}
        self.written: dict[str, float] = {}
        self.settled = self.unsure = False
        self._socket, self._stops, self._after_s = socket, stops, after_s
        self._wakes = threading.Event()
        self.start()

    def end(self, how: str) -> None:
        self.ends = how
        self._wakes.set()

    def run(self) -> None:
        self._wakes.wait(self._after_s)
        pilot = Pilot(self._socket, self.name, self._stops)
        with contextlib.suppress(GroundStationError):
            pilot.__enter__()
            begun_s = time.monotonic()
            while not self.ends:
                height_m = min(HEIGHT_M, CLIMB_M_S * (time.monotonic() - begun_s))
                pilot.setpoint(0.0, 0.0, 0.0, height_m=height_m, vx_m_s=0.0, vy_m_s=0.0)
                values, self.write = self.write, {}
                if values:
                    self.written |= values
                    pilot.write(values)
                silent_s, self.silent_s = self.silent_s, 0.0
                self._wakes.wait(max(silent_s, 1.0 / HOVERS_HZ))
            if self.ends == "stop":
                pilot.stop()
            elif self.ends == "land":
                pilot.land()
            if self.ends != "dies":
                self.unsure = True
                pilot.release()
                self.settled = True
        pilot.close()


class Begun:
    """Somebody or something that a person began. begun_ns: when. signals: what was sent to it.
    settles: parameters that it leaves where it ends well. unsure: it may have left them."""

    def __init__(self, kind: str, what: Program | Hovering | str, craft: Craft) -> None:
        self.kind, self.what, self.craft = kind, what, craft
        self.name = what.name if isinstance(what, Hovering) else kind
        self.begun_ns = time.time_ns()
        self.signals: list[int] = []
        self.settles: dict[str, float] = {}
        self.unsure = False
        self._switched, self._flights = craft.switched, len(craft.truth.flights)

    def ended(self, jobs: Callable[[], dict[str, str]]) -> bool:
        """jobs: state of each, by id."""
        if isinstance(self.what, Hovering):
            return not self.what.is_alive()
        if isinstance(self.what, Program):
            return self.what.poll() is not None
        return jobs().get(self.what) not in ("waiting", "running")

    def signal(self, number: int) -> None:
        assert isinstance(self.what, Program)
        truth = self.craft.truth
        # one that has flown may have left what it had to before it hears of this
        self.unsure |= len(truth.flights) > self._flights and not truth.flies
        self.signals.append(number)
        self.what.send_signal(number)

    def settle(self) -> None:
        """What it has left is what the craft may have."""
        left, sure = self.settles, False
        if isinstance(self.what, Hovering):
            left, sure = self.what.written, self.what.settled
            self.unsure = self.what.unsure
        elif isinstance(self.what, Program):
            sure = self.what.returncode == 0
        if self.craft.switched != self._switched:
            return  # whatever it left was forgotten
        for name, value in left.items():
            if sure:
                self.craft.gains[name] = {value}
            elif self.unsure:
                self.craft.gains[name] |= {value}

    def kill(self) -> None:
        """Whatever it does."""
        if isinstance(self.what, Hovering):
            self.what.end("dies")
            self.what.join()
        elif isinstance(self.what, Program):
            self.what.end()


@contextlib.contextmanager
def held(pid: int) -> Iterator[None]:
    """It stands still meanwhile."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)


BY_OPERATOR = "the operator "
"""How the event of a Stop and of a Land begins; a client's own is none."""
SINK_M_S = 0.8
"""A landing goes down with 0.3 m/s; falling from the height that is flown here ends at 2.4 m/s."""
READS_S = 1.0
"""Python itself takes so long to start on a busy machine: until then a program was not begun."""
DONE_BEFORE_S = 1.0
"""What ends a flight may have been done so long before its rotors began."""
counted: Counter[str] = Counter()
"""How often it happened, of all there was."""


class Witness:
    """crafts: whose truth is looked at. craft: the one in reach. said: what was done, in order.
    hard: when what may drop a craft was done, and what. begun: who may have asked for the lease.
    heard_ns: the newest event that was looked at. steers: process ids of what must not stand still
    for a flight to be landed, beside this one, which is the craft."""

    def __init__(self, crafts: list[Craft], steers: Callable[[], list[int]]) -> None:
        self.begun_s = time.monotonic()
        self.crafts, self.craft = crafts, crafts[0]
        self.said: list[str] = []
        self.hard: list[tuple[float, str]] = []
        self.begun: list[Begun] = []
        self.heard_ns = 0
        self.watch = Watch(lambda: [os.getpid(), *steers()])
        self.watch.__enter__()
        self._judged = dict.fromkeys(map(id, crafts), 0)

    def say(self, text: str) -> None:
        self.said.append(f"{time.monotonic() - self.begun_s:6.2f} s  {text}")

    def drops(self, what: str) -> None:
        """Whatever flies now may fall."""
        self.hard.append((time.monotonic(), what))
        self._count(what)

    def soft(self, what: str) -> None:
        """Whatever flies now lands."""
        self._count(what)

    def _count(self, what: str) -> None:
        where = " in the air" if self.craft.truth.flies else ""
        self.say(what + where)
        counted[f"{what.partition(' for ')[0]}{where}"] += 1

    def of_flights(self) -> list[str]:
        """What was wrong with rotors, and with the touch-downs that were not looked at yet."""
        found = []
        for craft in self.crafts:
            found += craft.truth.faults
            for flight in craft.truth.flights[self._judged[id(craft)] :]:
                if flight.ended_s:
                    self._judged[id(craft)] += 1
                    found += self._judge(flight)
        return found

    def _judge(self, flight: Flight) -> list[str]:
        counted["flights"] += 1
        begun_s = flight.begun_s - DONE_BEFORE_S
        hard = [what for at_s, what in self.hard if begun_s <= at_s <= flight.ended_s]
        self.say(f"met the floor with {flight.sink_m_s:.2f} m/s from {flight.highest_m:.2f} m")
        if hard:
            counted["may fall"] += 1
            counted["fell"] += flight.sink_m_s > SINK_M_S
            return []
        if flight.sink_m_s > SINK_M_S:
            held_s, who = self.watch.longest()
            if held_s >= HELD_UP_S:
                self.say(f"not judged: the machine held {who} up for {held_s:.2f} s")
                counted["not judged"] += 1
                return []
            return [f"dropped: met the floor with {flight.sink_m_s:.2f} m/s"]
        counted["landings"] += 1
        return []

    def of_leases(self, events: list[dict]) -> list[str]:
        """Whoever got the lease after a stop was begun after it."""
        found, stop_ns = [], 0
        for event in events:
            if event["kind"] == "stop" and event["text"].startswith(BY_OPERATOR):
                stop_ns = event["time_ns"]
            who, commands, _ = event["text"].partition(" commands now")
            if not commands or event["time_ns"] <= self.heard_ns:
                continue
            self.heard_ns = event["time_ns"]
            counted["leases"] += 1
            kinds = {"learn": ("learn", "job")}.get(who, (who,))
            last_ns = max((one.begun_ns for one in self.begun if one.name in kinds), default=0)
            if last_ns < stop_ns - READS_S * 1e9:
                after_s = (event["time_ns"] - stop_ns) * 1e-9
                found.append(f"{who} got the lease {after_s:.2f} s after a stop")
        return found


GAIN = "pid_rate.yaw_kp"
LANDED = "landed"
TAKES_OFF_S = 25.0
"""`learn` waits for a craft that stands still, and counts down."""
LANDS_S = 7.0
"""A landing of 6 s, behind the failsafe's limits."""
REST_V = 3.6
"""A cell with less is changed before a program is begun."""
OFF_S = 2.5
"""A craft that is put in the place of another one has been out of reach for so long: its
connection is lost."""
DISK = "24m"
QUICK = ("--axis", "yaw", "--repeat", "1", "--hold", "0.3", "--rest", "0.2", "--yaw-rate", "30",
         "--thrust", f"height:{HEIGHT_M}", "--yes")  # fmt: skip


class Situation(Witness):
    """programs: what has not ended. disk: a small file system, or None."""

    def __init__(self, folder: Path, vehicle: str, seed: int) -> None:
        self.folder = folder
        other = "brushless" if vehicle == "crazyflie21" else "crazyflie21"
        self.daemon: Daemon | None = None
        self.programs: list[Begun] = []
        super().__init__([Craft(vehicle, seed), Craft(other, seed + 1)], self._processes)
        self._number, self.changed_s = 0, 0.0
        self.disk = small_disk(folder / "disk")
        self.craft.switch_on(booted=True)
        self.radio = NarrowRadio(self._port(), 1e9)
        self.radio.start()

    def __enter__(self) -> Situation:
        self.begin_daemon()
        self.set_right()
        return self

    # -- the daemon ---------------------------------------------------------------------------

    @property
    def socket(self) -> Path:
        return self.folder / "control.sock"

    def asked(self, method: str, route: str, body: dict | None = None) -> dict | None:
        """Its answer; None where it refuses or is not there."""
        try:
            return ask(self.socket, method, route, body)
        except GroundStationError as error:
            self.say(f"{route} refused: {error}")
            return None

    def begin_daemon(self) -> bool:
        if self.daemon is not None:
            return False
        self.heard_ns = 0
        self.daemon = Daemon(
            self.folder, "--link", self.radio.uri, "--recordings", self.disk or "sessions",
            *("--set", "recording.low_space_mb=1", "--viewer", "off"),
            socket_path=self.socket,
            environment={"XDG_STATE_HOME": str(self.folder / "state")},
        )  # fmt: skip
        return True

    def end_daemon(self, number: int) -> bool:
        """SIGKILL drops what flies, the others let it be landed first."""
        daemon, self.daemon = self.daemon, None
        if daemon is None:
            return False
        if number == signal.SIGKILL:
            self.drops("daemon killed")
        self.soft("daemon ended")
        daemon.process.send_signal(number)
        daemon.wait()
        daemon.process.end()
        return True

    def hold_daemon(self, seconds: float) -> bool:
        if self.daemon is None:
            return False
        self.drops(f"daemon held for {seconds} s")
        with held(self.daemon.process.pid):
            time.sleep(seconds)
        self.drops("daemon goes on")
        return True

    def connected(self) -> bool:
        if self.daemon is None:
            return False
        status = self.daemon.status()
        if status is None:
            return False
        return status["command"]["state"] == "connected" and status["link"]["state"] == "streaming"

    def set_right(self) -> None:
        """What a person does before a program: the daemon runs, the craft is on, hears and is
        heard, is armed where it has to be. Where one flies already it is left alone."""
        self.radio.stalled = False
        self.free_disk()
        self.begin_daemon()
        if self.craft.truth.flies:
            return
        state = self.craft.craft.state()
        locked = state.supervisor in (LOCKED, CRASHED) or state.tumbled or not state.powered
        if locked or state.battery_v < REST_V:
            self.restart()
        until(
            lambda: self.craft.truth.flies or (self.noticed and self.connected()),
            "the craft is connected",
        )
        if self.craft.vehicle == "brushless" and not self.craft.craft.state().armed:
            self.arm()

    @property
    def noticed(self) -> bool:
        """Whether the daemon must know by now that it was another craft, or the same anew."""
        return time.monotonic() > self.changed_s + OFF_S

    # -- people -------------------------------------------------------------------------------

    def stop(self) -> bool:
        self.drops("Stop")
        flew = self.craft.truth.flies
        told = self.asked("POST", "/command/stop")
        return self._ended("Stop", told, STOPPED, flew)

    def land(self) -> bool:
        """Where the craft holds no height, or nobody flies, it is refused in words."""
        self.soft("Land")
        flew = self.craft.truth.flies
        told = self.asked("POST", "/command/land")
        return self._ended("Land", told, LANDED, flew)

    def _ended(self, what: str, told: dict | None, well: str, flew: bool) -> bool:
        if told is None:
            counted[f"{what} refused"] += 1
            return True
        counted[what] += 1
        counted[f"{what} in the air"] += flew
        self.say(f"answered {told['motors']!r}")
        if told["motors"] in (well, STOPPED):
            self.craft.truth.be_quiet()
            counted["stopped"] += 1
        return True

    def arm(self) -> bool:
        if self.craft.vehicle != "brushless":
            return False
        self.craft.truth.may_turn()
        counted["arm"] += self.asked("POST", "/command/arm", {"on": True}) is not None
        return True

    # -- programs -----------------------------------------------------------------------------

    def running(self, *kinds: str) -> Begun | None:
        """The newest of these kinds that has not ended."""
        self._reap()
        return next((one for one in self.programs[::-1] if one.kind in kinds), None)

    def hover(self, after_s: float) -> bool:
        if self.running("client"):
            return False
        self._begin()
        status = self.daemon.status()
        if status is None:
            return False
        self._number += 1
        name = f"client {self._number}"
        stops = status["command"]["stops"]
        self._began("client", Hovering(self.socket, name, stops, after_s))
        return True

    def client(self, how: str, **values: float) -> bool:
        begun = self.running("client")
        if begun is None:
            return False
        client = begun.what
        if how == "write":
            client.write = {GAIN: values["value"]}
        elif how == "silent":
            self.soft("client silent")
            client.silent_s = values["seconds"]
        else:
            if how == "stop":
                self.drops("client's own stop")
            self.soft(f"client {how}")
            client.end(how)
            client.join(PATIENCE_S)
            self._reap()
        return True

    def pid_fly(self, restore: bool, gain: float) -> bool:
        if self.running("pid fly"):
            return False
        self._begin()
        gains = self.folder / "gains.toml"
        gains.write_text(f'firmware = "2.x"\n"{GAIN}" = {gain}\n')
        begun = self._run("pid fly", "pid", "fly", "--gains", gains, *QUICK,
                          *(["--restore"] if restore else []))  # fmt: skip
        begun.settles = {} if restore else {GAIN: gain}
        return True

    def learn(self) -> bool:
        if self.running("learn", "job"):
            return False
        self._begin()
        self._number += 1
        self._run("learn", "learn", "--yes", "--height", HEIGHT_M, "-o",
                  self.folder / f"learnt{self._number}")  # fmt: skip
        return True

    def job(self) -> bool:
        if self.running("learn", "job"):
            return False
        self._begin()
        started = self.asked("POST", "/jobs/start", {"kind": "learn"})
        if started is not None:
            self._began("job", started["id"])
        return True

    def _begin(self) -> None:
        self.set_right()
        for craft in self.crafts:
            craft.truth.may_turn()

    def _run(self, kind: str, *words: object) -> Begun:
        out = (self.folder / f"{kind}.txt").open("ab")
        environment = {**os.environ, "NO_COLOR": "1", "GROUNDSTATION_SOCKET": str(self.socket),
                       "XDG_STATE_HOME": str(self.folder / "state")}  # fmt: skip
        with out:
            program = Program([COMMAND, *map(str, words)], stdout=out, stderr=out, env=environment)
        return self._began(kind, program)

    def _began(self, kind: str, what: Program | Hovering | str) -> Begun:
        self.programs.append(Begun(kind, what, self.craft))
        self.begun.append(self.programs[-1])
        self._count(f"{kind} begun")
        return self.programs[-1]

    def signal(self, number: int, kind: str) -> bool:
        """The first Ctrl-C or SIGTERM lands, the second one cuts; SIGKILL leaves it to the
        daemon."""
        begun = self.running(kind)
        if begun is None:
            return False
        if number != signal.SIGKILL and begun.signals:
            self.drops("second Ctrl-C")
        self.soft(f"{signal.Signals(number).name} to {kind}")
        begun.signal(number)
        return True

    def hold(self, kind: str, seconds: float) -> bool:
        begun = self.running(kind)
        if begun is None or not isinstance(begun.what, Program):
            return False
        self.soft(f"{kind} held")
        starts = time.time_ns() < begun.begun_ns + READS_S * 1e9
        with held(begun.what.pid):
            time.sleep(seconds)
        if starts:  # Python takes as much longer
            begun.begun_ns += round(seconds * 1e9)
        return True

    def cancel(self) -> bool:
        begun = self.running("job")
        if begun is None:
            return False
        self.soft("job cancelled")
        self.asked("POST", "/jobs/cancel", {"id": begun.what})
        return True

    def wait(self, seconds: float) -> bool:
        time.sleep(seconds)
        return True

    def until_it_flies(self) -> bool:
        """At most for what a program may need before its take-off."""
        if not self.programs:
            return False
        end_s = time.monotonic() + TAKES_OFF_S
        while self.programs and not self.craft.truth.flies and time.monotonic() < end_s:
            time.sleep(0.05)
            self._reap()
        return True

    def until_it_is_down(self) -> bool:
        """At most for what the longest landing takes."""
        end_s = time.monotonic() + LANDS_S
        while self.craft.truth.flies and time.monotonic() < end_s:
            time.sleep(0.02)
        return True

    # -- the radio, the craft, the disk -------------------------------------------------------

    def stall(self, seconds: float) -> bool:
        self.drops(f"link lost for {seconds} s")
        self.radio.stalled = True
        time.sleep(seconds)
        self.radio.stalled = False
        self.drops("link back")
        return True

    def restart(self) -> bool:
        self.drops("switched off")
        counted["restarted craft"] += 1
        self.craft.switch_on()
        self.radio.reach(self._port())
        self.changed_s = time.monotonic()
        return True

    def exchange(self) -> bool:
        """Another one is on the same address; the former stays switched on."""
        self.drops("exchanged")
        counted["exchanged craft"] += 1
        self.radio.stalled = True
        time.sleep(OFF_S)
        self.craft = self.crafts[self.craft is self.crafts[0]]
        if self.craft.served is None:
            self.craft.switch_on(booted=True)
        self.radio.reach(self._port())
        self.radio.stalled = False
        self.drops("exchanged")
        return True

    def drain(self) -> bool:
        if self.running("client"):
            self.drops("battery low")  # it does not look at its battery, as programs do
        else:
            self.soft("battery low")
        self.craft.drain()
        return True

    def fill_disk(self) -> bool:
        if self.disk is None:
            return False
        self.soft("disk full")
        with contextlib.suppress(OSError), (self.disk / "filler").open("wb", 0) as file:
            while True:
                file.write(bytes(1 << 16))
        return True

    def free_disk(self) -> bool:
        if self.disk is not None:
            (self.disk / "filler").unlink(missing_ok=True)
        return True

    def _port(self) -> int:
        assert self.craft.served is not None
        return self.craft.served.server.port

    # -- what ends ----------------------------------------------------------------------------

    def faults(self) -> list[str]:
        """What should not have been, until now."""
        self._reap()
        found = self.of_flights()
        with contextlib.suppress(GroundStationError):
            if self.daemon is not None:
                found += self.of_leases(ask(self.socket, "GET", "/events"))
        return found

    def _reap(self) -> None:
        for begun in list(self.programs):
            if begun.ended(self._jobs):
                self.programs.remove(begun)
                begun.settle()

    def _processes(self) -> list[int]:
        return [] if self.daemon is None else [self.daemon.process.pid]

    def _jobs(self) -> dict[str, str]:
        jobs = self.asked("GET", "/jobs") if self.daemon is not None else None
        return {job["id"]: job["state"] for job in jobs or []}

    # -- the end ------------------------------------------------------------------------------

    def end(self) -> list[str]:
        """Everything is ended, the daemon is there, every craft has the gains that it should have:
        what is not so."""
        self.say("the end")
        self.radio.stalled = False
        self.free_disk()
        for kind, number in (("pid fly", signal.SIGTERM), ("learn", signal.SIGINT)):
            self.signal(number, kind)
        self.client("release")
        self.cancel()
        until(
            lambda: not self.running("client", "pid fly", "learn", "job"),
            f"every program has ended: {self.said[-20:]}",
        )
        until(lambda: not any(craft.truth.flies for craft in self.crafts), "no craft flies")
        found = self.faults()
        self.begin_daemon()
        found += self._gains_of(self.craft)
        other = self.crafts[self.craft is self.crafts[0]]
        if other.served is not None:
            self.exchange()
            found += self._gains_of(other)
        self.daemon.stop()  # its status is 1 where the disk was full
        if "Traceback" in self.daemon.stderr:
            found.append(self.daemon.stderr)
        return found

    def _gains_of(self, craft: Craft) -> list[str]:
        """Waits for the craft, and until nothing of it is unproven."""
        if not craft.craft.powered:
            self.restart()

        def proven() -> bool:
            if not (self.noticed and self.connected()):
                return False
            if craft.truth.turns and not craft.truth.flies:  # a Brushless that idles
                self.asked("POST", "/command/arm", {"on": False})
            return not self.daemon.status()["command"]["unproven"]

        until(proven, f"former gains are back: {self.said[-20:]}")
        now = {name: craft.craft.get_parameter(name) for name in craft.gains}
        return [
            f"{name} is {now[name]:g}, should be {sorted(may)}"
            for name, may in craft.gains.items()
            if not any(abs(now[name] - one) <= 1e-6 * abs(one) for one in may)
        ]

    def __exit__(self, *_: object) -> None:
        for begun in self.programs:
            begun.kill()
        if self.daemon is not None:
            self.daemon.process.end()
        self.radio.stop()
        for craft in self.crafts:
            craft.switch_off()
        self.watch.__exit__()
        if self.disk is not None:
            run_program(["umount", self.disk], check=True)


def small_disk(folder: Path) -> Path | None:
    """A file system that is full soon; None where this user may make none."""
    folder.mkdir()
    mounted = run_program(["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", folder])
    return None if mounted.returncode else folder
