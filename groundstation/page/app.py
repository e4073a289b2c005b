"""The page's routes: what a browser is shown, and the control API's operations that it may ask for.

A page that changes nothing needs the cookie; a request that changes something the page's origin
and its token as well.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import hmac
import json
import re
import secrets
import shutil
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import Any

import msgspec
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect, Request
from starlette.responses import (
    FileResponse,
    HTMLResponse,
    PlainTextResponse,
    RedirectResponse,
    Response,
)
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from groundstation.errors import BadInputError, GroundStationError
from groundstation.page.follower import Follower
from groundstation.report.page import THEME
from groundstation.service.client import Pilot, ask
from groundstation.service.jobs import own_program, run_command, run_program
from groundstation.text import printable

# Who may use the page: browsers that opened a one-time address, from pages of this server.


COOKIE_BYTES = 18


class Access:
    """Cookies, tokens against forged requests, and the names that this server is called by.

    key: signs cookies; whoever holds it can make one. port: the page's.

    A browser sends cookies to every port of a host, so the cookie's name holds the port. ``Host``
    is compared because a page of any site may be given this address by its name server.
    """

    def __init__(self, key: bytes, port: int) -> None:
        self._key = key
        self._hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")}
        self.cookie = f"groundstation_{port}"

    def knows_host(self, host: str) -> bool:
        """Whether a request was meant for this server."""
        return host.lower() in self._hosts

    def new_session(self) -> str:
        """The value of a new cookie."""
        name = secrets.token_urlsafe(COOKIE_BYTES)
        return f"{name}.{self._sign('session', name)}"

    def is_session(self, cookie: str) -> bool:
        """Whether a cookie's value is one that was given out."""
        name, _, signature = cookie.partition(".")
        return _same(signature, self._sign("session", name))

    def knows(self, headers: Iterable[tuple[bytes, bytes]]) -> bool:
        """Whether a request's headers hold such a cookie."""
        sent = dict(headers).get(b"cookie", b"").decode("latin-1")
        values = (
            pair.partition("=")[2]
            for pair in sent.split("; ")
            if pair.startswith(f"{self.cookie}=")
        )
        return any(map(self.is_session, values))

    def change_token(self, cookie: str) -> str:
        """What a page of ours shows with each request that changes something."""
        return self._sign("change", cookie)

    def may_change(self, headers: Mapping[str, str], cookie: str) -> bool:
        """Whether a request comes from a page of ours: its origin, and the token it was given."""
        origin = headers.get("origin", "")
        host = headers.get("host", "")
        ours = self.knows_host(host) and origin.lower() == f"http://{host.lower()}"
        return ours and _same(headers.get("x-change-token", ""), self.change_token(cookie))

    def _sign(self, purpose: str, text: str) -> str:
        return hmac.new(self._key, f"{purpose} {text}".encode(), "sha256").hexdigest()


def _same(one: str, other: str) -> bool:
    return hmac.compare_digest(one.encode(), other.encode())


# What an operator must not overlook, in words, from the daemon's status; pure.


BATTERY_LOW_V, BATTERY_EMPTY_V = 3.3, 3.1
"""Of one lithium-polymer cell that carries the craft: land soon, land now."""
LOSS_MOST_PCT = 2.0
DISK_LOW_MB = 1024.0
VIEW_BEHIND_S = 2.0

Alarm = dict[str, str]
"""level: ``alarm`` (act), ``warning`` (look) or ``busy`` (wait); text; details, where there are."""


def alarms(status: dict[str, Any] | None, fault: str, battery_v: float | None) -> list[Alarm]:
    """The worst first. status: as the control API gives it; fault: why it cannot be asked."""
    if fault:
        return [_alarm(f"The groundstation does not answer: {fault}")]
    found = [] if status is None else list(_found(status, battery_v))
    return sorted(found, key=lambda one: one["level"] != "alarm")


