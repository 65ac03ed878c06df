"""The server of a stream on the loopback: over TCP and UDP, many clients, slow ones, rubbish, another program."""

from __future__ import annotations

import asyncio
import collections
import collections.abc
import socket
import struct
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

collections.Sequence = collections.abc.Sequence  # type: ignore[attr-defined]
from synchrophasor.pdc import Pdc  # noqa: E402 (it names what Python 3.9 still had)

from facts_damping.errors import RunError  # noqa: E402
from facts_damping.signals import CHANNELS  # noqa: E402
from facts_damping_streams.c37118 import configuration, frame, session, system_pmus  # noqa: E402
from facts_damping_streams.c37118.session import Instant, Receiver  # noqa: E402
from facts_damping_streams.c37118.system_pmus import Pmu  # noqa: E402
from facts_damping_streams.streaming.server import Server  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

HERE, GROUP = "127.0.0.1", "239.255.0.37"
GRID = [Pmu("G1", 20.0, 100.0), Pmu("TIE", 230.0, 100.0)]
FORMATS = {"polar": True, "float_phasors": True, "float_analogs": True}
TOTAL = 40
OPEN: list[asyncio.StreamWriter] = []  # clients of a test


def served(**formats: bool) -> session.Stream:
    configured = system_pmus.configuration(GRID, 60, 60, {**FORMATS, **formats})
    return session.stream(11, configured, "two PMUs")


