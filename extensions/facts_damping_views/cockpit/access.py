"""Who may use a cockpit: by Host, Origin and token; and what its pages may do, by headers.

It asks for a token, also at 127.0.0.1, where every user of the computer can connect. The printed address holds it, and
a cookie afterwards. The Host header must be one under which it serves (DNS rebinding), and the Origin of the socket the
page's own. Other sites may open the page, but fetch nothing (Sec-Fetch-Site; programs and old browsers send none).
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
SITES = ("same-origin", "none")  # Sec-Fetch-Site of what the page asks for, and of an address that the user gives
# What the address with the token answers. A redirect would not do: after a link from another site it lacks the cookie.
OPENS = '<!DOCTYPE html><link rel="icon" href="data:,"><meta http-equiv="refresh" content="0; url=/">'

# Scripts and data come from this server alone. A report has its scripts inside: it runs without this origin's rights.
POLICY = (
    "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'self'"
)
REPORT_POLICY = "sandbox allow-scripts allow-popups"
HEADERS = {"x-content-type-options": "nosniff", "referrer-policy": "no-referrer", "cache-control": "no-store"}


class RequestFilter:
    """Refuses requests under another host, from another origin or site, or without the token."""

    def __init__(self, app: Callable[..., Awaitable[None]], host: str, token: str, count: Callable[[], None]) -> None:
        """`count`: called for each refused request."""
        self._app, self._token, self._count = app, token, count
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
        if not refused and self._is_token(requests.HTTPConnection(scope).cookies.get(cookie, "")):
            await self._app(scope, receive, _with_headers(send, datastructures.MutableHeaders))
            return
        token = requests.HTTPConnection(scope).query_params.get("token", "")
        if not refused and scope["path"] == "/" and self._is_token(token):
            answer = responses.HTMLResponse(OPENS)
            answer.set_cookie(cookie, self._token, httponly=True, samesite="strict")
        else:
            self._count()
            reason = refused or "token: none or another given; allowed: the address as printed"
            answer = responses.PlainTextResponse(reason, 403)
        if scope["type"] == "websocket":
            await receive()  # websocket.connect
            await send({"type": "websocket.close", "code": 4403})  # before it is accepted: status 403
            return
        await answer(scope, receive, _with_headers(send, datastructures.MutableHeaders))

    def _is_token(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self._token.encode())

    def _refused(self, scope: Any, headers: Any) -> str:
        """Why a request is refused by its Host, Origin and site; empty if it is not."""
        host = headers.get("host", "").lower()
        name, port = (scope.get("server") or ("", None))[:2]
        hosts = [f"[{host_name}]" if ":" in host_name else host_name for host_name in (*self._names, str(name).lower())]
        allowed = {f"{host_name}:{port}" for host_name in hosts} | (set(hosts) if port == HTTP else set())
        if host not in allowed or len(headers.getlist("host")) != 1:
            return f"Host: {host[:80]} given; allowed: {', '.join(sorted(allowed))}"
        origin, own_origin = headers.get("origin"), f"http://{host}"
        if origin != own_origin and (origin is not None or scope["type"] == "websocket"):
            return f"Origin: {(origin or 'none')[:80]} given; allowed: {own_origin}"
        site, opens = headers.get("sec-fetch-site", "none"), headers.get("sec-fetch-dest") == "document"
        if scope["type"] == "http" and site not in SITES and not (opens and scope["path"] == "/"):
            return f"Sec-Fetch-Site: {site[:80]} given; allowed: {', '.join(SITES)}"
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


def new_token() -> str:
    """A token that nobody can guess."""
    return secrets.token_urlsafe(24)
