"""Every route that changes something needs the token, and a job's file is that job's."""

import asyncio

import msgspec
import pytest

from groundstation.page.app import ACTIONS, Access, page_app
from groundstation.service.jobs import Job
from support.page_requests import PORT, answering, asked, browser

CHANGES = [
    *(f"/do{path}" for path in ACTIONS),
    "/parameters",
    "/parameters/stored",
    "/add/file/flight.csv",
    "/add/example/flight.mcap",
]
KINDS = {"report": "report", "model": "model_file", "gains": "gains_file"}


@pytest.fixture
def control(tmp_path):
    return tmp_path / "control.sock"


@pytest.mark.parametrize("path", CHANGES)
def test_nothing_is_changed_without_the_page_s_origin_and_token(control, path):
    access = Access(b"key", PORT)
    app = page_app(control, access, None)

    def status(without=b""):
        headers = [one for one in browser(access) if one[0] != without]
        return asyncio.run(asked(app, "POST", path, headers, {"on": False}))[0]

    assert status() == 400  # let in, and no daemon is there
    assert status(without=b"x-change-token") == 403
    assert status(without=b"origin") == 403
    assert status(without=b"cookie") == 401


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_job_wrote_is_shown_as_that_job_s(tmp_path, control, kind):
    def job(name, **written):
        return msgspec.to_builtins(Job(id=name, kind="fit", recordings=[], **written))

    names, jobs = ("first", "second", "third"), []
    for name in names:
        path = tmp_path / name
        path.write_text(f"of the {name}")
        jobs.append(job(name, **{KINDS[kind]: str(path)}))
    jobs.insert(1, job("nothing"))
    access = Access(b"key", PORT)
    with answering(control, {"GET /jobs": jobs}):
        app = page_app(control, access, None)

        def shown(name):
            return asyncio.run(asked(app, "GET", f"/file/{kind}/{name}", browser(access)))

        for name in names:
            assert shown(name) == (200, f"of the {name}".encode())
        for name in ("nothing", "another"):
            assert shown(name)[0] == 404
