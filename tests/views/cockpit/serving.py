"""A served cockpit, and its page's requests without a browser."""

from __future__ import annotations

import socket
from contextlib import contextmanager
from typing import TYPE_CHECKING

from websockets.sync.client import connect
from websockets.typing import Origin

from facts_damping.nodes.base.asyncio_thread import AsyncioThread
from facts_damping_views.cockpit import application, server

if TYPE_CHECKING:
    from collections.abc import Iterator

    from websockets.sync.client import ClientConnection


@contextmanager
def serving(cockpit: application.Cockpit) -> Iterator[tuple[server.Server, AsyncioThread]]:
    """Serve a cockpit at a free port, in a thread."""
    served, thread = server.Server(cockpit, "127.0.0.1", 0), AsyncioThread()
    running = thread.begin(served.serve())
    try:
        yield served, thread
    finally:
        served.stop()
        running.result(5.0)
        thread.close()


def cookie(address: str) -> dict[str, str]:
    """The header that a browser sends after it has opened the printed address."""
    origin, _, token = address.partition("/?token=")
    return {"Cookie": f"cockpit_{origin.rpartition(':')[2]}={token}"}


def page_socket(address: str) -> ClientConnection:
    """Connect as the page at the printed address does."""
    origin = address.partition("/?")[0]
    place = f"{origin.replace('http', 'ws')}/socket"
    return connect(place, origin=Origin(origin), max_size=None, additional_headers=cookie(address))


def request(address: str, path: str, more: str = "") -> socket.socket:
    """A connection that has asked for a path; `more`: further lines, each with its end."""
    origin = address.partition("/?")[0]
    connection = socket.create_connection(("127.0.0.1", int(origin.rpartition(":")[2])), timeout=10.0)
    head = f"GET {path} HTTP/1.1\r\nHost: {origin.removeprefix('http://')}\r\nCookie: {cookie(address)['Cookie']}\r\n"
    connection.sendall(f"{head}{more}\r\n".encode())
    return connection