def _found(status: dict[str, Any], battery_v: float | None) -> Iterator[Alarm]:
    for problem in status["health"]["problems"]:
        yield _alarm(problem[:1].upper() + problem[1:])
    command = status["command"]
    if command is not None and command["unproven"]:
        yield _unproven(command)
    link = status["link"]
    streaming = link["state"] == "streaming" and not link["pauses"]
    prepares = link["pauses"] and link["state"] == "opening"
    if prepares:
        yield {"level": "busy", "text": link["doing"][:1].upper() + link["doing"][1:]}
    elif link["pauses"]:
        yield _warning(f"The stand-in pauses: {link['doing']}")
    if streaming and battery_v is not None and battery_v < BATTERY_EMPTY_V:
        yield _alarm(f"Battery empty: {battery_v:.2f} V. Land now")
    elif streaming and battery_v is not None and battery_v < BATTERY_LOW_V:
        yield _warning(f"Battery low: {battery_v:.2f} V. Land soon")
    recording = status["recording"]
    if not recording["wanted"] and not prepares:
        yield _warning("Nothing is being recorded")
    free_mb = recording["free_mb"]
    if recording["wanted"] and free_mb is not None and free_mb < DISK_LOW_MB:
        yield _warning(f"Disk: {free_mb:.0f} MB left")
    statistics = status["statistics"]
    if streaming and statistics is not None and statistics["loss_pct"] > LOSS_MOST_PCT:
        yield _warning(f"{statistics['loss_pct']:.0f} % of the rows of the last second are lost")
    viewer = status["viewer"]
    if viewer["behind_s"] > VIEW_BEHIND_S:
        yield _warning(f"A live view is {viewer['behind_s']:.0f} s behind; it is sent less often")
    twin = status["twin"]
    if twin is not None and twin["state"] == "failed":
        yield _warning(f"The twin has failed: {twin['text']}")
    for one in [] if twin is None else twin["disagreements"]:
        yield _warning(f"Craft and model disagree: {one['channel']}, {one['regime']}. {one['why']}")


def _unproven(command: dict[str, Any]) -> Alarm:
    """Parameters of a flight that did not end as its client wanted."""
    back = (
        "are being written back"
        if command["state"] == "connected"
        else "are written back when it is connected"
    )
    names = [
        f"{name}: {'not known' if one['now'] is None else format(one['now'], 'g')},"
        f" before {one['former']:g}"
        for name, one in command["unproven"].items()
    ]
    text = f"Gains of an interrupted flight are on the craft; the former ones {back}"
    return {**_alarm(text), "details": "; ".join(names)}


def _alarm(text: str) -> Alarm:
    return {"level": "alarm", "text": text}


def _warning(text: str) -> Alarm:
    return {"level": "warning", "text": text}


# The documentation under Help: the site that ``make docs`` has built, where it is there.


SITE = Path(__file__).with_name("site")
SOURCES = Path(__file__).resolve().parents[2] / "docs"
"""Of a checkout: what the site is built from, shown as it is where nobody has built it."""
_NOT_BUILT = (
    '<!doctype html><html lang="en"><meta charset="utf-8"><title>Help</title>'
    '<link rel="stylesheet" href="/theme.css"><body><main><h1>Help</h1>'
    "<p>The documentation was not built with this copy of the program: <code>make docs</code> "
    "builds it. Every command has <code>--help</code>.</p><ul>PAGES</ul></main></body></html>"
)


def help_route(site: Path = SITE) -> BaseRoute:
    """What answers below ``/help/``."""
    if (site / "index.html").is_file():
        return Mount("/help", _Site(site))

    async def not_built(request: Request) -> Response:
        sources = {f"{one.stem}.html": one for one in sorted(SOURCES.glob("*.md"))}
        if source := sources.get(request.path_params["page"]):
            return PlainTextResponse(source.read_text())
        pages = "".join(
            f'<li><a href="/help/{name}">{one.stem}</a></li>' for name, one in sources.items()
        )
        return HTMLResponse(_NOT_BUILT.replace("PAGES", pages))

    return Route("/help/{page:path}", not_built)


