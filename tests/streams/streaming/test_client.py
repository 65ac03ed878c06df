"""The client on the loopback: with our server over TCP, UDP and multicast, and with one of another program."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping_streams.c37118 import frame, session, stat, system_pmus
from facts_damping_streams.c37118.configuration import Configuration
from facts_damping_streams.c37118.session import Instant
from facts_damping_streams.parameters import server as address
from facts_damping_streams.streaming import client as clients
from facts_damping_streams.streaming.client import Client, Lost
from facts_damping_streams.streaming.server import Server
from tests.streams.streaming.test_server import FORMATS, GRID, HERE, instant, served, until

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

PATIENCE_S = 60.0
THEIRS = """
import collections, collections.abc, sys, time
collections.Sequence = collections.abc.Sequence
from synchrophasor.frame import ConfigFrame2
from synchrophasor.pmu import Pmu
units = [(0, "v"), (0, "i")], [(1, "rms")], []
formats = True, True, True, False
pmu = Pmu(pmu_id=7, ip="127.0.0.1", port=int(sys.argv[1]), data_rate=60, set_timestamp=False)
names = ["V1", "I1", "P kW"]
pmu.set_configuration(ConfigFrame2(7, 1_000_000, 1, "G1", 7, formats, 2, 1, 0, names, *units, 60.0, 1, 60))
pmu.set_header("theirs")
pmu.run()
while True:
    if pmu.clients:
        pmu.send_data([(11500.0, 0.25), (20000.0, -0.5)], [700.0], freq=12)
    time.sleep(0.02)
"""
TOTAL = 30


def run(act: Callable[[], Awaitable[Any]]) -> Any:
    async def whole() -> Any:
        return await asyncio.wait_for(act(), PATIENCE_S)

    return asyncio.run(whole())


async def begun(stream: session.Stream | None = None, **begin: Any) -> Server:
    server = Server(stream or served(), lambda: (1000, 0))
    await server.begin(**{"tcp": (HERE, 0), "udp": None, **begin})
    return server


class Listening:
    """A client, and what it has told."""

    def __init__(self, text: str) -> None:
        self.told: list[Any] = []
        self.client = Client(address(text), self.told.append)
        self.task = asyncio.ensure_future(self.client.run())

    def of(self, kind: type[Any]) -> list[Any]:
        return [content for content in self.told if isinstance(content, kind)]

    async def end(self) -> None:
        self.task.cancel()
        await asyncio.gather(self.task, return_exceptions=True)


async def follow(server: Server, text: str) -> Listening:
    """All that a server sends of 30 instants, once the client has turned it on."""
    listening = Listening(text)
    await until(lambda: server.listening > 0)
    return await send_all(server, listening)


async def send_all(server: Server, listening: Listening) -> Listening:
    """30 instants, until they have come."""
    for k in range(TOTAL):
        server.send(instant(k))
        await asyncio.sleep(0.001)
    await until(lambda: len(listening.of(Instant)) == TOTAL)
    await listening.end()
    await server.end()
    return listening


def same(instants: list[Any]) -> None:
    for k, received_instant in enumerate(instants):
        assert (received_instant.soc, received_instant.fraction) == (instant(k).soc, instant(k).fraction)
        wanted = instant(k).data.phasors.astype(np.float32).astype(float)
        np.testing.assert_array_equal(received_instant.data.phasors, wanted)


def test_over_tcp() -> None:
    async def act() -> Listening:
        server = await begun()
        return await follow(server, f"tcp://{HERE}:{server.ports[0]}/11")

    listening = run(act)
    same(listening.of(Instant))
    assert listening.of(Configuration)[0].pmus[1].name == "TIE"


def test_by_datagrams_that_it_asks_for() -> None:
    async def act() -> Listening:
        server = await begun(tcp=None, udp=(HERE, 0))
        return await follow(server, f"udp://{HERE}:{server.ports[1]}/11")

    same(run(act).of(Instant))


@pytest.mark.parametrize("group", [HERE, "239.255.0.38"], ids=["unicast", "multicast"])
def test_by_datagrams_that_come_by_themselves(group: str, port: int) -> None:
    """They begin with the configuration; nobody asks for it."""

    async def act() -> Listening:
        listening = Listening(f"udp://@{group}:{port}/11")
        await until(lambda: listening.client.connections == 1)
        return await send_all(await begun(tcp=None, udp=(HERE, 0), fixed=[(group, port)]), listening)

    same(run(act).of(Instant))


def test_client_reconnects_when_the_server_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clients, "AGAIN_S", 0.05)

    async def act() -> Listening:
        server = await begun()
        port = server.ports[0]
        client = Listening(f"tcp://{HERE}:{port}/11")
        await until(lambda: server.listening > 0)
        server.send(instant(0))
        await until(lambda: len(client.of(Instant)) == 1)
        await server.end()
        await until(lambda: len(client.of(Lost)) >= 2)  # closed, and nobody there
        again = await begun(tcp=(HERE, port))
        await until(lambda: again.listening > 0)
        again.send(instant(1))
        await until(lambda: len(client.of(Instant)) == 2)
        await client.end()
        await again.end()
        return client

    listening = run(act)
    same(listening.of(Instant))
    assert str(listening.of(Lost)[0]) == "closed by the server"
    assert listening.client.connections == 2


def test_server_that_is_silent_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clients, "SILENT_S", 0.3)
    monkeypatch.setattr(clients, "ANSWER_S", 0.1)

    async def act() -> list[Any]:
        with socket.socket() as mute:
            mute.bind((HERE, 0))
            mute.listen()
            listening = Listening(f"tcp://{HERE}:{mute.getsockname()[1]}/11")
            await until(lambda: bool(listening.told))
            await listening.end()
            return listening.told

    (lost,) = run(act)[:1]
    assert isinstance(lost, Lost)
    assert lost.startswith("silent for")


def test_configuration_that_changes_while_it_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit 10 says so for a while; then frames are others, of the same length: none is read by the old one."""
    monkeypatch.setattr(clients, "ANSWER_S", 0.05)
    before = served()
    turned = before.configuration._replace(pmus=tuple(p._replace(polar=False) for p in before.configuration.pmus))
    after = session.stream(11, turned)

    def announced(k: int) -> Instant:
        changed = instant(k)
        return changed._replace(data=changed.data._replace(status=changed.data.status | stat.CHANGE))

    async def act() -> Listening:
        server = await begun(before)
        client = Listening(f"tcp://{HERE}:{server.ports[0]}/11")
        await until(lambda: server.listening > 0)
        for k in range(3 * TOTAL):
            if k == 2 * TOTAL:
                server.stream = after
            server.send(announced(k) if TOTAL <= k < 2 * TOTAL else instant(k))
            await asyncio.sleep(0.02)
        await until(lambda: len(client.of(Instant)) > 2 * TOTAL + 10)
        await client.end()
        await server.end()
        return client

    listening = run(act)
    for received_instant in listening.of(Instant):
        k = (received_instant.soc - 1000) * 60 + received_instant.fraction // 16_666
        wanted = instant(k).data.phasors
        np.testing.assert_allclose(received_instant.data.phasors, wanted, atol=1e-6)
    assert [c.pmus[0].polar for c in listening.of(Configuration)][-1] is False
    assert listening.client.receiver.refused == {}


