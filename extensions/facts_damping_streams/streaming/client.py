"""A client of one stream: connects, requests the configuration, turns data on, and reconnects when the stream is lost.

IEEE C37.118.2, annex F: the client sends commands over TCP, or over UDP to the server's port. Spontaneous UDP data, to
an address of this computer or a multicast group, are only received; their configuration arrives by itself.
"""

from __future__ import annotations

import asyncio
import socket
import time
from contextlib import suppress
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any

from facts_damping.errors import one_line
from facts_damping.signals import NANOSECONDS
from facts_damping_streams.c37118 import frame
from facts_damping_streams.c37118.configuration import TIME_BASE, Configuration
from facts_damping_streams.c37118.session import Instant, Receiver

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping_streams.parameters import Server

CONNECT_S = 5.0  # timeout of a connection attempt
ANSWER_S = 1.0  # time after which a configuration is requested again
SILENT_S = 5.0  # silence after which the server is queried; after the same time again it counts as lost
AGAIN_S = 1.0  # time between two attempts
CHUNK = 1 << 16
RUBBISH = 1 << 16  # bytes outside of frames after which a server speaks another protocol, in one connection
UNREAD = 1 << 16  # bytes of commands that a server may leave unread
DATAGRAMS = 256  # that wait to be decoded; further ones are dropped
BURST_S = 60.0  # s of data that may come at once, as after a stall
QUICK = 2.0  # largest pace of the other data, in relation to the configured rate
SHARE = 0.25  # largest share of a processor that decoding one stream takes
BUSY_S = 0.01  # time between two looks whether the reader of results is still busy
ASKED = ("send_configuration_3", "send_configuration_2")  # tried alternately: not every server knows configuration 3


class Lost(str):
    """Why there is no connection."""

    __slots__ = ()