class _Site(StaticFiles):
    """Files of the site. Of scripts within its pages those run that it was built with."""

    def __init__(self, site: Path) -> None:
        super().__init__(directory=site, html=True)
        self._policy = _policy(site)

    def file_response(self, *arguments: Any, **options: Any) -> Response:
        answer = super().file_response(*arguments, **options)
        answer.headers["content-security-policy"] = self._policy
        answer.headers["cache-control"] = "private, max-age=600"
        return answer


def _policy(site: Path) -> str:
    """No other host, no form; of scripts the site's own alone, those within pages by their hash."""
    scripts: set[bytes] = set()
    for page in site.rglob("*.html"):
        scripts.update(re.findall(rb"<script>(.*?)</script>", page.read_bytes(), re.DOTALL))
    hashes = sorted(base64.b64encode(hashlib.sha256(one).digest()).decode() for one in scripts)
    inline = " ".join(f"'sha256-{one}'" for one in hashes)
    return (
        f"default-src 'none'; script-src 'self' {inline}; style-src 'self' 'unsafe-inline';"
        " img-src 'self' data:; connect-src 'self'; worker-src 'self'; base-uri 'none';"
        " form-action 'none'; frame-ancestors 'none'"
    )


# Files that the operator opens: of the recordings folder, dropped on the page, or an example. What
# is dropped becomes a recording of the folder; nothing is overwritten. Where nobody knows a file's
# columns the operator is asked what they are (``reading.py``).


EXAMPLES = Path(__file__).resolve().parents[2] / "recordings"
"""Of a checkout; a wheel has none."""
PATIENCE_S = 300.0
FILE_MOST = 1 << 31
_NOT_EXAMPLES = (".md", ".LICENSE")


def examples() -> list[str]:
    """Names of the recordings that come with the program."""
    found = EXAMPLES.iterdir() if EXAMPLES.is_dir() else ()
    return sorted(one.name for one in found if one.suffix not in _NOT_EXAMPLES)


async def read_apart(what: str, path: Path, *more: str) -> bytes:
    """What ``reading.py`` prints of a file. Raises GroundStationError, in its words."""
    words = own_program("-m", "groundstation.page.reading", what, str(path), *more, niceness=1)
    status, out, said = await run_program(words, path.name, PATIENCE_S, bounded=True)
    if status:
        raise BadInputError(said.splitlines()[-1] if said else f"{path.name}: could not be read")
    return out


class UnknownColumnsError(BadInputError):
    """form: with which the operator is asked what the columns of a file are."""

    def __init__(self, why: str, form: dict[str, Any]) -> None:
        super().__init__(why)
        self.form = form


@dataclass(frozen=True, slots=True)
class Opened:
    """file: its name in the folder. map: text of the column map by which it was read, or empty.
    said: what is wrong with it, though it was read."""

    file: str
    map: str = ""
    said: str = ""


async def add(
    folder: Path, name: str, content: AsyncIterator[bytes], answers: str | None = None
) -> Opened:
    """A file becomes a recording of the folder: an MCAP as it is, anything else converted to one.

    answers: JSON of the form with which the operator was asked for its columns.

    Raises GroundStationError where it is no recording, UnknownColumnsError where its columns have
    to be named.
    """
    name = _plain(name)
    waiting = folder / "opened"
    waiting.mkdir(parents=True, exist_ok=True)
    source = _free(waiting, name)
    try:
        await _save(source, content)
        if answers is None:
            return await _taken(folder, source, name)
        return await _mapped(folder, source, name, answers)
    finally:
        source.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            waiting.rmdir()


async def add_example(folder: Path, name: str) -> str:
    """The same with an example. Raises BadInputError for what is none."""
    if name not in examples():
        raise BadInputError(f"{name}: no such example")
    target = folder / f"{Path(name).stem}.mcap"
    if target.is_file():  # it was added before
        return target.name
    folder.mkdir(parents=True, exist_ok=True)
    return (await _taken(folder, EXAMPLES / name, name)).file