def test_server_that_knows_no_configuration_3(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """`Pmu` of synchrophasor, which closes the connection where it is asked for configuration 3."""
    monkeypatch.setattr(clients, "AGAIN_S", 0.1)
    with subprocess.Popen([sys.executable, "-c", THEIRS, str(port)], start_new_session=True) as theirs:

        async def act() -> Listening:
            client = Listening(f"tcp://{HERE}:{port}/7")
            await until(lambda: len(client.of(Instant)) >= 5)
            await client.end()
            return client

        try:
            listening = run(act)
        finally:
            os.killpg(theirs.pid, signal.SIGKILL)  # a process a client
    assert listening.of(Configuration)[0].pmus[0].name == "G1"
    for received_instant in listening.of(Instant):
        assert received_instant.data.frequency[0] == pytest.approx(60.012)
        np.testing.assert_allclose(received_instant.data.phasors, [[11500.0, 0.25], [20000.0, -0.5]], rtol=1e-6)


def test_frames_of_another_stream_are_refused_and_counted() -> None:
    receiver = session.Receiver(11)
    others = session.stream(12, system_pmus.configuration(GRID, 60, 60, FORMATS))
    assert receiver.take([session.data_frame(others, instant(0)), *session.answers(others, "send_header", 5, 0)]) == []
    assert receiver.refused == {"IDCODE": 2}
    assert receiver.take([frame.command(11, "turn_on", 5)]) == []
    assert receiver.refused == {"IDCODE": 2, "CMD": 1}


CONFIGURATION = b"".join(session.answers(served(), "send_configuration_3", 1000, 0))


class Wire:
    """A connection that has the same bytes again and again."""

    dropped_bytes = 0

    def __init__(self, *received: bytes, unread: int = 0) -> None:
        self.received, self.unread, self.reads = received, unread, 0

    async def receive(self) -> bytes:
        self.reads += 1
        return self.received[min(self.reads, len(self.received)) - 1]

    def send(self, data: bytes) -> None: ...


async def serve(wire: Any, seconds: float, **more: Any) -> str | None:
    """Why the client ends a connection; None: it does not within `seconds`."""
    serving = Client(address(f"tcp://{HERE}:1/11"), lambda _: None, **more)._serve(wire)
    with suppress(asyncio.TimeoutError):
        return await asyncio.wait_for(serving, seconds)
    return None


@pytest.mark.parametrize(
    ("wire", "reason"),
    [
        (Wire(b"HTTP/1.1 400 Bad Request\r\n" * 1000), "78000 bytes in no frame of C37.118.2; allowed: 65536"),
        (Wire(CONFIGURATION, session.data_frame(served(), instant(0)) * 4000), "4000 data frames in 0 s; allowed: 36"),
        (Wire(CONFIGURATION, unread=65537), "65537 bytes of commands unread; allowed: 65536"),
    ],
    ids=["other protocol", "flood", "commands unread"],
)
def test_connection_ends_with_a_server_that_never_ends(wire: Wire, reason: str) -> None:
    assert str(run(lambda: serve(wire, 5.0))).startswith(reason)


def test_client_leaves_the_processor_to_others_while_a_server_floods() -> None:
    wire = Wire(CONFIGURATION, session.data_frame(served(), instant(0)) * 20)
    began_s = time.process_time()
    assert run(lambda: serve(wire, 0.4)) is None  # too short for a fast machine to decode a minute of data
    assert wire.reads > 3
    assert time.process_time() - began_s < 0.24


def test_client_reads_no_more_while_its_reader_is_busy() -> None:
    wire = Wire(CONFIGURATION)
    assert run(lambda: serve(wire, 0.2, busy=lambda: True)) is None
    assert wire.reads == 1


def test_datagrams_that_wait_are_few_and_the_others_counted() -> None:
    wire = clients._Udp()
    for _ in range(1000):
        wire.datagram_received(b"12345678", None)
    assert wire.dropped_bytes == 8 * (1000 - clients.DATAGRAMS)
