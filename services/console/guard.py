"""Who may speak to the console: the first thing every request passes.

Any page that the operator's browser shows could send requests here, and a foreign name can be made to point at this
machine (DNS rebinding). So Host must be one of the console's own names *with its port*, Origin the same, and off
loopback a token is demanded.
"""

from __future__ import annotations

import hmac
import http.cookies
import ipaddress
import json
import secrets
import socket
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import parse_qsl, urlencode

from common import clock
from common.refusals import Refusals

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

COOKIE = "tagmill_console"
OPEN_PATHS = frozenset({"/healthz"})
"""Say nothing but yes or no, so that a watchdog needs no token."""
WRONG_TOKENS = 10
"""So many a minute from one address are told that they are wrong; more get 429. The right one is heard at all times:
a page with a stack's old token must not keep its operator out, and 256 bits are not guessed at any rate."""
_TOO_MANY = 429, "too_many_tries", "too many wrong tokens from this address; wait a minute, and see the console's log"
_MINUTE_NS = 60_000_000_000
_MOST_ADDRESSES = 1024
_SAFE = frozenset({"GET", "HEAD"})
_POLICY = (
    "default-src 'none'; script-src 'self'{hashes}; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)


@dataclass(frozen=True, slots=True)
class Rules:
    """``hosts``: allowed values of Host; with ``any_address`` also any IP address with ``port``, which no foreign
    name can stand for. ``token``: demanded of everybody, None on loopback.
    """

    port: int
    hosts: frozenset[str]
    any_address: bool = False
    token: str | None = None
    script_hashes: tuple[str, ...] = field(default=())

    def host_allowed(self, host: str) -> bool:
        """Whether a request for this Host is meant for the console."""
        lowered = host.lower()
        if lowered in self.hosts:
            return True
        name, _, port = lowered.rpartition(":")
        if not self.any_address or port != str(self.port):
            return False
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return True


def rules_for(bind_host: str, port: int, token: str | None) -> Rules:
    """The rules of a console bound to ``bind_host``."""
    names = {"localhost", "127.0.0.1", "[::1]", f"[{bind_host}]" if ":" in bind_host else bind_host}
    local = is_loopback(bind_host)
    if not local:
        names |= {socket.gethostname().lower(), f"{socket.gethostname().lower()}.local"}
    hosts = {f"{name}:{port}" for name in names} | (names if port == 80 else set())
    return Rules(port, frozenset(hosts), any_address=not local and _is_wildcard(bind_host), token=token)


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches a socket bound to ``host``."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def _is_wildcard(host: str) -> bool:
    try:
        return ipaddress.ip_address(host.strip("[]")).is_unspecified
    except ValueError:
        return False


def new_token() -> str:
    """256 bits, fit for a URL."""
    return secrets.token_urlsafe(32)


class Guard:
    """ASGI: refuses what isn't meant for the console or not allowed, sets the security headers on all answers.

    ``hashes`` gives the page's inline scripts' hashes for the content security policy.
    """

    def __init__(self, app: Application, rules: Rules, hashes: Callable[[], Iterable[str]] = tuple) -> None:
        self._app = app
        self._rules = rules
        self._hashes = hashes
        self._refusals = Refusals("console.refused")
        self._wrong: dict[str, tuple[int, int]] = {}

    @property
    def refused(self) -> int:
        """How many requests were refused so far."""
        return self._refusals.total

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """See ASGI."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        headers = _headers(scope)
        fault = self._fault(scope, headers)
        if fault is None and self._rules.token is not None:
            if scope["type"] == "http" and _given_token(scope) is not None:
                await self._log_in(scope, send)
                return
            fault = self._token_fault(scope, headers)
        if fault is not None:
            self._refusals.note(_address(scope), fault[1])
            await self._refuse(scope, receive, send, *fault)
            return
        await self._app(scope, receive, self._with_headers(send))

    def _fault(self, scope: Scope, headers: dict[str, str]) -> tuple[int, str, str] | None:
        host = headers.get("host", "")
        if not self._rules.host_allowed(host):
            return 421, "wrong_host", f"this is not {host or 'a host without a name'}; use the address in the log"
        origin = headers.get("origin")
        if origin is not None and origin.lower() != f"http://{host.lower()}":
            return 403, "wrong_origin", "a page of another origin may not use this console"
        site = headers.get("sec-fetch-site", "none")
        if site in {"cross-site", "same-site"} and headers.get("sec-fetch-mode") != "navigate":
            return 403, "wrong_origin", "a page of another origin may not use this console"
        if scope["type"] == "http" and scope["method"] not in _SAFE:
            kind = headers.get("content-type", "").split(";")[0].strip().lower()
            if kind != "application/json":
                return 415, "not_json", "send JSON, with 'Content-Type: application/json'"
        return None

    def _token_fault(self, scope: Scope, headers: dict[str, str]) -> tuple[int, str, str] | None:
        if scope["path"] in OPEN_PATHS:
            return None
        given = [one for one in (_cookie(headers, self._rules.port), _bearer(headers)) if one is not None]
        if any(self._fits(one) for one in given):
            return None
        if given and self._count_wrong(scope):
            return _TOO_MANY
        return 401, "no_token", "open the address with the token that the console's log shows"

    def _fits(self, given: str) -> bool:
        assert self._rules.token is not None
        return hmac.compare_digest(given.encode(), self._rules.token.encode())

    def _count_wrong(self, scope: Scope) -> bool:
        """Whether too many wrong tokens have come from there within the minute."""
        address, now = _address(scope), clock.monotonic_ns()
        since_ns, count = self._wrong.pop(address, (now, 0))
        fresh = now - since_ns >= _MINUTE_NS
        self._wrong[address] = (now, 1) if fresh else (since_ns, count + 1)
        if len(self._wrong) > _MOST_ADDRESSES:
            del self._wrong[next(iter(self._wrong))]
        return not fresh and count >= WRONG_TOKENS

    async def _log_in(self, scope: Scope, send: Send) -> None:
        """From the address with the token to a clean one, with the cookie."""
        if not self._fits(_given_token(scope) or ""):
            wrong = 401, "no_token", "that token is not valid (any more); see the console's log"
            status, code, message = _TOO_MANY if self._count_wrong(scope) else wrong
            self._refusals.note(_address(scope), "wrong_token")
            await _answer(send, status, code, message)
            return
        rest = [(name, value) for name, value in _query(scope) if name != "token"]
        path = "/" + scope["path"].lstrip("/")  # '//elsewhere' would leave this host
        where = path + (f"?{urlencode(rest)}" if rest else "")
        cookie = f"{COOKIE}_{self._rules.port}={self._rules.token}; Path=/; HttpOnly; SameSite=Strict; Max-Age=2592000"
        headers = [(b"location", where.encode()), (b"set-cookie", cookie.encode()), (b"content-length", b"0")]
        await send({"type": "http.response.start", "status": 303, "headers": [*headers, *self._security()]})
        await send({"type": "http.response.body", "body": b""})

    async def _refuse(self, scope: Scope, receive: Receive, send: Send, status: int, code: str, message: str) -> None:
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": message})
            return
        await _answer(send, status, code, message)

    def _with_headers(self, send: Send) -> Send:
        async def sending(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *self._security()]
            await send(message)

        return sending

    def _security(self) -> list[tuple[bytes, bytes]]:
        hashes = "".join(f" 'sha256-{each}'" for each in self._hashes())
        return [
            (b"content-security-policy", _POLICY.format(hashes=hashes).encode()),
            (b"x-content-type-options", b"nosniff"),
            (b"referrer-policy", b"no-referrer"),
            (b"cross-origin-resource-policy", b"same-origin"),
            (b"cross-origin-opener-policy", b"same-origin"),
        ]


def _address(scope: Scope) -> str:
    client = scope.get("client")
    return str(client[0]) if client else "?"


async def _answer(send: Send, status: int, code: str, message: str) -> None:
    body = json.dumps({"ok": False, "error": {"code": code, "message": message}}).encode()
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
    headers += [(b"x-content-type-options", b"nosniff"), (b"content-security-policy", b"default-src 'none'")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


def _headers(scope: Scope) -> dict[str, str]:
    """The headers by lower-case name; a repeated Host or Origin makes a value that no rule allows."""
    found: dict[str, str] = {}
    for raw_name, raw_value in scope["headers"]:
        name, value = raw_name.decode("latin-1").lower(), raw_value.decode("latin-1")
        found[name] = f"{found[name]}, {value}" if name in found and name != "cookie" else value
    return found


def _query(scope: Scope) -> list[tuple[str, str]]:
    return parse_qsl(scope.get("query_string", b"").decode("latin-1"), keep_blank_values=True)


def _given_token(scope: Scope) -> str | None:
    return next((value for name, value in _query(scope) if name == "token"), None)


def _cookie(headers: dict[str, str], port: int) -> str | None:
    try:
        cookies = http.cookies.SimpleCookie(headers.get("cookie", ""))
    except http.cookies.CookieError:
        return None
    found = cookies.get(f"{COOKIE}_{port}")
    return None if found is None else found.value


def _bearer(headers: dict[str, str]) -> str | None:
    scheme, _, token = headers.get("authorization", "").partition(" ")
    return token.strip() if scheme.lower() == "bearer" else None