async def _taken(folder: Path, source: Path, name: str) -> Opened:
    target = _free(folder, f"{Path(name).stem}.mcap")
    try:
        if name.endswith(".mcap"):
            await read_apart("series", source)  # whether it is a recording at all
            await asyncio.to_thread(shutil.copyfile, source, target)
            return Opened(target.name)
        if await _convert(source, target, name):
            return Opened(target.name)
        why = f"{name}: no channel is known"
    except GroundStationError as error:
        why = str(error)
    form = None
    with contextlib.suppress(GroundStationError):  # it has no columns
        form = json.loads(await read_apart("columns", source))
    if form is not None:
        target.unlink(missing_ok=True)
        raise UnknownColumnsError(why, form)
    if not target.is_file():
        raise BadInputError(why)
    return Opened(target.name, said=why)


async def _mapped(folder: Path, source: Path, name: str, answers: str) -> Opened:
    """The same by the columns that the operator has named."""
    target = _free(folder, f"{Path(name).stem}.mcap")
    beside = [source.with_name(f"{source.name}.{end}") for end in ("answers", "map.toml")]
    try:
        beside[0].write_text(answers, "utf-8")
        text = (await read_apart("columns", source, str(beside[0]))).decode()
        beside[1].write_text(text, "utf-8")
        await _convert(source, target, name, "--columns", str(beside[1]))
    finally:
        for one in beside:
            one.unlink(missing_ok=True)
    return Opened(target.name, text)


async def _convert(source: Path, target: Path, name: str, *given: str) -> list[str]:
    """The channels that the new file has. Raises BadInputError, in a reader's words."""
    status, out, said = await run_command(
        "convert", str(source), str(target), "--json", *given, patience_s=PATIENCE_S
    )
    if status:
        line = (said.splitlines() or [f"{name}: could not be read"])[-1]
        raise BadInputError(line.replace(f"{source}", name).removeprefix("groundstation: "))
    found: list[str] = json.loads(out)["channels"]
    return found


async def _save(path: Path, content: AsyncIterator[bytes]) -> None:
    size = 0
    with path.open("xb") as file:
        async for piece in content:
            size += len(piece)
            if size > FILE_MOST:
                raise BadInputError(f"{path.name}: longer than {FILE_MOST >> 30} GB")
            await asyncio.to_thread(file.write, piece)


def _plain(name: str) -> str:
    """A file's name as it can be kept. Raises BadInputError."""
    if not name or Path(name).name != name or name.startswith(".") or printable(name) != name:
        raise BadInputError(f"{printable(name)}: not a file's name")
    return name[-120:]


def _free(folder: Path, name: str) -> Path:
    """A name that nothing has yet."""
    path = folder / name
    number = 1
    while path.exists():
        number += 1
        path = folder / f"{Path(name).stem}_{number}{Path(name).suffix}"
    return path


# The routes.


STATIC = Path(__file__).with_name("static")
BODY_MOST = 1 << 16
STAND_IN_AT = "udp://127.0.0.1:19850"
"""Where the stand-in is asked to take commands, unless the operator says otherwise."""
ACTIONS = (
    "/record/start",
    "/record/stop",
    "/record/mark",
    "/link",
    "/command/stop",
    "/command/land",
    "/command/level",
    "/command/arm",
    "/command/recover",
    "/command/connect",
    "/jobs/start",
    "/jobs/cancel",
    "/models/watch",
)
"""Operations of the control API that a page may ask for, with its own ``/do`` before them."""

AT_ONCE = ("/command/stop", "/command/level")
"""Those that, as disarming, wait for nobody else's request."""
LANDS = "/command/land"
"""It takes seconds: a stop does not wait for it, nor it for another request."""
STOPS, LANDINGS, ASKS, LOOKS, ADMITS = 4, 2, 6, 4, 2
"""Threads of each of the ways to the daemon: whatever one waits for, the others are free."""

_HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self';"
    " img-src 'self' data:; connect-src 'self'; form-action 'self'; base-uri 'none';"
    " frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


