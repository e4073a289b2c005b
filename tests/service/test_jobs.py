"""Jobs of a real station: the commands that people type, on recordings that are there."""

import asyncio
import json
import shutil
import signal
from functools import partial

import psutil
import pytest

from groundstation.errors import BadInputError, GroundStationError
from groundstation.service.client import ask
from groundstation.service.config import Config, RecordingConfig
from groundstation.service.jobs import Jobs
from support import RECORDINGS
from support.waiting import PATIENCE_S, eventually, until
from support.worlds import serve

FLIGHT = "stand_in_flight.mcap"
ENDED = ("done", "failed", "cancelled")


@pytest.fixture
def talk(tmp_path, path):
    """talk(conversation): with a station whose folder holds a flight."""
    folder = tmp_path / "sessions"
    folder.mkdir()
    shutil.copy(RECORDINGS / FLIGHT, folder)
    (folder / "torn.mcap").write_bytes((RECORDINGS / FLIGHT).read_bytes()[:1000])
    config = Config(recording=RecordingConfig(folder=str(folder), enabled=False))
    asked = partial(ask, path)
    return lambda conversation: serve(config, path, lambda station: conversation(asked))


def start(ask, kind, *recordings, **more):
    return ask("POST", "/jobs/start", {"kind": kind, "recordings": recordings, **more})["id"]


def job(ask, name):
    (found,) = [one for one in ask("GET", "/jobs") if one["id"] == name]
    return found


def when_ended(ask, name):
    until(lambda: job(ask, name)["state"] in ENDED, "the job's end", 200, every_s=0.1)
    return job(ask, name)


def test_what_a_fit_advises_can_be_asked_for_and_other_work_takes_none_of_it(talk):
    def conversation(ask):
        options = {"effects": ["rotor_drag", "dead_time"], "measured_rotors": True}
        name = start(ask, "fit", FLIGHT, **options)
        words = job(ask, name)["command"].split()
        assert words[words.index("--with") + 1] == "rotor_drag,dead_time"
        assert "--measured-rotors" in words
        ask("POST", "/jobs/cancel", {"id": name})
        with pytest.raises(GroundStationError, match="takes no effects"):
            start(ask, "inspect", FLIGHT, **options)
        offered = {one["name"] for one in ask("GET", "/effects")}
        assert {"rotor_drag", "dead_time"} <= offered

    talk(conversation)


def test_a_job_does_what_its_command_does_and_keeps_its_log(talk, tmp_path):
    def conversation(ask):
        name = start(ask, "inspect", FLIGHT)
        done = when_ended(ask, name)
        assert (done["state"], done["report"]) == ("done", None)
        assert done["command"] == f"groundstation inspect {FLIGHT}"
        log = ask("POST", "/jobs/log", {"id": name})["text"]
        assert "verdict" in log
        assert done["text"] == "good: 31 s at 500 Hz, nothing lost"
        told = [event["text"] for event in ask("GET", "/events") if event["kind"] == "job"]
        assert any(name in text and "done" in text for text in told)
        return name

    name = talk(conversation)
    kept = json.loads((tmp_path / "sessions" / "jobs" / name / "job.json").read_text())
    assert kept["state"] == "done"
    talk(lambda ask: job(ask, name))  # a daemon started later knows it


def test_a_job_that_fails_says_why(talk):
    def conversation(ask):
        failed = when_ended(ask, start(ask, "fit", "torn.mcap"))
        assert failed["state"] == "failed"
        assert failed["text"].startswith("groundstation: ")
        assert failed["model_file"] is None

    talk(conversation)


def test_jobs_wait_for_their_turn_and_can_be_cancelled(talk):
    def conversation(ask):
        first, second = start(ask, "fit", FLIGHT), start(ask, "fit", FLIGHT)
        until(lambda: job(ask, first)["state"] == "running", "its turn")
        assert job(ask, second)["state"] == "waiting"
        assert ask("POST", "/jobs/cancel", {"id": second})["state"] == "cancelled"
        working = until(processes_of_jobs, "its process")
        ask("POST", "/jobs/cancel", {"id": first})
        assert when_ended(ask, first)["state"] == "cancelled"
        until(lambda: not any(one.is_running() for one in working), "its process has ended")
        with pytest.raises(GroundStationError, match="no job that waits or runs"):
            ask("POST", "/jobs/cancel", {"id": first})

    talk(conversation)


def processes_of_jobs():
    mine = psutil.Process().children(recursive=True)
    return [one for one in mine if "groundstation.cli.main" in " ".join(one.cmdline())]


