"""Work in processes of their own: commands, jobs on recordings, the models that they made."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import resource
import shlex
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from groundstation.documents import read_document
from groundstation.dynamics.meanings import arx_meaning, meaning_of
from groundstation.dynamics.model import Model, load_model, of_rates, origin_notes, origin_of
from groundstation.errors import BadInputError, GroundStationError
from groundstation.paths import dated, write_whole
from groundstation.text import printable

# Our own commands, run by the daemon in processes of their own, and waited for.


PATIENCE_S = 60.0
MEMORY_SHARE = 0.5
"""Of this machine's memory, for one process of ours beside the recorder."""


def own_program(*words: str, niceness: int = 5) -> tuple[str, ...]:
    """What starts Python with ``words`` so that it ends with this process. niceness: beyond
    ours."""
    leash = "-m", "groundstation.viewer.leash", str(os.getpid()), str(niceness)
    return (sys.executable, *leash, sys.executable, *words)


def own_command(*arguments: str, niceness: int = 5) -> tuple[str, ...]:
    """The same with one of our commands."""
    main = "from groundstation.cli.main import main; main()"
    return own_program("-c", main, *arguments, niceness=niceness)


def own_environment() -> dict[str, str]:
    """For such a process: more threads than one would take the cores from the recorder."""
    threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
    return {**os.environ, "NO_COLOR": "1", **dict.fromkeys(threads, "1")}