_REPORT = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox; base-uri 'none';"
    " frame-ancestors 'none'"
)
"""Of a report: it holds its styles and figures, runs nothing, and belongs to no site."""


def page_app(control: Path, access: Access, follower: Follower) -> ASGIApp:
    """The page of the daemon at ``control``."""
    document = (STATIC / "page.html").read_text()
    asks, looks = _way("asks", ASKS), _way("looks", LOOKS)

    async def page(request: Request) -> Response:
        token = access.change_token(_cookie(request.headers, access))
        return HTMLResponse(document.replace("CHANGE-TOKEN", token))

    async def now(request: Request) -> Response:
        found = follower.now(_whole(request, "after"), _whole(request, "status"))
        return _json({**found, "alarms": alarms(*follower.state())})

    def shows(look: Callable[[Path], Any]) -> Callable[[Request], Awaitable[Response]]:
        """A route with what ``look`` finds by asking the daemon."""

        async def answer(request: Request) -> Response:
            try:
                return _json(await looks(look, control))
            except GroundStationError as error:
                return _refusal(503, str(error))

        return answer

    async def file(request: Request) -> Response:
        kind, name = request.path_params["kind"], request.path_params["name"]
        try:
            return await looks(_file, control, kind, name)
        except GroundStationError as error:
            return _refusal(404, str(error))

    async def static(request: Request) -> Response:
        return FileResponse(files[request.url.path[1:]])

    shown = [path for path in STATIC.rglob("*.*") if path.name != "page.html"]
    files = {str(path.relative_to(STATIC)): path for path in shown} | {THEME.name: THEME}
    app = Starlette(
        routes=[
            Route("/", page),
            Route("/now", now),
            Route("/recordings", shows(_asked("/recordings"))),
            Route("/jobs", shows(_asked("/jobs"))),
            Route("/effects", shows(_asked("/effects"))),
            Route("/models", shows(_models)),
            Route("/devices", shows(_devices)),
            Route("/file/{kind}/{name}", file),
            help_route(),
            *_opening(control, looks),
            *_parameters(control, looks, asks),
            *_doing(control, asks),
            *(Route(f"/{name}", static) for name in files),
        ]
    )
    return _Gate(app, access, control)


def _doing(control: Path, asks: Callable[..., Awaitable[Any]]) -> list[Route]:
    """What the daemon is asked to do; what stops a craft waits for nothing else."""
    stops, lands = _way("stops", STOPS), _way("lands", LANDINGS)

    async def do(request: Request) -> Response:
        body = await request.body()
        if len(body) > BODY_MOST:
            return _refusal(413, f"the request is longer than {BODY_MOST} bytes")
        try:
            content = msgspec.json.decode(body, type=dict[str, Any]) if body else None
            path = request.url.path.removeprefix("/do")
            disarms = path == "/command/arm" and content == {"on": False}
            way = stops if path in AT_ONCE or disarms else lands if path == LANDS else asks
            return _json(await way(ask, control, "POST", path, content))
        except (GroundStationError, msgspec.MsgspecError) as error:
            return _refusal(400, str(error))

    return [Route(f"/do{path}", do, methods=["POST"]) for path in ACTIONS]


