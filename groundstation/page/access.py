"""Who may use the page: browsers that opened a one-time address, from pages of this server."""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Iterable, Mapping

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