def instant(k: int) -> Instant:
    values = np.random.default_rng(k).uniform(0.1, 1.0, (len(GRID), len(CHANNELS)))
    values[:, system_pmus.FREQUENCY] = 60.0
    return Instant(1000 + k // 60, k % 60 * 16_666, 0, system_pmus.to_data(GRID, values, np.zeros(2, np.int64)))


def run(
    act: Callable[[Server], Awaitable[Any]], stream: session.Stream | None = None, **begin: Any
) -> tuple[Any, Server]:
    """Act on a server on the loopback, and end it."""

    async def whole() -> tuple[Any, Server]:
        server = Server(stream or served(), lambda: (1000, 0))
        await server.begin(**{"tcp": (HERE, 0), "udp": None, **begin})
        try:
            return await asyncio.wait_for(act(server), 30.0), server
        finally:
            await server.end()
            while OPEN:
                writer = OPEN.pop()
                writer.close()
                with suppress(ConnectionError):
                    await writer.wait_closed()

    return asyncio.run(whole())


async def until(true: Callable[[], bool]) -> None:
    while not true():  # noqa: ASYNC110 (what it waits for tells nobody)
        await asyncio.sleep(0.005)


async def client(server: Server, *commands: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    reader, writer = await asyncio.open_connection(HERE, server.ports[0])
    OPEN.append(writer)
    writer.writelines(frame.command(11, name, 5) for name in commands)
    return reader, writer


async def gather(reader: asyncio.StreamReader, count: int, size: int = 1000) -> list[Any]:
    receiver, contents = Receiver(), list[Any]()
    while len(contents) < count and (received := await reader.read(size)):
        contents += receiver.feed(received)
    return contents


def test_many_clients_get_the_same() -> None:
    async def act(server: Server) -> list[list[Any]]:
        asked = ("send_header", "send_configuration_3", "send_configuration_2", "turn_on")
        there = [await client(server, *asked) for _ in range(5)]
        await until(lambda: server.listening == 5)
        for k in range(TOTAL):
            server.send(instant(k))
        return [await gather(reader, 3 + TOTAL) for reader, _ in there]

    by_client, server = run(act)
    for contents in by_client:
        assert contents[0] == "two PMUs"
        assert contents[1].pmus[1].name == contents[2].pmus[1].name == "TIE"
        for k, received_instant in enumerate(contents[3:]):
            assert (received_instant.soc, received_instant.fraction) == (instant(k).soc, instant(k).fraction)
            wanted = instant(k).data.phasors.astype(np.float32).astype(float)
            np.testing.assert_array_equal(received_instant.data.phasors, wanted)
    assert (server.counts.frames, server.counts.clients, server.counts.refused) == (TOTAL, 5, {})


def test_data_ends_where_it_is_turned_off() -> None:
    async def act(server: Server) -> bytes:
        reader, writer = await client(server, "turn_on")
        await until(lambda: server.listening == 1)
        server.send(instant(0))
        writer.write(frame.command(11, "turn_off", 5))
        await until(lambda: server.listening == 0)
        server.send(instant(1))
        await server.end()
        return await reader.read()

    received, _ = run(act)
    assert received == session.data_frame(served(), instant(0))


def test_slow_client_is_dropped_and_counted() -> None:
    """One that reads nothing; another reads all the time."""
    wide = session.stream(11, system_pmus.configuration(GRID * 100, 60, 60, FORMATS))
    values = np.ones((len(GRID) * 100, len(CHANNELS)))
    large_frame = Instant(1, 0, 0, system_pmus.to_data(GRID * 100, values, np.zeros(len(values), np.int64)))

    async def act(server: Server) -> tuple[int, int]:
        await client(server, "turn_on")
        reader, _ = await client(server, "turn_on")
        await until(lambda: server.listening == 2)
        reading = asyncio.create_task(reader.read())
        while server.counts.dropped == 0:
            server.send(large_frame)
            await asyncio.sleep(0)
        left = server.listening
        await server.end()
        return left, len(await reading)

    (left, received_bytes), server = run(act, wide)
    assert (left, server.counts.dropped) == (1, 1)
    assert received_bytes == server.counts.frames * len(session.data_frame(wide, large_frame))


def test_rubbish_is_counted_and_ends_nothing() -> None:
    async def act(server: Server) -> list[Any]:
        reader, writer = await client(server)
        writer.write(b"GET / HTTP/1.1\r\n\r\n" + frame.command(12, "turn_on", 5))
        writer.write(session.data_frame(served(), instant(0)) + frame.command(11, "send_header", 5))
        return await gather(reader, 1)

    contents, server = run(act)
    assert contents == ["two PMUs"]
    assert server.counts.refused == {"bytes that are no frame": 18, "IDCODE": 1, "SYNC": 1}


def receive(count: int, group: str | None = None) -> tuple[socket.socket, Callable[[], list[Any]]]:
    """A socket for datagrams on the loopback, and what reads a number of them."""
    listening = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listening.settimeout(20.0)
    listening.bind(("" if group else HERE, 0))
    if group:
        joined = struct.pack("4s4s", socket.inet_aton(group), socket.inet_aton(HERE))
        listening.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, joined)

    def read() -> list[Any]:
        receiver, contents = Receiver(), list[Any]()
        while len(contents) < count:
            contents += receiver.take([listening.recv(65535)])
        return contents

    return listening, read


def test_datagrams_are_answered_and_turned_on() -> None:
    listening, read = receive(1 + TOTAL)

    async def act(server: Server) -> list[Any]:
        for name in ("send_configuration_2", "turn_on"):
            listening.sendto(frame.command(11, name, 5), (HERE, server.ports[1]))
        listening.sendto(b"rubbish", (HERE, server.ports[1]))
        await until(lambda: server.listening == 1 and bool(server.counts.refused))
        for k in range(TOTAL):
            server.send(instant(k))
        return await asyncio.to_thread(read)

    with listening:
        contents, server = run(act, tcp=None, udp=(HERE, 0))
    assert [type(content) for content in contents] == [configuration.Configuration, *[Instant] * TOTAL]
    assert (server.counts.clients, sum(server.counts.refused.values())) == (1, 1)


def test_udp_clients_are_limited_and_forgotten_when_they_turn_data_off() -> None:
    server = Server(served(), lambda: (1000, 0))
    for i in range(300):
        server.received(frame.command(11, "turn_on", 5), (HERE, 1000 + i))
        server.received(frame.command(11, "send_header", 5), (HERE, 5000 + i))
    assert (server.listening, server.counts.clients, server.counts.dropped) == (256, 300, 44)
    server.received(frame.command(11, "turn_off", 5), (HERE, 1299))
    assert server.listening == 255


def test_client_that_asks_and_does_not_read_is_dropped() -> None:
    async def act(server: Server) -> None:
        _, writer = await client(server)
        asked = frame.command(11, "send_configuration_3", 5) * 100
        while server.counts.dropped == 0:
            writer.write(asked)
            await asyncio.sleep(0)

    _, server = run(act)
    assert server.counts.dropped == 1


def test_bytes_that_look_like_the_begin_of_long_frames_cost_little() -> None:
    async def act(server: Server) -> list[Any]:
        reader, writer = await client(server)
        writer.write(b"\xaa\x42\xff\xff" * 20_000 + frame.command(11, "send_header", 5))
        return await gather(reader, 1)

    began = time.process_time()
    contents, server = run(act)
    assert contents == ["two PMUs"]
    assert server.counts.refused == {"bytes that are no frame": 80_000}
    assert time.process_time() - began < 4.0  # it was as many seconds as there are 16 KiB


@pytest.mark.parametrize("group", [None, GROUP], ids=["unicast", "multicast"])
def test_fixed_receivers_get_configuration_and_data(group: str | None) -> None:
    listening, read = receive(3, group)

    async def act(server: Server) -> list[Any]:
        for k in range(2):
            server.send(instant(k))
        return await asyncio.to_thread(read)

    with listening:
        to = (group or HERE, listening.getsockname()[1])
        contents, _ = run(act, tcp=None, udp=(HERE, 0), fixed=[to])
    assert [type(content) for content in contents] == [configuration.Configuration, Instant, Instant]


def test_port_that_is_taken_is_said() -> None:
    with socket.socket() as bound:
        bound.bind((HERE, 0))
        bound.listen()
        with pytest.raises(RunError, match=r"allowed: an address of this computer and a free port"):
            run(lambda _server: asyncio.sleep(0), tcp=bound.getsockname())


def test_another_programs_client_reads_it() -> None:
    """`Pdc` of synchrophasor: header, configuration, start, data, stop."""

    def ask(port: int, out: dict[str, Any]) -> None:
        theirs = Pdc(pdc_id=11, pmu_ip=HERE, pmu_port=port)
        theirs.run()
        out["header"], out["configuration"] = theirs.get_header(), theirs.get_config()
        theirs.start()
        for _ in range(TOTAL):
            out["data"].append(theirs.get().get_measurements())
        theirs.stop()
        theirs.quit()

    async def act(server: Server) -> dict[str, Any]:
        out: dict[str, Any] = {"data": []}
        asking = asyncio.create_task(asyncio.to_thread(ask, server.ports[0], out))
        await until(lambda: server.listening == 1)
        for k in range(TOTAL):
            server.send(instant(k))
            await until(lambda k=k: len(out["data"]) > k)  # type: ignore[misc]  # it drops what comes with a frame
        await asking
        return out

    client_saw, _ = run(act)
    assert client_saw["configuration"].get_station_name() == ["G1".ljust(16), "TIE".ljust(16)]
    for k, measurement in enumerate(client_saw["data"]):
        wanted = instant(k).data.phasors.astype(np.float32).reshape(2, 2, 2)
        phasors = np.array([[list(p) for p in pmu["phasors"]] for pmu in measurement["measurements"]])
        np.testing.assert_allclose(phasors, wanted, rtol=1e-6)
