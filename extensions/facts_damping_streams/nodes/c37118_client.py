"""c37118_client: feeds IEEE C37.118.2 streams into a graph in place of the plant; setpoints have no effect."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from facts_damping_msgs.msg import RunState

from facts_damping.errors import InputError, RunError
from facts_damping.nodes import clock
from facts_damping.nodes.base.asyncio_thread import AsyncioThread
from facts_damping.nodes.base.managed import AlwaysActive
from facts_damping.nodes.base.parameters import declare, descriptor, read_case, read_options, read_stamp
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.spinner import check_wanted
from facts_damping.nodes.frame_source import FrameSource, SimulatedClock
from facts_damping.nodes.transport import stamps
from facts_damping.nodes.transport.messages import Health
from facts_damping.signals import DEVICE_TRUTH, FLAGS, MACHINE_TRUTH, NANOSECONDS, REFUSED
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping_streams.parameters import read_streams
from facts_damping_streams.streaming.client import Client
from facts_damping_streams.streaming.sources import Sources

if TYPE_CHECKING:
    from concurrent.futures import Future

    from numpy.typing import NDArray

    from facts_damping.nodes.base.managed import ManagedNode
    from facts_damping_streams.streaming.stream_clock import Tick

OURS = "tcp://127.0.0.1:4712/1"  # default address of c37118_server
LAST_S = 1.0  # wait for the answers to the last tick
SPIN_S = 0.05  # longest wait for stream data before requests are answered
PENDING = 256  # stream data that wait to be published, before no more are read


class C37118Client:
    """Plays the plant of a run from streams."""

    activation = AlwaysActive()

    def __init__(self, node: ManagedNode) -> None:
        self.case, self.options = read_case(node), read_options(node, joins=False)
        if not self.options.paced:
            raise InputError(f"mode: '{self.options.mode}' given; allowed: free, realtime, as streams wait for nobody")
        self.stamp = read_stamp(node, self.options)
        path: str = declare(node, "streams", OURS, descriptor("YAML file of the streams, or a server's address"))
        self.streams = read_streams(path)
        self.sources = Sources(self.case, self.streams)
        self.received: SimpleQueue[tuple[int, float, Any]] = SimpleQueue()
        self.unknown = (
            _unknown(len(self.case.system.machines), MACHINE_TRUTH),
            _unknown(len(self.case.run.devices), DEVICE_TRUTH),
        )
        self.source = FrameSource(node, self.case, self.options, ", ".join(self.streams.servers))
        self.clock, self.member = SimulatedClock(node), self.source.member
        self.log, self.ticks = self.member.message_filter.log, self.source.ticks
        self.tick, self.misses = -1, 0
        self.tasks: list[Future[None]] = []  # tasks of the clients, which end only by an error
        self.source.subscribe_links(self.on_setpoints, lambda: self.tick)
        self.spinner = self.member.spin()

    def ready(self) -> None:
        """Wait for the links, supervisors, and the recorder."""
        self.source.wait(self.spinner, len(self.source.answered))

    def on_setpoints(self, link: str, tick: int, _rows: NDArray[Any]) -> None:
        """Note that a link has answered; its setpoints have no effect."""
        self.source.answered[link] = tick

    def run(self) -> None:
        """Follow the streams to the end of the run or until stopped; publish which of both as the run's state."""
        asyncio_thread = AsyncioThread()
        for i, server in enumerate(self.sources.servers):
            tell = partial(self._put, i)
            client = Client(server, tell, lambda: self.received.qsize() > PENDING)
            self.sources.clients.append(client)
            self.tasks.append(asyncio_thread.begin(client.run()))
        try:
            with self.source.until_end(lambda: self.tick):
                self.follow()
        finally:
            asyncio_thread.close()
            self.log.info(self.health().message)

    def _put(self, i: int, what: Any) -> None:
        """Store what server i has sent, in the thread of the clients."""
        self.received.put((i, clock.monotonic(), what))

    def follow(self) -> None:
        """Publish all ticks, each when it is over."""
        began = clock.monotonic()
        while self.tick + 1 < self.ticks:
            check_wanted()
            for ended in (task for task in self.tasks if task.done()):
                ended.result()
            self.receive()
            if clock.monotonic() - began > self.options.start_timeout:
                self.check_known()
            self.spinner.take_all()
            for tick in self.sources.following.take(clock.monotonic()):
                if self.tick + 1 < self.ticks:
                    self.publish(tick)
            self.source.progress(self.tick + 1, self.misses, now=self.tick + 1 == self.ticks)
        until = clock.monotonic() + LAST_S
        while min(self.source.answered.values(), default=self.tick) < self.tick and clock.monotonic() < until:
            self.spinner.spin_once(SPIN_S)
        self.log.info(self.source.end(self.tick))
        self.source.finish()

    def check_known(self) -> None:
        """Raise `RunError` if no server has sent its configuration, unless the graph runs free."""
        if self.sources.unknown() and not self.options.free:
            raise RunError(f"no server has sent its configuration: {'; '.join(self.sources.flaws())}")

    def receive(self) -> None:
        """Wait at most `SPIN_S` for stream data, take much of it, and log its events.

        Raises `InputError` for a faulty stream before the first tick.
        """
        wait, received = min(SPIN_S, self.sources.following.left_s(clock.monotonic())), []
        with suppress(Empty):
            received.append(self.received.get(timeout=wait))
            while len(received) < PENDING:  # a server that sends at full speed does not stop the ticks
                received.append(self.received.get_nowait())
        for i, at_s, what in received:
            text = self.sources.take(i, at_s, what)
            if text and self.tick < 0 and self.sources.wrong:
                raise InputError(text)
            if text:
                (self.log.warning if self.sources.wrong else self.log.info)(text)

    def publish(self, tick: Tick) -> None:
        """Publish a tick with the stream data that came for it; the frame may be empty."""
        k = self.tick = tick.number
        start = tick_ns(k, self.case.run.frame_rate)
        if k == 0:
            self.begin()
        self.member.begin(k)
        self.misses += any(newest < k - 1 for newest in self.source.answered.values())
        self.source.publish(k, self.sources.rows(tick, start), True, *self.unknown)
        self.clock.publish(start)
        self.member.report_health(self.health, last=k + 1 == self.ticks)

    def begin(self) -> None:
        """Set the time of tick 0 from the first frame. Raises `InputError` if wall stamps are more than a day off."""
        first_ns = (self.sources.following.first or 0) * NANOSECONDS // self.case.run.frame_rate
        off_s = abs(first_ns - clock.time_ns()) / NANOSECONDS
        if self.stamp == "wall" and off_s * NANOSECONDS > stamps.DAY_NS:
            raise InputError(f"stamp: wall given with a stream that is {off_s:.0f} s off; allowed: simulated")
        stamps.begin(first_ns if self.stamp == "wall" else 0)
        self.source.publish_state(RunState.RUNNING, self.tick, "begins")

    def health(self) -> Health:
        """State of the streams: flaws, counts and deadline misses."""
        flaws, values = self.sources.flaws(), {**self.sources.counts(), "deadline_misses": self.misses}
        level = DiagnosticStatus.WARN if flaws else DiagnosticStatus.OK
        return Health(level, "; ".join(flaws) or "all streams arrive", {"mode": self.options.mode, **values})


def _unknown(count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Truth rows without information, as streams carry none: NaN, and 0 for flags and refusals."""
    rows = np.zeros(count, dtype)
    for name in dtype.names or ():
        rows[name] = 0.0 if name in (*FLAGS, *REFUSED) else np.nan
    return rows


main = partial(
    run_node,
    "c37118_client",
    C37118Client,
    "Takes the plant's place with streams of IEEE C37.118.2, for controllers in shadow.",
)
