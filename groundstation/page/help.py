"""The documentation under Help: the site that ``make docs`` has built, where it is there."""

from __future__ import annotations

import base64
import hashlib
import re
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles

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
