"""A daemon, crafts whose truth is seen, a radio between them, and all that people, programs and
machines do to them: each a method, which says whether there was anything to do it to."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from pathlib import Path

from firmware_sim.supervisor import CRASHED, LOCKED
from groundstation.errors import GroundStationError
from groundstation.service.client import ask
from groundstation.service.lease import STOPPED
from support.begun import HEIGHT_M, Begun, Hovering, held
from support.crafts import NarrowRadio
from support.daemons import COMMAND, Daemon
from support.programs import Program, run_program
from support.truth import Craft
from support.waiting import PATIENCE_S, until
from support.witness import Witness, counted

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
        with held(begun.what.pid):
            time.sleep(seconds)
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