def test_the_daemon_s_end_is_the_job_s_end(talk):
    name = talk(lambda ask: start(ask, "fit", FLIGHT))
    until(lambda: not processes_of_jobs(), "its process has ended")
    ended = talk(lambda ask: job(ask, name))
    assert (ended["state"], ended["model_file"]) == ("cancelled", None)


def test_a_job_whose_folder_is_deleted_has_failed_and_the_next_one_runs(talk, tmp_path):
    def conversation(ask):
        first, waiting, last = (start(ask, "inspect", FLIGHT) for _ in range(3))
        shutil.rmtree(tmp_path / "sessions" / "jobs" / waiting)
        assert "no such job" in when_ended(ask, waiting)["text"]
        assert job(ask, waiting)["state"] == "failed"
        assert {when_ended(ask, name)["state"] for name in (first, last)} == {"done"}

    talk(conversation)


@pytest.mark.parametrize("name", ["../secret.mcap", "{outside}", "jobs/../../secret.mcap", "."])
@pytest.mark.parametrize("which", ["recordings", "validate"])
def test_no_name_leads_out_of_the_recordings_folder(tmp_path, name, which):
    folder, secret = tmp_path / "sessions", tmp_path / "secret.mcap"
    (folder / "jobs").mkdir(parents=True)
    for path in (secret, folder / "own.mcap"):
        path.write_bytes(b"")
    jobs = Jobs(lambda: folder, lambda kind, text: None)
    named = {"recordings": ["own.mcap"], "validate": []}
    jobs.add("fit", **named, model="")
    named[which] = [name.format(outside=secret)]
    with pytest.raises(BadInputError, match="no such recording"):
        jobs.add("fit", **named, model="")
    assert len(jobs.entries()) == 1


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ({"kind": "fit", "recordings": ["nothing.mcap"]}, "no such recording"),
        ({"kind": "fit", "recordings": ["../control.sock"]}, "no such recording"),
        ({"kind": "fit", "recordings": ["--help"]}, "no such recording"),
        ({"kind": "fit", "recordings": []}, "needs recordings"),
        ({"kind": "design", "recordings": [FLIGHT], "model": "thesis"}, "no recordings"),
        ({"kind": "design"}, "needs a model"),
        ({"kind": "pid", "recordings": [FLIGHT]}, "kind"),
        ({"kind": "compare", "recordings": [FLIGHT]}, "needs a model"),
        ({"kind": "compare", "recordings": [FLIGHT], "model": "/etc/passwd"}, "no such job"),
        ({"kind": "compare", "recordings": [FLIGHT], "model": ".."}, "no such job|no model"),
    ],
)
def test_what_is_not_in_the_folder_is_refused(talk, body, says):
    def conversation(ask):
        with pytest.raises(GroundStationError, match=says):
            ask("POST", "/jobs/start", body)
        assert ask("GET", "/jobs") == []

    talk(conversation)


def test_the_name_in_a_job_s_own_file_is_not_believed(talk, tmp_path):
    jobs = tmp_path / "sessions" / "jobs"
    (jobs / "2026-01-01T00-00-00-000Z_fit").mkdir(parents=True)
    entry = {"id": "../../etc", "kind": "fit", "recordings": [], "state": "done"}
    (jobs / "2026-01-01T00-00-00-000Z_fit" / "job.json").write_text(json.dumps(entry))
    (found,) = talk(lambda ask: ask("GET", "/jobs"))
    assert found["id"] == "2026-01-01T00-00-00-000Z_fit"


async def test_a_job_cancelled_while_it_is_started_ends_and_the_next_one_runs(
    tmp_path, monkeypatch
):
    (tmp_path / FLIGHT).write_bytes(b"")
    started = asyncio.Event()
    begin = asyncio.create_subprocess_exec

    async def slowly(*command, **options):
        started.set()
        await asyncio.sleep(0.1)
        return await begin("sleep", "60", start_new_session=True)

    jobs = Jobs(lambda: tmp_path, lambda kind, text: None)
    monkeypatch.setattr(asyncio, "create_subprocess_exec", slowly)
    job = jobs.add("inspect", [FLIGHT], [], "")
    running = asyncio.create_task(jobs.run())
    await started.wait()
    await jobs.cancel(job.id)
    started.clear()
    following = jobs.add("inspect", [FLIGHT], [], "")
    async with asyncio.timeout(PATIENCE_S):
        await started.wait()
    await jobs.close()
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    found = job.state, following.state
    assert found == ("cancelled", "cancelled")


