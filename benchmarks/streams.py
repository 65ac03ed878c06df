"""What streams of many PMUs cost: 100 PMUs at 60 frames/s, as fractions of one core.

Parts one by one, each over many frames; then server and client as processes of their own over TCP, at their own pace,
by the processor time that each has used.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.signals import CHANNELS
from facts_damping_streams.c37118 import mapping, session, stat, system_pmus
from facts_damping_streams.c37118.configuration import FORMATS
from facts_damping_streams.c37118.session import Instant, Receiver
from facts_damping_streams.c37118.system_pmus import Pmu
from facts_damping_streams.parameters import server as address
from facts_damping_streams.streaming.client import Client
from facts_damping_streams.streaming.server import Server
from facts_damping_streams.streaming.stream_clock import Following, PmuReport

if TYPE_CHECKING:
    from collections.abc import Callable

PMUS, RATE, FRAMES, SECONDS = 100, 60, 2000, 20
GRID = [Pmu(f"S{i}", 230.0, 100.0) for i in range(PMUS)]
NONE = np.zeros(PMUS)


def stream(formats: bool) -> session.Stream:
    """All in floats and polar, or all in integers and rectangular."""
    return session.stream(1, system_pmus.configuration(GRID, RATE, RATE, dict.fromkeys(FORMATS, formats)))


def instant(k: int, values: Any) -> Instant:
    """Frame k."""
    words = stat.word(np.zeros(PMUS, int), np.ones(PMUS, bool), NONE, NONE)
    return Instant(1000 + k // RATE, k % RATE * 1_000_000 // RATE, 0, system_pmus.to_data(GRID, values, words))


def measured() -> Any:
    """What PMUs measure."""
    values = np.random.default_rng(1).uniform(0.5, 1.0, (PMUS, len(CHANNELS)))
    values[:, system_pmus.FREQUENCY] = 60.0
    return values


def took(act: Callable[[int], object]) -> float:
    """Processor time of one, s."""
    began = time.process_time()
    for k in range(FRAMES):
        act(k)
    return (time.process_time() - began) / FRAMES


def parts(formats: bool) -> dict[str, float]:
    """Of each step of a frame's way, s."""
    streamed, values, receiver, following = stream(formats), measured(), Receiver(), Following(PMUS, RATE, 0.2)
    receiver.take(session.answers(streamed, "send_configuration_3", 0, 0))
    where = mapping.places(streamed.configuration, GRID, {})
    raw = [session.data_frame(streamed, instant(k, values)) for k in range(FRAMES)]
    come = [content for content in receiver.take(raw) if isinstance(content, Instant)]

    def follow(k: int) -> None:
        measured_values, status, absent = mapping.values_of(where, come[k].data)
        following.put(k, PmuReport(where.pmus, measured_values, status, absent), k / RATE)
        list(following.take(k / RATE))

    return {
        "to V, A, kW and STAT": took(lambda k: instant(k, values)),
        "to bytes": took(lambda k: session.data_frame(streamed, come[k])),
        "from bytes": took(lambda k: receiver.feed(raw[k])),
        "to PMUs and ticks": took(follow),
    }


def serve(port: Any, used: Any) -> None:
    """Serve, from when a client has turned data on."""

    async def whole() -> None:
        server, values = Server(stream(True), lambda: (0, 0)), measured()
        await server.begin(("127.0.0.1", 0), None)
        port.put(server.ports[0])
        while not server.listening:  # noqa: ASYNC110 (it tells nobody)
            await asyncio.sleep(0.01)
        loop = asyncio.get_running_loop()
        began, before = loop.time(), time.process_time()
        for k in range(RATE * SECONDS):
            await asyncio.sleep(max(0.0, began + k / RATE - loop.time()))
            server.send(instant(k, values))
        used.put(("server", time.process_time() - before, server.counts.frames))
        await asyncio.sleep(0.5)

    asyncio.run(whole())


def listen(port: int) -> tuple[str, float, int]:
    """Until all have come."""
    where = mapping.places(stream(True).configuration, GRID, {})
    following, count = Following(PMUS, RATE, 0.2), 0

    def take(what: Any) -> None:
        nonlocal count
        if isinstance(what, Instant):
            number = what.soc * RATE + round(what.fraction * RATE / 1e6)
            now = time.monotonic()
            following.put(number, PmuReport(where.pmus, *mapping.values_of(where, what.data)), now)
            count += sum(tick.frame is not None for tick in following.take(now))

    async def whole() -> None:
        task = asyncio.ensure_future(Client(address(f"tcp://127.0.0.1:{port}/1"), take).run())
        await asyncio.sleep(SECONDS + 0.3)
        task.cancel()

    before = time.process_time()
    asyncio.run(whole())
    return "client", time.process_time() - before, count


def main() -> None:
    """Print both tables."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    print(f"{PMUS} PMUs, {RATE} frames/s: us a frame, fraction of a core")
    for formats, name in ((True, "floats, polar"), (False, "integers, rectangular")):
        for part, seconds in parts(formats).items():
            print(f"  {name:22} {part:22} {1e6 * seconds:7.0f}  {100 * seconds * RATE:5.2f} %")
    port: Any = multiprocessing.Queue()
    used: Any = multiprocessing.Queue()
    process = multiprocessing.Process(target=serve, args=(port, used))
    process.start()
    listening = listen(port.get())
    process.join()
    for name, seconds, frames in (used.get(), listening):
        print(f"  {name}, over TCP for {SECONDS} s: {frames} frames, {100 * seconds / SECONDS:.2f} % of a core")


if __name__ == "__main__":
    main()
