"""Who may ask, what may be asked, and how large it may be.

The page is on the loopback of a machine that other users and other pages share. A foreign page can
send requests here (CSRF), even as if from this origin where its name suddenly means 127.0.0.1 (DNS
rebinding); so the Host, the Origin and a token that only the user was told are looked at before
anything else.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from urllib.parse import parse_qs

from georef_gis.app.web.bodies import MOST_BODY, Body, Message, Receive, Scope, Send

App = Callable[[Scope, Receive, Send], Awaitable[None]]

TOKEN_BYTES = 32
_METHODS = ("GET", "POST")
_PAGE_CSP = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; font-src 'self'; frame-src 'self'; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'"
)
HEADERS = {
    "content-security-policy": _PAGE_CSP,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=()",
    "cache-control": "no-store",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """Where the page is and what opens it."""

    port: int
    token: str = field(default_factory=lambda: secrets.token_urlsafe(TOKEN_BYTES), repr=False)

    @property
    def hosts(self) -> tuple[str, ...]:
        """Names under which the page may be asked for."""
        return f"127.0.0.1:{self.port}", f"localhost:{self.port}"

    @property
    def cookie(self) -> str:
        """Name of the cookie: ports of a machine share their cookies."""
        return f"georef_{self.port}"

    @property
    def address(self) -> str:
        """What the user opens."""
        return f"http://127.0.0.1:{self.port}/?token={self.token}"


class _Refused(Exception):
    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status = status


class Guard:
    """ASGI application around another: refuses what must not get there."""

    def __init__(self, app: App, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Take a request."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            # A socket that is not accepted is closed.
            await send({"type": "websocket.close", "code": 1008})
            return
        body = Body(scope, receive, send)
        try:
            headers = _headers(scope)
            self._check_place(scope, headers)
            if self._is_entry(scope):
                await self._enter(body.send)
                return
            self._check_token(headers)
            _check_length(headers)
        except _Refused as refused:
            await _refuse(body.send, refused.status, str(refused))
            return
        await self._app(scope, body.receive, _with_headers(body.send))

    def _check_place(self, scope: Scope, headers: dict[str, str]) -> None:
        method, host = scope["method"], headers.get("host", "")
        if host not in self._access.hosts:
            raise _Refused(421, "this host name is not served; open the address that was printed")
        if method not in _METHODS:
            raise _Refused(405, f"method {method[:20]} is not served; use GET or POST")
        origin = headers.get("origin")
        if origin is None and method == "POST":
            raise _Refused(403, "a POST must say its Origin; use the page itself")
        if origin is not None and origin != f"http://{host}":
            raise _Refused(403, "another page's requests are not served; use the page itself")
        site = headers.get("sec-fetch-site", "none")
        # A link elsewhere may lead to the page, which then finds no token.
        if site not in ("same-origin", "none") and scope["path"] != "/":
            raise _Refused(403, "another page's requests are not served; use the page itself")

    def _is_entry(self, scope: Scope) -> bool:
        """Whether the request brings the token in the address."""
        if scope["path"] != "/" or scope["method"] != "GET":
            return False
        try:
            query = parse_qs(scope["query_string"].decode("latin-1"), max_num_fields=10)
        except ValueError as error:
            raise _Refused(400, "the address cannot be read") from error
        given = query.get("token", [""])[0]
        if not given:
            return False
        if not self._is_token(given):
            raise _Refused(403, "the token is not right; open the address that was printed")
        return True

    async def _enter(self, send: Send) -> None:
        """Turn the token of the address into a cookie, and take it out of the address."""
        cookie = f"{self._access.cookie}={self._access.token}; Path=/; HttpOnly; SameSite=Strict"
        headers = {**HEADERS, "location": "/", "set-cookie": cookie, "content-length": "0"}
        await send({"type": "http.response.start", "status": 303, "headers": _raw(headers)})
        await send({"type": "http.response.body", "body": b""})

    def _check_token(self, headers: dict[str, str]) -> None:
        for part in headers.get("cookie", "").split(";"):
            name, _, value = part.strip().partition("=")
            if name == self._access.cookie and self._is_token(value):
                return
        raise _Refused(403, "the token is missing; open the address that `georef serve` printed")

    def _is_token(self, given: str) -> bool:
        return secrets.compare_digest(given.encode("utf-8"), self._access.token.encode("utf-8"))


def _headers(scope: Scope) -> dict[str, str]:
    """Headers of a request, each once."""
    out: dict[str, str] = {}
    for raw, value in scope["headers"]:
        name = raw.decode("latin-1").lower()
        if name in out and name != "cookie":
            # Two hosts or lengths are how one server is made to differ from another.
            if name in ("host", "origin", "content-length", "content-type"):
                raise _Refused(400, f"header {name} is there twice")
            continue
        joined = f"{out[name]}; " if name in out else ""
        out[name] = joined + value.decode("latin-1")
    return out


def _check_length(headers: dict[str, str]) -> None:
    length = headers.get("content-length", "0")
    if not length.isdigit():
        raise _Refused(400, "content-length is no number")
    if int(length[:20]) > MOST_BODY:
        raise _Refused(413, f"the request is larger than {MOST_BODY / 1e6:g} MB")


def _with_headers(send: Send) -> Send:
    """Add the headers that every answer has, where it does not set them itself."""

    async def add(message: Message) -> None:
        if message["type"] == "http.response.start":
            own = [(bytes(name).lower(), value) for name, value in message.get("headers", ())]
            names = {name for name, _ in own}
            more = [pair for pair in _raw(HEADERS) if pair[0] not in names]
            message = {**message, "headers": [*own, *more]}
        await send(message)

    return add


async def _refuse(send: Send, status: int, reason: str) -> None:
    body = json.dumps({"error": reason}).encode() + b"\n"
    headers = {**HEADERS, "content-type": "application/json", "content-length": str(len(body)),
               "connection": "close"}  # fmt: skip
    await send({"type": "http.response.start", "status": status, "headers": _raw(headers)})
    await send({"type": "http.response.body", "body": body})


def _raw(headers: dict[str, str]) -> list[tuple[bytes, bytes]]:
    return [(name.encode("latin-1"), value.encode("latin-1")) for name, value in headers.items()]
