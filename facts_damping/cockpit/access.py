"""Who may use a cockpit: by Host, Origin and token; and what its pages may do, by headers.

The server listens at 127.0.0.1 unless told otherwise; elsewhere it asks for a token, which the address holds once and a
cookie afterwards. The Host header must be one under which it serves (DNS rebinding), and the Origin of the socket the
page's own.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from typing import TYPE_CHECKING, Any

from facts_damping.extras import library

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

EXTRA = "cockpit"
HTTP = 80  # port that a Host header leaves out

# Scripts and data come from this server alone. A report has its scripts inside: it runs without this origin's rights.
POLICY = (
    "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'self'"
)
REPORT_POLICY = "sandbox allow-scripts allow-popups"
HEADERS = {"x-content-type-options": "nosniff", "referrer-policy": "no-referrer", "cache-control": "no-store"}


class RequestFilter:
    """Refuses requests under another host, from another origin, or without the token."""

    def __init__(self, app: Callable[..., Awaitable[None]], host: str, token: str | None) -> None:
        self._app, self._token = app, token
        self._names = {"127.0.0.1", "localhost"} if is_loopback(host) else {host, socket.gethostname().lower()}

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Serve a request that is allowed."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        responses = library("starlette.responses", EXTRA)
        requests, datastructures = library("starlette.requests", EXTRA), library("starlette.datastructures", EXTRA)
        headers, cookie = requests.HTTPConnection(scope).headers, f"cockpit_{(scope.get('server') or ('', 0))[1]}"
        refused = self._refused(scope, headers)
        if refused:
            answer = responses.PlainTextResponse(refused, 403)
        elif self._token is None or self._is_token(requests.HTTPConnection(scope).cookies.get(cookie, "")):
            await self._app(scope, receive, _with_headers(send, datastructures.MutableHeaders))
            return
        elif scope["path"] == "/" and self._is_token(requests.HTTPConnection(scope).query_params.get("token", "")):
            answer = responses.RedirectResponse("/", 303)
            answer.set_cookie(cookie, self._token, httponly=True, samesite="strict")
        else:
            answer = responses.PlainTextResponse("token: none or another given; allowed: the address as printed", 403)
        if scope["type"] == "websocket":
            await receive()  # websocket.connect
            await send({"type": "websocket.close", "code": 4403})  # before it is accepted: status 403
            return
        await answer(scope, receive, _with_headers(send, datastructures.MutableHeaders))

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), (self._token or "").encode())

    def _refused(self, scope: Any, headers: Any) -> str:
        """Why a request is refused by its Host and Origin; empty if it is not."""
        host = headers.get("host", "").lower()
        name, port = (scope.get("server") or ("", None))[:2]
        hosts = [f"[{one}]" if ":" in one else one for one in (*self._names, str(name).lower())]
        allowed = {f"{one}:{port}" for one in hosts} | (set(hosts) if port == HTTP else set())
        if host not in allowed or len(headers.getlist("host")) != 1:
            return f"Host: {host[:80]} given; allowed: {', '.join(sorted(allowed))}"
        origin, own = headers.get("origin"), f"http://{host}"
        if origin != own and (origin is not None or scope["type"] == "websocket"):
            return f"Origin: {(origin or 'none')[:80]} given; allowed: {own}"
        return ""


def _with_headers(send: Any, headers_of: Any) -> Any:
    async def sending(message: Any) -> None:
        if message["type"] == "http.response.start":
            headers = headers_of(scope=message)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return sending


def is_loopback(host: str) -> bool:
    """Whether an address is that of this computer alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def new_token(host: str) -> str | None:
    """A token for a server that others can reach; None: it needs none."""
    return None if is_loopback(host) else secrets.token_urlsafe(24)
