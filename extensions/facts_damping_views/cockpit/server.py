"""The web server of a cockpit: its socket and its life; what it serves is in application.py."""

from __future__ import annotations

import socket
from typing import Any

from facts_damping.errors import InputError
from facts_damping.extras import library
from facts_damping_views.cockpit.access import EXTRA
from facts_damping_views.cockpit.application import CLIENTS, LONGEST, SEND_S, Cockpit

EVERYWHERE = ("0.0.0.0", "::")  # noqa: S104 (only if `--host` says so)
SEND_BYTES = 65536  # of a connection's buffer in the kernel


def check_libraries() -> None:
    """Raise `InputError` if a library of the extra is not installed."""
    for name in ("starlette", "uvicorn", "websockets"):
        library(name, EXTRA)


class Server:
    """A uvicorn server of a cockpit at a host and port (0: a free one). Raises `InputError` if it cannot listen."""

    def __init__(self, cockpit: Cockpit, host: str, port: int) -> None:
        uvicorn = library("uvicorn", EXTRA)
        from facts_damping_views.cockpit import connections  # noqa: PLC0415 (it needs uvicorn)

        try:
            self._socket = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
        except (OSError, OverflowError) as error:
            raise InputError(f"host, port: {host}, {port} given: {error}; allowed: ones that are free here") from error
        # For all its connections: a client that stops reading keeps little, and not for long.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(2e3 * SEND_S))
        self.port: int = self._socket.getsockname()[1]
        more: dict[str, Any] = {"ws": "websockets-sansio", "ws_max_size": LONGEST, "ws_per_message_deflate": False}
        more |= {"http": connections.Connection, "backlog": connections.WAITING}
        more |= {"lifespan": "off", "log_config": None, "log_level": "critical", "access_log": False}
        more |= {"server_header": False, "timeout_graceful_shutdown": 1, "limit_concurrency": 16 * CLIENTS}
        self._server = uvicorn.Server(uvicorn.Config(cockpit.app, **more))
        reached = socket.gethostname() if host in EVERYWHERE else host
        shown = f"[{reached}]" if ":" in reached else reached
        self.address = f"http://{shown}:{self.port}/?token={cockpit.token}"

    async def serve(self) -> None:
        """Serve until `stop`."""
        await self._server.serve(sockets=[self._socket])

    def stop(self) -> None:
        """End `serve` within about a second."""
        self._server.should_exit = True