def limits_of_jobs():
    found = {one.rlimit(psutil.RLIMIT_DATA)[1] for one in processes_of_jobs()}
    return found - {psutil.RLIM_INFINITY}


def test_a_job_has_no_more_than_its_share_of_the_memory(talk):
    def conversation(ask):
        name = start(ask, "fit", FLIGHT)
        limits = until(limits_of_jobs, "it runs and is limited")
        ask("POST", "/jobs/cancel", {"id": name})
        return limits

    (limit,) = talk(conversation)
    assert limit == pytest.approx(0.5 * psutil.virtual_memory().total, rel=0.01)


class Begun:
    """What is begun in the place of a job's command: it sleeps until it is told to end."""

    def __init__(self, monkeypatch, command=("sleep", "60")):
        self.begin, self.command = asyncio.create_subprocess_exec, command
        self.environments, self.processes = [], []
        monkeypatch.setattr(asyncio, "create_subprocess_exec", self)

    async def __call__(self, *command, env, **options):
        self.environments.append(env)
        self.processes.append(await self.begin(*self.command, start_new_session=True))
        return self.processes[-1]

    async def until_running(self, count=1):
        await eventually(lambda: len(self.processes) == count, "its process")


def played(folder, scenario, **options):
    """The jobs of a folder, one after the other, while ``scenario`` asks."""
    (folder / FLIGHT).write_bytes(b"")

    async def session():
        jobs = Jobs(lambda: folder, lambda kind, text: None, **options)
        running = asyncio.create_task(jobs.run())
        try:
            return await scenario(jobs)
        finally:
            await jobs.close()
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)

    return asyncio.run(session())


def test_a_stop_ends_learn_at_once_whether_it_flies_or_computes_or_waits(tmp_path, monkeypatch):
    begun = Begun(monkeypatch)

    async def scenario(jobs):
        running, fit, waiting = (
            jobs.add("learn", [], [], ""),
            jobs.add("fit", [FLIGHT], [], ""),
            jobs.add("learn", [], [], ""),
        )
        await begun.until_running()
        assert jobs.end_flying() == ["learn", "learn"]
        await eventually(lambda: begun.processes[0].returncode == -signal.SIGTERM, "its end")
        await eventually(lambda: running.ended_ns > 0, "its entry")
        assert (running.state, waiting.state) == ("cancelled", "cancelled")
        assert waiting.text == "the operator has ended it"
        await begun.until_running(2)
        assert fit.state == "running"
        assert jobs.end_flying() == []

    played(tmp_path, scenario)


def test_a_job_that_flies_is_given_the_time_to_land_its_craft(tmp_path, monkeypatch):
    ready = tmp_path / "ready"
    slow = f'trap "sleep 0.5; exit 7" TERM; touch {ready}; while :; do sleep 0.05; done'
    begun = Begun(monkeypatch, ("sh", "-c", slow))
    monkeypatch.setattr("groundstation.service.jobs.STOP_S", 0.2)

    async def scenario(jobs):
        learn, fit = jobs.add("learn", [], [], ""), jobs.add("fit", [FLIGHT], [], "")
        await eventually(ready.exists, "the shell has set its trap")
        ready.unlink()
        await jobs.cancel(learn.id)
        assert begun.processes[0].returncode == 7
        await eventually(ready.exists, "the shell has set its trap")
        await jobs.cancel(fit.id)
        assert begun.processes[1].returncode == -signal.SIGKILL

    played(tmp_path, scenario)


def test_a_job_knows_how_often_motors_had_been_stopped_when_a_person_began_it(
    tmp_path, monkeypatch
):
    begun, count = Begun(monkeypatch), [41]

    async def scenario(jobs):
        first = jobs.add("fit", [FLIGHT], [], "")
        await begun.until_running()
        jobs.add("learn", [], [], "")
        count[0] = 42  # while it waits for its turn
        await jobs.cancel(first.id)
        await begun.until_running(2)

    played(tmp_path, scenario, stops=lambda: count[0])
    assert [one["GROUNDSTATION_STOPS"] for one in begun.environments] == ["41", "41"]


def test_a_job_of_a_daemon_that_was_killed_stays_in_the_list(tmp_path, monkeypatch):
    begun = Begun(monkeypatch)

    async def scenario(jobs):
        job = jobs.add("learn", [], [], "")
        await begun.until_running()
        (found,) = Jobs(lambda: tmp_path, lambda kind, text: None).entries()  # the next daemon's
        assert (found.id, found.kind, found.state) == (job.id, "learn", "failed")
        assert found.text == "the daemon was ended while this ran"
        assert found.began_ns > 0

    played(tmp_path, scenario)
