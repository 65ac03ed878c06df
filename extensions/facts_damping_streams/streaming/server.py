"""A server of one stream: TCP for any number of clients, UDP for clients that ask and for fixed receivers.

IEEE C37.118.2, annex F: clients send commands over TCP, or over UDP to the server's port; data go to clients that
turned them on. Spontaneous UDP: data, and once a minute configuration 2, go to given addresses, multicast included.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from facts_damping.errors import RunError, one_line
from facts_damping_streams.c37118 import frame, session
from facts_damping_streams.c37118.frame import FrameError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping_streams.c37118.session import Instant, Stream

    Address = tuple[str, int]

MAX_WAITING = 1 << 18  # bytes of unsent data at which a slow client is dropped
CONFIGURATION_S = 60.0  # s between configurations to fixed receivers
MAX_ASKING = 256  # UDP addresses with data turned on; beyond, the oldest is removed
LONGEST = 1024  # bytes of the longest command
CHUNK = 4096


@dataclass
class Counts:
    """Counters of a server."""

    frames: int = 0  # data frames, each counted once for all receivers
    clients: int = 0  # TCP connections, and UDP addresses that turned data on
    dropped: int = 0  # clients dropped for being too slow
    refused: Counter[str] = field(default_factory=Counter)  # invalid commands, by what was wrong


class Server:
    """Server of a stream: call `begin`, then `send` for each instant, and `end` at last."""

    def __init__(self, stream: Stream, now: Callable[[], tuple[int, int]]) -> None:
        """`now`: current time for answers, as s and fraction of a second."""
        self.stream, self.now, self.counts = stream, now, Counts()
        self._clients: dict[asyncio.StreamWriter, bool] = {}  # whether data are turned on
        self._asking: dict[Address, None] = {}  # UDP addresses with data turned on, oldest first
        self._fixed: list[Address] = []
        self._tcp: asyncio.Server | None = None
        self._udp: asyncio.DatagramTransport | None = None
        self._configured_s = -CONFIGURATION_S  # time of the last configuration to fixed receivers

    async def begin(self, tcp: Address | None, udp: Address | None, fixed: Sequence[Address] = ()) -> None:
        """Open the ports. Raises `RunError` if one is not available."""
        loop = asyncio.get_running_loop()
        try:
            if tcp is not None:
                self._tcp = await asyncio.start_server(self._serve, *tcp)
            if udp is not None or fixed:
                pair = await loop.create_datagram_endpoint(lambda: _Datagrams(self), local_addr=udp or ("0.0.0.0", 0))  # noqa: S104 (answers come to where commands went)
                self._udp = pair[0]
        except OSError as error:
            raise RunError(
                f"{tcp or udp}: {one_line(error)}; allowed: an address of this computer and a free port"
            ) from None
        self._fixed = list(fixed)

    @property
    def ports(self) -> tuple[int, int]:
        """Opened TCP and UDP ports; 0: none."""
        tcp = 0 if self._tcp is None else self._tcp.sockets[0].getsockname()[1]
        return tcp, 0 if self._udp is None else self._udp.get_extra_info("sockname")[1]

    @property
    def listening(self) -> int:
        """Number of receivers with data turned on."""
        return sum(self._clients.values()) + len(self._asking) + len(self._fixed)

    def send(self, instant: Instant) -> None:
        """Send a data frame to all receivers; clients too far behind are dropped."""
        raw = session.data_frame(self.stream, instant)
        self.counts.frames += 1
        for client in [writer for writer, on in self._clients.items() if on]:
            if not self._too_slow(client):
                client.write(raw)
        if self._udp is not None:
            self._remind()
            for address in [*self._asking, *self._fixed]:
                self._udp.sendto(raw, address)

    def _too_slow(self, client: asyncio.StreamWriter) -> bool:
        """Whether a client is too far behind; if so, it is dropped."""
        if client.transport.get_write_buffer_size() <= MAX_WAITING:
            return False
        self.counts.dropped += 1
        self._clients.pop(client, None)
        client.transport.abort()
        return True

    def _remind(self) -> None:
        """Send the configuration to fixed receivers, which cannot request it."""
        now_s = asyncio.get_running_loop().time()
        if self._fixed and now_s - self._configured_s >= CONFIGURATION_S and self._udp is not None:
            self._configured_s = now_s
            for raw in session.answers(self.stream, "send_configuration_2", *self.now()):
                for address in self._fixed:
                    self._udp.sendto(raw, address)

    def answer(self, raw: bytes) -> tuple[list[bytes], bool | None]:
        """Answer of a command, and whether it turns data on or off (None: neither); invalid commands are counted."""
        try:
            name = session.commanded(self.stream, raw)
        except FrameError as error:
            self.counts.refused[error.field] += 1
            return [], None
        turned = {"turn_on": True, "turn_off": False}.get(name)
        return session.answers(self.stream, name, *self.now()), turned

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a TCP client until it disconnects."""
        self.counts.clients += 1
        self._clients[writer], stream = False, bytearray()
        try:
            while received := await reader.read(CHUNK):
                stream += received
                frames, lost = frame.split(stream, LONGEST)
                if lost:
                    self.counts.refused["bytes that are no frame"] += lost
                for raw in frames:
                    answers, turned = self.answer(raw)
                    writer.writelines(answers)
                    if self._too_slow(writer):
                        return
                    if turned is not None and writer in self._clients:
                        self._clients[writer] = turned
        except OSError:  # the client has disconnected
            pass
        finally:
            self._clients.pop(writer, None)
            writer.close()

    def received(self, raw: bytes, address: Address) -> None:
        """Process a datagram, which is one command."""
        answers, turned = self.answer(raw)
        self._ask(address, turned)
        if self._udp is not None:
            for answer in answers:
                self._udp.sendto(answer, address)

    def _ask(self, address: Address, turned: bool | None) -> None:
        """Add an address that turned data on by UDP, or remove it."""
        if turned is False:
            self._asking.pop(address, None)
        elif turned and address not in self._asking:
            if len(self._asking) >= MAX_ASKING:
                self._asking.pop(next(iter(self._asking)))
                self.counts.dropped += 1
            self._asking[address] = None
            self.counts.clients += 1

    async def end(self) -> None:
        """Close all connections and ports."""
        if self._tcp is not None:
            self._tcp.close()
        for client in list(self._clients):
            client.close()
        if self._udp is not None:
            self._udp.close()
        await asyncio.sleep(0)


class _Datagrams(asyncio.DatagramProtocol):
    """Datagrams to the server."""

    def __init__(self, server: Server) -> None:
        self.server = server

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.server.received(data, addr[:2])

    def error_received(self, exc: Exception) -> None:
        """Ignore a receiver that is not there."""