def _opening(control: Path, looks: Callable[..., Awaitable[Any]]) -> list[Route]:
    """Recordings that are opened, and files that become some."""
    opening = asyncio.Lock()

    async def folder() -> Path:
        return Path((await looks(ask, control, "GET", "/config"))["recording.folder"]).absolute()

    async def series(request: Request) -> Response:
        """One at a time: each has a process of its own."""
        name = request.path_params["name"]
        try:
            path = await folder() / name
            if Path(name).name != name or name.startswith(".") or not path.is_file():
                return _refusal(404, f"{name}: no such recording")
            async with opening:
                content = await read_apart("series", path)
            return Response(content, media_type="application/octet-stream")
        except GroundStationError as error:
            return _refusal(400, str(error))

    async def added(request: Request) -> Response:
        """A file that was dropped on the page, or an example, as a recording of the folder; or the
        form that asks what its columns are, whose answers come with it then."""
        kind, name = request.path_params["kind"], request.path_params["name"]
        try:
            if kind == "example":
                return _json({"file": await add_example(await folder(), name)})
            answers = request.query_params.get("columns")
            made = await add(await folder(), name, request.stream(), answers)
            return _json({"file": made.file, "map": made.map, "said": made.said})
        except UnknownColumnsError as error:
            return _json({"form": error.form, "why": str(error)})
        except (GroundStationError, OSError) as error:
            return _refusal(400, str(error))
        except ClientDisconnect:
            return Response(status_code=499)

    async def offered(request: Request) -> Response:
        return _json(examples())

    return [
        Route("/series/{name}", series),
        Route("/examples", offered),
        Route("/add/{kind}/{name}", added, methods=["POST"]),
    ]


def _parameters(
    control: Path, looks: Callable[..., Awaitable[Any]], asks: Callable[..., Awaitable[Any]]
) -> list[Route]:
    """The craft's parameters."""

    def route(path: str, kind: Any, work: Callable[[Path, Any], Any]) -> Route:
        """Does by POST ``work`` with a body of that kind."""

        async def answer(request: Request) -> Response:
            try:
                wanted = msgspec.json.decode(await request.body(), type=kind)
                return _json(await asks(work, control, wanted))
            except (GroundStationError, msgspec.MsgspecError) as error:
                return _refusal(400, str(error))

        return Route(path, answer, methods=["POST"])

    async def parameters(request: Request) -> Response:
        try:
            return _json(await looks(_read_parameters, control))
        except GroundStationError as error:
            return _refusal(400, str(error))

    return [
        Route("/parameters", parameters),
        route("/parameters", dict[str, dict[str, float]], _write_parameters),
        route("/parameters/stored", dict[str, bool], _store_gains),
    ]


class _Gate:
    """In front of every route: who asks, from where, and what a browser may do with the answer."""

    def __init__(self, app: ASGIApp, access: Access, control: Path) -> None:
        self._app, self._access, self._control = app, access, control
        self._admits = _way("admits", ADMITS)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = dict(message["headers"])
                for name, value in _HEADERS.items():
                    headers.setdefault(name.encode(), value.encode())
                message["headers"] = list(headers.items())
            await send(message)

        refusal = await self._refused(Request(scope, receive))
        await (refusal or self._app)(scope, receive, with_headers)

    async def _refused(self, request: Request) -> Response | None:
        access, headers = self._access, request.headers
        if not access.knows_host(headers.get("host", "")) or len(headers.getlist("host")) != 1:
            return _refusal(403, "this server is 127.0.0.1")
        cookie = _cookie(headers, access)
        token = request.query_params.get("token")
        if request.url.path == "/" and request.method == "GET" and token is not None:
            return await self._admitted(token, known=access.is_session(cookie))
        if not access.is_session(cookie):
            return _closed("This browser was not let in.", 401)
        if request.method not in ("GET", "HEAD") and not access.may_change(headers, cookie):
            return _refusal(403, "this request does not come from the page")
        return None

    async def _admitted(self, token: str, *, known: bool) -> Response:
        """The address with a token opens the page and is void from then on."""
        answer = RedirectResponse("/", status_code=303)
        if known:
            return answer
        try:
            await self._admits(ask, self._control, "POST", "/page/admit", {"token": token})
        except GroundStationError as error:
            return _closed(f"{error}.", 403)
        answer.set_cookie(
            self._access.cookie, self._access.new_session(), httponly=True, samesite="strict"
        )
        return answer


def _way(name: str, threads: int) -> Callable[..., Awaitable[Any]]:
    """Calls what it is given in threads that nothing else uses."""
    pool = ThreadPoolExecutor(threads, thread_name_prefix=f"page {name}")

    def call(function: Callable[..., Any], *arguments: Any) -> Awaitable[Any]:
        return asyncio.get_running_loop().run_in_executor(pool, function, *arguments)

    return call


