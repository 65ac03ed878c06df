"""Connections of a cockpit that wait for a request: how long, and how many of them.

uvicorn limits neither. It refuses all pages while there are more connections than it may have.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from uvicorn.protocols.http.h11_impl import H11Protocol

if TYPE_CHECKING:
    import asyncio

REQUEST_S = 10.0  # longest time from the begin of a connection, or from an answer, to the next whole request
WAITING = 256  # most connections that wait for a request; half of those that uvicorn may have


class Connection(H11Protocol):
    """Ends if its next request comes too late; or, if too many connections wait, as the one that has waited longest."""

    late: asyncio.TimerHandle | None = None  # ends it; None: a request is answered, or it has become a socket

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self._look()
        ends = {
            connection: connection.late.when()
            for connection in self.connections
            if isinstance(connection, Connection) and connection.late
        }
        if len(ends) > WAITING:
            min(ends, key=lambda connection: ends[connection]).end()

    def data_received(self, data: bytes) -> None:
        """Take a part of a request."""
        super().data_received(data)
        self._look()

    def on_response_complete(self) -> None:
        """Begin to wait for the next request."""
        super().on_response_complete()
        self._look()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no longer."""
        super().connection_lost(exc)
        self._look()

    def end(self) -> None:
        """End the connection, and do not wait for its client."""
        self.transport.abort()
        self.connections.discard(self)
        self._look()

    def _look(self) -> None:
        cycle: Any = self.cycle  # the newest request with its answer, if any
        waits = self in self.connections and (cycle is None or cycle.response_complete)
        if waits and self.late is None:
            self.late = self.loop.call_later(REQUEST_S, self.end)
        elif not waits and self.late is not None:
            self.late.cancel()
            self.late = None