def limit_memory(pid: int) -> None:
    """Let a process that has just been started, and those it starts, have no more than its share
    of this machine's memory: it fails alone, and the recorder is not ended in its place."""
    most = round(MEMORY_SHARE * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with contextlib.suppress(ProcessLookupError):  # it has ended already
        resource.prlimit(pid, resource.RLIMIT_DATA, (most, most))


async def run_command(*arguments: str, patience_s: float = PATIENCE_S) -> tuple[int, bytes, str]:
    """Exit status, standard output, and what was said on standard error. At a low priority.

    Raises GroundStationError where it does not end in time.
    """
    return await run_program(own_command(*arguments), arguments[0], patience_s)


async def run_program(
    words: Sequence[str], name: str, patience_s: float, *, bounded: bool = False
) -> tuple[int, bytes, str]:
    """The same of any program of ours. name: what it is called where it is late. bounded: to its
    share of the memory (``limit_memory``)."""
    process = await asyncio.create_subprocess_exec(
        *words,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=own_environment(),
    )
    if bounded:
        limit_memory(process.pid)
    try:
        async with asyncio.timeout(patience_s):
            out, err = await process.communicate()
    except TimeoutError as error:
        raise GroundStationError(f"{name}: no answer within {patience_s:g} s") from error
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
    return process.returncode or 0, out, err.decode(errors="replace").strip()


# What a fit that was a job advises, from the model it wrote.


class Advice(msgspec.Struct, frozen=True, kw_only=True):
    """What a fit says would make it better: effects to fit along, recorded rotor speeds."""

    effects: list[str] = []
    measured_rotors: bool = False


def advice(model: Path) -> Advice:
    """What the fit of a body advised; nothing where there is no such model."""
    account = _part_of(_part_of(_read(model), "fit"), "body")
    measured = any("--measured-rotors" in str(text) for text in _list_in(account, "warnings"))
    effects = sorted(map(str, _list_in(account, "left_out")))
    return Advice(effects=effects, measured_rotors=measured)


def _read(path: Path) -> Mapping[str, Any]:
    try:
        found = msgspec.json.decode(read_document(path))
    except (OSError, ValueError, msgspec.MsgspecError):
        found = None
    return found if isinstance(found, Mapping) else {}


# Work on recordings, and on a craft, in processes of their own, one at a time, kept beside the
# recordings.


FOLDER = "jobs"
"""In the recordings folder; each job has a folder of its own in it."""
WAITING_MOST = 20
LOG_MOST = 1 << 16
"""Bytes of a log that are told: its end."""
STOP_S, LANDS_S = 5.0, 15.0
"""A cancelled job is asked to end, and killed after so long; one that flies lands its craft first,
and puts back what it wrote."""
NICENESS = 1
"""The recorder goes first, and what only shows (5) last: a person waits for a job."""
PROGRESS = "GROUNDSTATION_PROGRESS"
"""Where a command tells how far it is, and what it has found (``cli/terminal.py``)."""
STOPS = "GROUNDSTATION_STOPS"
"""How often the operator had stopped or landed a craft when a person began the job."""
CUT = "the daemon was ended while this ran"
_ENTRY, _LOG, _PROGRESS = "job.json", "log.txt", "progress.json"
_REPORT, _MODEL, _GAINS = "report.html", "model.json", "gains.toml"
LEARNT = "learnt"
"""The folder of ``learn`` in a job's own."""

Kind = Literal["inspect", "fit", "compare", "discrepancy", "design", "learn"]
FLIES: tuple[Kind, ...] = ("learn",)
"""Kinds of jobs that fly the craft."""
State = Literal["waiting", "running", "done", "failed", "cancelled"]
_COMMANDS: dict[str, tuple[str, ...]] = {
    "inspect": ("inspect",),
    "fit": ("fit", "body"),
    "compare": ("compare",),
    "discrepancy": ("discrepancy",),
    "design": ("pid", "design"),
    "learn": ("learn", "--yes"),
}


class Job(msgspec.Struct, kw_only=True):
    """command: as a person would type it in the recordings folder. report, model_file, gains_file:
    paths of what it wrote, None where it did not. effects, measured_rotors: of a fit, known to be
    there, and used in the place of the motor's model. stage, share: what it is doing, and how much
    of it is done, None where nobody knows. text: what it found, or why it failed, in a sentence.
    advice: what a fit says would make it better."""

    id: str
    kind: Kind
    recordings: list[str]
    validate: list[str] = []
    model: str = ""
    effects: list[str] = []
    measured_rotors: bool = False
    stage: str = ""
    share: float | None = None
    advice: Advice = Advice()
    state: State = "waiting"
    command: str = ""
    began_ns: int = 0
    ended_ns: int = 0
    text: str = ""
    report: str | None = None
    model_file: str | None = None
    gains_file: str | None = None


class _Told(msgspec.Struct, frozen=True):
    """What a command says of itself."""

    stage: str = ""
    share: float | None = None
    found: str = ""


class Jobs:
    """The jobs of the recordings folder.

    folder: where recordings are. note: told (kind, text) of what becomes of each. socket: of the
    daemon, for jobs that fly. stops: how often the operator has stopped or landed a craft.
    """

    def __init__(
        self,
        folder: Callable[[], Path],
        note: Callable[[str, str], None],
        socket: Path = Path(),
        stops: Callable[[], int] = lambda: 0,
    ) -> None:
        self._folder, self._note, self._socket, self._stops = folder, note, socket, stops
        self._own: dict[str, Job] = {}
        self._begun_at: dict[str, int] = {}  # the count of stops then
        self._new = asyncio.Event()
        self._process: asyncio.subprocess.Process | None = None
        self._ending: set[asyncio.Task[None]] = set()

    def add(
        self,
        kind: Kind,
        recordings: Sequence[str],
        validate: Sequence[str],
        model: str,
        effects: Sequence[str] = (),
        measured_rotors: bool = False,
    ) -> Job:
        """Begin a job, or let it wait for its turn.

        model: that of an earlier fit, by the job's id, or a built-in one; empty: the usual one. To
        ``learn`` it is the job that is gone on with.
        Raises BadInputError for what is not in the recordings folder.
        """
        folder = self._folder().absolute()
        if sum(job.state == "waiting" for job in self._own.values()) >= WAITING_MOST:
            raise BadInputError(f"{WAITING_MOST} jobs are waiting already; cancel one of them")
        names = [*recordings, *validate]
        for name in names:
            if Path(name).name != name or not (folder / name).is_file():
                raise BadInputError(f"{name}: no such recording in {folder}")
        if kind == "inspect" and (len(names) != 1 or model):
            raise BadInputError("inspect takes one recording")
        if kind in ("design", "learn") and names:
            raise BadInputError(f"{kind} takes no recordings")
        if kind not in ("design", "learn") and not recordings:
            raise BadInputError(f"{kind} needs recordings: choose one at least")
        if kind in ("compare", "discrepancy", "design") and not model:
            raise BadInputError(f"{kind} needs a model: that of a fit, or thesis")
        if kind == "learn" and model and not (self._job_folder(model) / LEARNT).is_dir():
            raise BadInputError(f"{model}: nothing was learnt there that could be gone on with")
        if kind != "fit" and (effects or measured_rotors):
            raise BadInputError(f"{kind} takes no effects and no measured rotors; fit does")
        job = Job(
            id=dated(folder / FOLDER, kind, time.time_ns()).name,
            kind=kind,
            recordings=list(recordings),
            validate=list(validate),
            model=model,
            effects=list(effects),
            measured_rotors=measured_rotors,
        )
        job.command = shlex.join(["groundstation", *self._arguments(job, Path())])
        (folder / FOLDER / job.id).mkdir(parents=True)
        self._own[job.id], self._begun_at[job.id] = job, self._stops()
        self._new.set()
        return job

    def entries(self) -> list[Job]:
        """Every job, the oldest first. Reads files: not for the event loop."""
        found = {job.id: job for job in self._own.values()}
        for path in sorted((self._folder() / FOLDER).glob(f"*/{_ENTRY}")):
            if path.parent.name not in found:
                with contextlib.suppress(OSError, msgspec.MsgspecError, ValueError):
                    job = msgspec.json.decode(read_document(path), type=Job)
                    job.id = path.parent.name  # whatever the file says
                    if _lasts(job):  # of a daemon that was killed
                        job.state, job.text = "failed", CUT
                    self._kept(job)
                    found[job.id] = job
        for job in found.values():
            if job.state == "running":
                told = self._told(job)
                job.stage = printable(told.stage)
                job.share = job.share if told.share is None else told.share
        return [found[name] for name in sorted(found)]

    def _told(self, job: Job) -> _Told:
        with contextlib.suppress(OSError, msgspec.MsgspecError, ValueError):
            path = self._folder() / FOLDER / job.id / _PROGRESS
            return msgspec.json.decode(read_document(path), type=_Told)
        return _Told()

    def log(self, name: str) -> str:
        """The end of a job's log."""
        path = self._job_folder(name) / _LOG
        with contextlib.suppress(FileNotFoundError), path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - LOG_MOST))
            return file.read().decode(errors="replace")
        return ""

    async def cancel(self, name: str) -> Job:
        """End a job that waits or runs. Raises BadInputError for another."""
        job = self._own.get(name)
        if job is None or not _lasts(job):
            raise BadInputError(f"{name}: no job that waits or runs")
        was_running, job.state = job.state == "running", "cancelled"
        if was_running:
            await self._end(LANDS_S if job.kind in FLIES else STOP_S)
        else:
            self._finished(job)
        return job

    def end_flying(self) -> list[str]:
        """End jobs that fly the craft, whether they do at the moment or not: the operator has
        stopped its motors, or lands it. Their kinds."""
        flying = [job for job in self._own.values() if job.kind in FLIES and _lasts(job)]
        for job in flying:
            job.text = "the operator has ended it"
            ending = asyncio.create_task(self._cancelled(job))
            self._ending.add(ending)
            ending.add_done_callback(self._ending.discard)
        return [job.kind for job in flying]

    async def _cancelled(self, job: Job) -> None:
        with contextlib.suppress(BadInputError):  # it has ended
            await self.cancel(job.id)

    async def run(self) -> None:
        """Do what is asked for, one after the other, for as long as the daemon lives."""
        while True:
            waiting = [job for job in self._own.values() if job.state == "waiting"]
            if waiting:
                await self._carry_out(waiting[0])
                continue
            self._new.clear()
            await self._new.wait()

    async def close(self) -> None:
        """End what runs; what waits is forgotten. Safe to call twice."""
        for ending in self._ending:
            ending.cancel()
        patience_s = STOP_S
        for job in self._own.values():
            if _lasts(job):
                if job.state == "running" and job.kind in FLIES:
                    patience_s = LANDS_S
                job.state, job.text = "cancelled", "the daemon has ended"
                self._finished(job)
        await self._end(patience_s)

    async def _carry_out(self, job: Job) -> None:
        job.state, job.began_ns = "running", time.time_ns()
        self._write(job)  # a daemon that is killed leaves word of it
        try:
            status = await self._work(job)
            *_, last = ["", *self.log(job.id).strip().splitlines()]
            job.text = printable(last if status else self._told(job).found or last)
            if job.kind == "fit" and not status:
                job.advice = await asyncio.to_thread(advice, self._job_folder(job.id) / _MODEL)
        except (OSError, GroundStationError) as error:  # its folder was deleted, say
            status, job.text = 1, printable(str(error))
        self._process = None
        if job.state == "running":
            job.state = "failed" if status else "done"
        self._kept(job)
        self._finished(job)

    async def _work(self, job: Job) -> int:
        """The exit status of the command."""
        folder = self._job_folder(job.id)
        arguments = self._arguments(job, self._folder().absolute())
        with (folder / _LOG).open("wb") as log:
            self._process = process = await asyncio.create_subprocess_exec(
                *own_command(*arguments, niceness=NICENESS),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
                env={
                    **own_environment(),
                    PROGRESS: str(folder / _PROGRESS),
                    "GROUNDSTATION_SOCKET": str(self._socket),
                    STOPS: str(self._begun_at.get(job.id, 0)),
                },
            )
        limit_memory(process.pid)
        if job.state == "cancelled":  # while it was being started
            await self._end(STOP_S)
        return await process.wait()

    def _kept(self, job: Job) -> None:
        """What it has left, wherever the recordings folder is now."""
        folder = self._folder() / FOLDER / job.id
        if job.kind == "learn":
            with contextlib.suppress(BadInputError):  # whatever the file says
                folder = self._job_folder(job.model or job.id) / LEARNT
        job.report, job.model_file = _there(folder / _REPORT), _there(folder / _MODEL)
        job.gains_file = _there(folder / _GAINS)

    def _finished(self, job: Job) -> None:
        job.ended_ns = time.time_ns()
        self._write(job)
        self._note("job", f"{job.id}: {job.state}" + (f", {job.text}" if job.text else ""))

    def _write(self, job: Job) -> None:
        with contextlib.suppress(OSError, BadInputError):  # the folder may have been deleted
            write_whole(self._job_folder(job.id) / _ENTRY, msgspec.json.encode(job))

    async def _end(self, patience_s: float) -> None:
        """Ask the process to end, and kill it after so long."""
        process = self._process
        if process is None or process.returncode is not None:
            return
        for number in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, number)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(process.wait(), patience_s)
                return

    def _arguments(self, job: Job, folder: Path) -> list[str]:
        """Of the command, with its files in ``folder``."""
        into = folder / FOLDER / job.id
        words = [*_COMMANDS[job.kind], *(str(folder / name) for name in job.recordings)]
        if job.kind == "learn":
            return [*words, "-o", str(folder / FOLDER / (job.model or job.id) / LEARNT)]
        for name in job.validate:
            words += ["--validate", str(folder / name)]
        if job.model:
            words += ["--model", self._model(job.model, folder)]
        if job.effects:
            words += ["--with", ",".join(job.effects)]
        if job.measured_rotors:
            words.append("--measured-rotors")
        if job.kind in ("fit", "discrepancy"):
            words += ["-o", str(into / _MODEL)]
        if job.kind == "design":
            words += ["-o", str(into / _GAINS)]
        if job.kind != "inspect":
            words += ["--html", str(into / _REPORT)]
        return words

    def _model(self, name: str, folder: Path) -> str:
        if name == "thesis":
            return name
        if (self._job_folder(name) / LEARNT / _MODEL).is_file():
            return str(folder / FOLDER / name / LEARNT / _MODEL)
        if not (self._job_folder(name) / _MODEL).is_file():
            raise BadInputError(f"{name}: no model; give thesis, or the id of a fit that is done")
        return str(folder / FOLDER / name / _MODEL)

    def _job_folder(self, name: str) -> Path:
        """Raises BadInputError for what is no job."""
        folder = self._folder() / FOLDER / name
        if Path(name).name != name or name == ".." or not folder.is_dir():
            raise BadInputError(f"{name}: no such job")
        return folder


