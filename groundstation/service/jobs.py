"""Work on recordings, and on a craft, in processes of their own, one at a time, kept beside the
recordings."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shlex
import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import msgspec

from groundstation.documents import read_document
from groundstation.errors import BadInputError, GroundStationError
from groundstation.paths import dated, write_whole
from groundstation.service.commands import limit_memory, own_command, own_environment
from groundstation.service.job_result import Advice, advice
from groundstation.text import printable

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
"""Where a command tells how far it is, and what it has found (``cli/progress.py``)."""
STOPS = "GROUNDSTATION_STOPS"
"""How often the operator had stopped or landed a craft when a person began the job."""
CUT = "the daemon was ended while this ran"
_ENTRY, _LOG, _REPORT, _MODEL, _GAINS, _PROGRESS = (
    "job.json",
    "log.txt",
    "report.html",
    "model.json",
    "gains.toml",
    "progress.json",
)

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
                    if job.state in ("waiting", "running"):  # of a daemon that was killed
                        job.state, job.text = "failed", CUT
                    self._kept(job)
                    found[job.id] = job
        for job in found.values():
            if job.state == "running":
                self._look(job)
        return [found[name] for name in sorted(found)]

    def _look(self, job: Job) -> None:
        """How far it is, as far as it has told."""
        told = self._told(job)
        job.stage = printable(told.stage)
        job.share = job.share if told.share is None else told.share

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
        if job is None or job.state not in ("waiting", "running"):
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
        flying = [
            job
            for job in self._own.values()
            if job.kind in FLIES and job.state in ("waiting", "running")
        ]
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
            if job.state in ("waiting", "running"):
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


def _there(path: Path) -> str | None:
    return str(path.absolute()) if path.is_file() else None