class Client:
    """Reports configurations, instants, and lost connections."""

    def __init__(
        self,
        server: Server,
        tell: Callable[[Configuration | Instant | Lost], None],
        busy: Callable[[], bool] = lambda: False,
    ) -> None:
        """`tell` is called in the event loop that awaits `run`; nothing more is read while its reader is `busy`."""
        self.server, self._tell, self._busy = server, tell, busy
        self.receiver, self.connections = Receiver(server.idcode), 0
        self._kind, self._answered = 0, True  # index in ASKED of the request in use, and whether it was answered
        self._asked_s = self._received_s = -ANSWER_S
        self._since_s, self._frames, self._rate = 0.0, 0, 1  # of this connection: its begin, data frames, frames/s

    async def run(self) -> None:
        """Run until cancelled."""
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

    async def _connect(self) -> _Tcp | _Udp:
        """Connect to the server. Raises OSError."""
        opening = asyncio.ensure_future(_open(self.server))
        try:
            if not (await asyncio.wait({opening}, timeout=CONNECT_S))[0]:
                raise OSError(f"no connection within {CONNECT_S:g} s")
            return opening.result()
        finally:
            opening.cancel()

    async def _serve(self, wire: _Tcp | _Udp) -> str:
        """Serve one connection; returns the reason of its end."""
        receiver, old = Receiver(self.server.idcode), self.receiver
        receiver.lost_bytes, receiver.refused = old.lost_bytes, old.refused
        self.receiver, self._asked_s, self._received_s = receiver, -ANSWER_S, time.monotonic()
        self._since_s, self._frames, self._rate = self._received_s, 0, 1
        receiving = asyncio.ensure_future(wire.receive())
        try:
            while True:
                now = time.monotonic()
                if now - self._received_s > 2.0 * SILENT_S and not self.server.spontaneous:
                    return f"silent for {now - self._received_s:.0f} s"
                if receiver.changed or now - self._received_s > SILENT_S:
                    self._ask(wire, now)
                if not (await asyncio.wait({receiving}, timeout=ANSWER_S))[0]:
                    continue
                if not (received := receiving.result()):
                    return "closed by the server"
                began_s = time.thread_time()
                self._take(wire, received)
                if flaw := self._flaw(wire, receiver.lost_bytes - old.lost_bytes):
                    return flaw
                await self._rest(time.thread_time() - began_s)
                receiving = asyncio.ensure_future(wire.receive())
        finally:
            receiving.cancel()

    def _flaw(self, wire: _Tcp | _Udp, lost_bytes: int) -> str:
        """Why a connection has to be closed; empty if it may go on."""
        if self.server.kind == "tcp" and lost_bytes > RUBBISH:
            return f"{lost_bytes} bytes in no frame of C37.118.2; allowed: {RUBBISH} in a connection"
        allowed = self._rate * (BURST_S + QUICK * (self._received_s - self._since_s))
        if self._frames > allowed:
            return f"{self._frames} data frames in {self._received_s - self._since_s:.0f} s; allowed: {allowed:.0f}"
        return f"{wire.unread} bytes of commands unread; allowed: {UNREAD}" if wire.unread > UNREAD else ""

    async def _rest(self, used_s: float) -> None:
        """Leave the processor to others after `used_s`, and while the reader is busy: TCP then slows the server."""
        await asyncio.sleep(min(used_s * (1.0 / SHARE - 1.0), AGAIN_S))
        while self._busy():  # noqa: ASYNC110 (the reader is in another thread)
            await asyncio.sleep(BUSY_S)

    def _take(self, wire: _Tcp | _Udp, received: bytes) -> None:
        """Process received bytes; turns data on once the configuration is known."""
        self._received_s, receiver = time.monotonic(), self.receiver
        receiver.lost_bytes += wire.dropped_bytes
        wire.dropped_bytes = 0
        for content in receiver.take([received]) if self.server.kind == "udp" else receiver.feed(received):
            if isinstance(content, Configuration):
                self._answered, self._rate = True, max(1, self._rate, content.rate)
                self._command(wire, "turn_on")
            if not isinstance(content, str):
                self._frames += isinstance(content, Instant)
                self._tell(content)

    def _ask(self, wire: _Tcp | _Udp, now: float) -> None:
        """Request the configuration from time to time; switches to the other kind if there is no answer."""
        if now - self._asked_s < ANSWER_S:
            return
        if not self._answered:
            self._kind = (self._kind + 1) % len(ASKED)
        self._asked_s, self._answered = now, False
        self._command(wire, ASKED[self._kind])

    def _command(self, wire: _Tcp | _Udp, name: str) -> None:
        if not self.server.spontaneous:
            second, part = divmod(time.time_ns() * TIME_BASE // NANOSECONDS, TIME_BASE)
            wire.send(frame.command(self.server.idcode, name, second, part))


class _Tcp:
    """A TCP connection."""

    dropped_bytes = 0

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer

    @property
    def unread(self) -> int:
        """Bytes that the server has not read yet."""
        return self._writer.transport.get_write_buffer_size()

    async def receive(self) -> bytes:
        return await self._reader.read(CHUNK)

    def send(self, data: bytes) -> None:
        self._writer.write(data)

    def close(self) -> None:
        self._writer.close()


class _Udp(asyncio.DatagramProtocol):
    """UDP datagrams, one frame each."""

    unread = 0  # datagrams are sent at once, or dropped

    def __init__(self) -> None:
        self.dropped_bytes, self._received = 0, asyncio.Queue[bytes](DATAGRAMS)
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: Any) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, _from: Any) -> None:
        if data and self._received.full():
            self.dropped_bytes += len(data)
        elif data:
            self._received.put_nowait(data)

    def error_received(self, exc: Exception) -> None:
        """Ignore: no server is there yet, and the request is repeated."""

    async def receive(self) -> bytes:
        return await self._received.get()

    def send(self, data: bytes) -> None:
        if self._transport is not None:
            self._transport.sendto(data)

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()


async def _open(server: Server) -> _Tcp | _Udp:
    if server.kind == "tcp":
        return _Tcp(*await asyncio.open_connection(server.host, server.port))
    way: dict[str, Any] = {"remote_addr": (server.host, server.port)}
    if server.spontaneous:
        way = {"sock": _listening(server)}
    return (await asyncio.get_running_loop().create_datagram_endpoint(_Udp, **way))[1]


def _join(receiver: socket.socket, group: str, interface: str) -> None:
    member = socket.inet_aton(group) + socket.inet_aton(interface)
    receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)


def _listening(server: Server) -> socket.socket:
    """A socket that receives data sent to an address of this computer, or to a multicast group that it joins."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((server.host, server.port))
        if ip_address(server.host).is_multicast:
            _join(listener, server.host, "127.0.0.1")
            with suppress(OSError):  # this computer may have no other network
                _join(listener, server.host, "0.0.0.0")  # noqa: S104 (whichever interface leads there)
    except OSError:
        listener.close()
        raise
    listener.setblocking(False)
    return listener