def _asked(path: str) -> Callable[[Path], Any]:
    """What the daemon answers there, as it is."""
    return lambda control: ask(control, "GET", path)


def _write_parameters(control: Path, wanted: dict[str, dict[str, float]]) -> dict[str, Any]:
    """Nobody else may command meanwhile. Raises GroundStationError."""
    with Pilot(control, "page") as pilot:
        return {"values": pilot.write(wanted.get("values", {}))}


def _read_parameters(control: Path) -> dict[str, Any]:
    """values: of the craft. stores: it can keep some while it is switched off, stored: those."""
    values = ask(control, "GET", "/command/parameters")["values"]
    command = ask(control, "GET", "/status")["command"]
    return {"values": values, "stores": command["stores"], "stored": command["stored"]}


def _store_gains(control: Path, wanted: dict[str, bool]) -> dict[str, Any]:
    """Store the gains that there are, or clear the stored ones; as ``_write_parameters``."""
    with Pilot(control, "page") as pilot:
        if wanted.get("clear", False):
            pilot.clear_stored()
        else:
            pilot.store()
    return _read_parameters(control)


def _devices(control: Path) -> dict[str, Any]:
    found, recordings, status = (
        ask(control, "GET", path) for path in ("/devices", "/recordings", "/status")
    )
    usable = [one["link"] for one in found["devices"] if one["usable"] and one["link"]]
    replays = [f"replay:{one['file']}" for one in recordings if one["state"] == "finished"]
    craft = [one for one in usable if "://" in one]
    commands = [STAND_IN_AT] if status["link"]["name"].startswith("stand-in") else craft
    return {**found, "links": ["stand-in", *usable, *replays[::-1]], "commands": commands}


def _models(control: Path) -> dict[str, Any]:
    found, status = (ask(control, "GET", path) for path in ("/models", "/status"))
    watching = status["twin"] and status["twin"]["model"]
    files = {one["file"] or one["id"]: one["id"] for one in found}
    flown = status["link"]["name"].partition("stand-in:")[2]
    return {"models": found, "flown": flown, "watching": files.get(watching)}


def _file(control: Path, kind: str, name: str) -> Response:
    """What the daemon says is there, and nothing else. Raises GroundStationError."""
    if kind == "recording":
        if name in [one["file"] for one in ask(control, "GET", "/recordings")]:
            folder = Path(ask(control, "GET", "/config")["recording.folder"])
            return FileResponse(folder / name, filename=name)
    elif kind == "log":
        text = ask(control, "POST", "/jobs/log", {"id": name})["text"]
        return PlainTextResponse(text)
    fields = {"model": "model_file", "gains": "gains_file", "report": "report"}
    for job in ask(control, "GET", "/jobs") if kind in fields else ():
        if job["id"] == name and (path := job[fields[kind]]):
            if kind == "report":
                return FileResponse(path, headers={"content-security-policy": _REPORT})
            return FileResponse(path, filename=name + Path(path).suffix)
    raise BadInputError(f"there is no {kind} of {name}")


def _cookie(headers: Headers, access: Access) -> str:
    """The value of our cookie, empty where there is none."""
    try:
        found = SimpleCookie(headers.get("cookie", "")).get(access.cookie)
    except CookieError:
        return ""
    return "" if found is None else found.value


def _whole(request: Request, name: str) -> int:
    text = request.query_params.get(name, "")
    return int(text) if text.isdecimal() and len(text) < 16 else 0


def _closed(text: str, status: int) -> Response:
    """For a person whose browser has no cookie."""
    from html import escape

    return HTMLResponse(
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>groundstation</title><body>'
        f"<h1>groundstation</h1><p>{escape(printable(text))}</p><p>Open the address that "
        "<code>groundstation page</code> prints in a terminal.</p></body></html>",
        status_code=status,
    )


def _refusal(status: int, text: str) -> Response:
    return _json({"error": printable(text)}, status)


def _json(content: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(content), status, media_type="application/json")