def _lasts(job: Job) -> bool:
    return job.state in ("waiting", "running")


def _there(path: Path) -> str | None:
    return str(path.absolute()) if path.is_file() else None


# What is plugged in or in reach, looked for in a process of its own: drivers block, or crash.


FRESH_S = 5.0
"""Asked again within so long, the answer is the one before: each look costs a second."""
DEVICES_PATIENCE_S = 30.0


class Device(msgspec.Struct, frozen=True, kw_only=True):
    """link: the name that a telemetry link has there, None where there is none. why: it is not
    usable."""

    kind: str
    name: str
    link: str | None
    description: str
    usable: bool
    why: str


class Devices(msgspec.Struct, frozen=True, kw_only=True):
    """usb_problem: why USB devices, or craft, could not be looked for."""

    devices: list[Device]
    usb_problem: str | None


class DeviceList:
    """Asks ``groundstation devices``. busy: whether a craft is reached by a dongle, which is then
    left alone."""

    def __init__(self, busy: Callable[[], bool]) -> None:
        self._busy = busy
        self._looking = asyncio.Lock()
        self._found: Devices | None = None
        self._found_s = 0.0

    async def look(self) -> Devices:
        """Raises GroundStationError where it cannot be told."""
        async with self._looking:
            if self._found is None or time.monotonic() - self._found_s > FRESH_S:
                away = ["--no-craft"] if self._busy() else []
                status, out, said = await run_command(
                    "devices", "--json", *away, patience_s=DEVICES_PATIENCE_S
                )
                if status:
                    raise GroundStationError(f"devices: {said}")
                self._found = msgspec.json.decode(out, type=Devices)
                self._found_s = time.monotonic()
            return self._found


