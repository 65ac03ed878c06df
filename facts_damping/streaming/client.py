"""A client of one stream: connects, asks for the configuration, has data turned on; and again when it is lost.

IEEE C37.118.2, annex F: over TCP, or by UDP to the server's port, it commands. Spontaneous data by UDP, to an address
of this computer or to a group, are only listened to; their configuration comes by itself.
"""

from __future__ import annotations

import asyncio
import socket
import time
from contextlib import suppress
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any, Protocol

from facts_damping.c37118 import frame
from facts_damping.c37118.configuration import TIME_BASE, Configuration
from facts_damping.c37118.session import Instant, Receiver
from facts_damping.errors import one_line
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.parameters.streams import Server

CONNECT_S = 5.0  # longest wait for a connection
ANSWER_S = 1.0  # wait for a configuration before it is asked for again
SILENT_S = 5.0  # silence after which a server is asked whether it is there; as long again, and it is taken for lost
AGAIN_S = 1.0  # between two attempts
CHUNK = 1 << 16
ASKED = ("send_configuration_3", "send_configuration_2")  # by turns, as not every server knows 3


class Lost(str):
    """Why a connection is not there, or not any more."""

    __slots__ = ()


class _Wire(Protocol):
    """What carries bytes to a server and from it."""

    async def receive(self) -> bytes:
        """The next bytes; none: the server has closed."""

    def send(self, data: bytes) -> None:
        """Bytes to the server."""

    def close(self) -> None:
        """Let go."""


class Client:
    """Tells what comes: a configuration, an instant, or why there is no connection."""

    def __init__(self, server: Server, tell: Callable[[Configuration | Instant | Lost], None]) -> None:
        """`tell` is called in the event loop that `run` is awaited in."""
        self.server, self._tell = server, tell
        self.receiver, self.connections = Receiver(server.idcode), 0
        self._kind, self._answered = 0, True  # which of ASKED the server answers, and whether it has
        self._asked_s = self._heard_s = -ANSWER_S

    async def run(self) -> None:
        """Until it is cancelled."""
        while True:
            try:
                wire = await self._connect()
            except (OSError, UnicodeError) as error:
                self._tell(Lost(one_line(error)))
            else:
                self.connections += 1
                try:
                    self._tell(Lost(await self._serve(wire)))
                except OSError as error:
                    self._tell(Lost(one_line(error)))
                finally:
                    if self.server.kind == "udp":
                        self._command(wire, "turn_off")
                    wire.close()
            await asyncio.sleep(AGAIN_S)

    async def _connect(self) -> _Wire:
        """The way to the server. Raises OSError."""
        opening = asyncio.ensure_future(_open(self.server))
        try:
            if not (await asyncio.wait({opening}, timeout=CONNECT_S))[0]:
                raise OSError(f"no connection within {CONNECT_S:g} s")
            return opening.result()
        finally:
            opening.cancel()

    async def _serve(self, wire: _Wire) -> str:
        """One connection, to its end, and why it ended."""
        receiver, old = Receiver(self.server.idcode), self.receiver
        receiver.lost_bytes, receiver.refused = old.lost_bytes, old.refused
        self.receiver, self._asked_s, self._heard_s = receiver, -ANSWER_S, time.monotonic()
        coming = asyncio.ensure_future(wire.receive())
        try:
            while True:
                now = time.monotonic()
                if now - self._heard_s > 2.0 * SILENT_S and not self.server.spontaneous:
                    return f"silent for {now - self._heard_s:.0f} s"
                if receiver.changed or now - self._heard_s > SILENT_S:
                    self._ask(wire, now)
                if not (await asyncio.wait({coming}, timeout=ANSWER_S))[0]:
                    continue
                if not (received := coming.result()):
                    return "closed by the server"
                self._take(wire, received)
                coming = asyncio.ensure_future(wire.receive())
        finally:
            coming.cancel()

    def _take(self, wire: _Wire, received: bytes) -> None:
        """What has come; data are turned on as soon as the configuration is known."""
        self._heard_s, receiver = time.monotonic(), self.receiver
        for one in receiver.take([received]) if self.server.kind == "udp" else receiver.feed(received):
            if isinstance(one, Configuration):
                self._answered = True
                self._command(wire, "turn_on")
            if not isinstance(one, str):
                self._tell(one)

    def _ask(self, wire: _Wire, now: float) -> None:
        """Ask for the configuration, once in a while; for the other kind, where that is not answered."""
        if now - self._asked_s < ANSWER_S:
            return
        if not self._answered:
            self._kind = (self._kind + 1) % len(ASKED)
        self._asked_s, self._answered = now, False
        self._command(wire, ASKED[self._kind])

    def _command(self, wire: _Wire, name: str) -> None:
        if not self.server.spontaneous:
            second, part = divmod(time.time_ns() * TIME_BASE // NANOSECONDS, TIME_BASE)
            wire.send(frame.command(self.server.idcode, name, second, part))


class _Tcp:
    """A connection."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer

    async def receive(self) -> bytes:
        return await self._reader.read(CHUNK)

    def send(self, data: bytes) -> None:
        self._writer.write(data)

    def close(self) -> None:
        self._writer.close()


class _Udp(asyncio.DatagramProtocol):
    """Datagrams, each a frame."""

    def __init__(self) -> None:
        self._come: asyncio.Queue[bytes] = asyncio.Queue()
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: Any) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, _from: Any) -> None:
        if data:
            self._come.put_nowait(data)

    def error_received(self, exc: Exception) -> None:
        """Nobody is there yet: it is asked again."""

    async def receive(self) -> bytes:
        return await self._come.get()

    def send(self, data: bytes) -> None:
        if self._transport is not None:
            self._transport.sendto(data)

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()


async def _open(server: Server) -> _Wire:
    """The way to a server. Raises OSError."""
    if server.kind == "tcp":
        return _Tcp(*await asyncio.open_connection(server.host, server.port))
    way: dict[str, Any] = {"remote_addr": (server.host, server.port)}
    if server.spontaneous:
        way = {"sock": _listening(server)}
    return (await asyncio.get_running_loop().create_datagram_endpoint(_Udp, **way))[1]


def _join(made: socket.socket, group: str, interface: str) -> None:
    member = socket.inet_aton(group) + socket.inet_aton(interface)
    made.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)


def _listening(server: Server) -> socket.socket:
    """A socket that hears what is sent to an address of this computer, or to a group that it joins."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((server.host, server.port))
        if ip_address(server.host).is_multicast:
            _join(made, server.host, "127.0.0.1")
            with suppress(OSError):  # this computer may have no other network
                _join(made, server.host, "0.0.0.0")  # noqa: S104 (whichever interface leads there)
    except OSError:
        made.close()
        raise
    made.setblocking(False)
    return made