# The models that jobs have made of the folder's recordings, and what each knows of its numbers.


BUILT_IN = "thesis"
SIDE_95 = 1.96
"""Standard errors on either side of a value; fits have thousands of degrees of freedom."""
SAME = 1e-9
"""An account speaks of a constant while the two agree so closely; another fit moved it since."""


class ModelParameter(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One number of a model. low, high: 95 % interval; None where nobody has estimated it, and
    ``origin`` says where it comes from. meaning: in words."""

    name: str
    value: float
    unit: str
    low: float | None
    high: float | None
    origin: Literal["fitted", "profile", "given"]
    meaning: str


class ModelEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A model of the recordings folder, or the built-in one. id: of the job that made it. kind: of
    that job. recordings, validate: what it was made from, and held out. file, report: paths.
    notes: what its user must know. problem: why it cannot be read; then nothing else is known."""

    id: str
    kind: str
    made_ns: int = 0
    vehicle: str = ""
    recordings: list[str] = []
    validate: list[str] = []
    parameters: list[ModelParameter] = []
    effects: list[str] = []
    notes: list[str] = []
    file: str | None = None
    report: str | None = None
    problem: str = ""


class Models:
    """What jobs have left in the folder. jobs: their entries."""

    def __init__(self, jobs: Callable[[], Sequence[Job]]) -> None:
        self._jobs = jobs
        self._read: dict[tuple[str, int], ModelEntry] = {}

    def entries(self) -> list[ModelEntry]:
        """The built-in one, then the folder's, the oldest first. Reads files: not for the event
        loop."""
        built_in = _described(Job(id=BUILT_IN, kind="fit", recordings=[]), load_model(BUILT_IN))
        return [
            msgspec.structs.replace(built_in, kind="built-in"),
            *(self._entry(job, job.model_file) for job in self._jobs() if job.model_file),
        ]

    def file(self, name: str) -> str:
        """What ``--model`` takes for a model of that id. Raises BadInputError for no model."""
        if name == BUILT_IN:
            return name
        for job in self._jobs():
            if job.id == name and job.model_file:
                return job.model_file
        raise BadInputError(f"{name}: no such model; GET /models lists those there are")

    def _entry(self, job: Job, file: str) -> ModelEntry:
        """Read once, as long as the file stays as it is."""
        try:
            key = file, Path(file).stat().st_mtime_ns
            if key not in self._read:
                self._read[key] = _described(job, load_model(file))
            return self._read[key]
        except (GroundStationError, OSError) as error:
            return ModelEntry(id=job.id, kind=job.kind, problem=printable(str(error)))


def _described(job: Job, model: Model) -> ModelEntry:
    said = [one for account in model.fit.values() for one in _list_in(account, "warnings")]
    return ModelEntry(
        id=job.id,
        kind=job.kind,
        made_ns=job.ended_ns,
        vehicle=model.vehicle,
        recordings=job.recordings,
        validate=job.validate,
        parameters=list(_parameters(model)),
        effects=[term.name for term in model.effects],
        notes=origin_notes(model) + [printable(str(one)) for one in said],
        file=job.model_file,
        report=job.report,
    )


def _parameters(model: Model) -> Iterator[ModelParameter]:
    origins = origin_of(model)
    for part, constants in (("motor", model.motor), ("body", model.body)):
        for key, value in ({} if constants is None else msgspec.structs.asdict(constants)).items():
            name = f"{part}.{key}"
            unit, meaning = meaning_of(name)
            origin = model.origin.get(name, origins[part])
            stderr = _constant_stderr(model, part, key, value) if origin == "fitted" else None
            yield _parameter(name, value, unit, stderr, origin, meaning)
    for axis, one in (model.arx or {}).items():
        account = _part_of(_part_of(model.fit.get("arx"), "axes"), axis)
        for letter, values in (("a", one.a), ("b", one.b)):
            for order, value in enumerate(values, 1):
                key = f"{letter}{order}"
                stderr = _stderr(account, key, value) if origins["arx"] == "fitted" else None
                unit, meaning = arx_meaning(key, one, rates=of_rates(model))
                yield _parameter(f"arx.{axis}.{key}", value, unit, stderr, origins["arx"], meaning)
    for term in model.effects:
        for key, found in term.parameters.items():
            origin = "given" if found.stderr is None else "fitted"
            name = f"{term.name}.{key}"
            meaning = meaning_of(name)[1]
            yield _parameter(name, found.value, found.unit, found.stderr, origin, meaning)


def _parameter(
    name: str, value: float, unit: str, stderr: float | None, origin: Any, meaning: str
) -> ModelParameter:
    side = SIDE_95 * stderr if stderr is not None and math.isfinite(stderr) else None
    return ModelParameter(
        name=name,
        value=value,
        unit=unit,
        low=None if side is None else value - side,
        high=None if side is None else value + side,
        origin=origin,
        meaning=meaning,
    )


def _constant_stderr(model: Model, part: str, key: str, value: float) -> float | None:
    """Of a constant, from the account that its value comes from; None where none is."""
    for change in _list_in(model.fit.get("discrepancy"), "base_changes"):
        is_it = isinstance(change, Mapping) and change.get("name") == key
        if is_it and _same(change.get("to"), value):
            found = change.get("stderr")
            return float(found) if isinstance(found, int | float) else None
    return _stderr(model.fit.get(part), key, value)


def _stderr(account: Any, key: str, value: float) -> float | None:
    """Of a number that a fit's account has estimated; None where it speaks of another value."""
    estimates = _part_of(account, "estimates")
    columns = (estimates.get(name) or () for name in ("names", "values", "stderr"))
    for name, estimated, stderr in zip(*columns, strict=False):
        if name == key and _same(estimated, value):
            return float(stderr)
    return None


def _part_of(account: Any, name: str) -> Mapping[str, Any]:
    """A part of an account, empty where it is not there or something else."""
    part = account.get(name) if isinstance(account, Mapping) else None
    return part if isinstance(part, Mapping) else {}


def _same(one: Any, other: float) -> bool:
    return isinstance(one, int | float) and math.isclose(one, other, rel_tol=SAME)


def _list_in(account: Any, name: str) -> list[Any]:
    """A list of an account, empty where it is not there or something else."""
    found = account.get(name) if isinstance(account, Mapping) else None
    return found if isinstance(found, list) else []
