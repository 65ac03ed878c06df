"""c37118_server: serves the PMU data of a running graph as IEEE C37.118.2 streams; publishes nothing in the graph."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from facts_damping_msgs.msg import PmuDataFrame

from facts_damping.case.names import link_addresses
from facts_damping.errors import InputError
from facts_damping.nodes import clock
from facts_damping.nodes.admission.message_filter import MessageFilter
from facts_damping.nodes.admission.publishers import Reading
from facts_damping.nodes.base.asyncio_thread import AsyncioThread
from facts_damping.nodes.base.managed import AlwaysActive
from facts_damping.nodes.base.parameters import Options, declare, descriptor, read_case
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.spinner import Spinner
from facts_damping.nodes.base.topics import FRAMES
from facts_damping.nodes.transport import stamps
from facts_damping.nodes.transport.signing import seal, signing
from facts_damping.nodes.transport.tables import FramesMessage
from facts_damping.signals import NANOSECONDS
from facts_damping_streams.streaming import serving
from facts_damping_streams.streaming.pdc import WAIT_S, Pdc
from facts_damping_streams.streaming.recorded import send
from facts_damping_streams.streaming.serving import Serving

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.nodes.base.managed import ManagedNode

LISTENS = Options("free", 5.0, 30.0, recorder=False, view=False)  # whatever the graph's mode: no node waits for it
REPORT_S = 1.0  # wall time between two reports of changes


class C37118Server:
    """Serves a run's PMUs as C37.118.2 streams."""

    activation = AlwaysActive()

    def __init__(self, node: ManagedNode) -> None:
        self.case, self.asked = read_case(node), read_serving(node)
        text = "link after which frames are taken, time-aligned; -1: as PMUs report them"
        link = int(declare(node, "behind", -1, descriptor(text, "", -1, 15)))
        links = link_addresses(self.case)
        if link >= len(links):
            raise InputError(f"behind: {link} given; allowed: -1 to {len(links) - 1}")
        stamps.begin(learns=True)
        self.wait_s = None if link < 0 else WAIT_S
        topic = FRAMES if link < 0 else links[link].topic("pmu/delivered")
        self.message_filter = MessageFilter(node, self.case, LISTENS, peer=False)
        frames = FramesMessage(self.case, seal(signing(self.case, LISTENS.start_timeout), topic))
        self.message_filter.subscribe(PmuDataFrame, topic, self.on_frames, Reading(frames.read), leads=True)
        self.message_filter.subscribe_run_state(FRAMES)
        self.pdc: Pdc | None = None
        self.servers = serving.servers(self.case, self.asked, lambda: (clock.time_ns() // NANOSECONDS, 0))
        self.counted, self.asyncio_thread = serving.counted(self.servers), AsyncioThread()
        self.spinner = Spinner(node, self)

    def ready(self) -> None:
        """Open the ports."""
        try:
            lines = self.asyncio_thread.wait(serving.begin(self.servers, self.asked))
        except BaseException:
            self.end()
            raise
        for line in lines:
            self.message_filter.log.report(line)

    def on_frames(self, tick: int, rows: NDArray[Any]) -> None:
        """Send the frames of a tick to the clients; the first frame gives the time of tick 0."""
        if self.pdc is None:
            start_ns = tick * NANOSECONDS // self.case.run.frame_rate
            begun_ns = stamps.epoch_ns() or clock.time_ns() - start_ns
            self.pdc = Pdc(self.case, begun_ns / NANOSECONDS, self.wait_s)
        for instant in self.pdc.take(tick, rows):
            self.asyncio_thread.soon(partial(send, self.servers, instant, each=self.asked.each))

    def report(self, last: bool = False) -> None:
        """Report refusals. Called periodically."""
        self.message_filter.report_refusals(last)

    def run(self) -> None:
        """Serve until stopped; log changes of the clients, and totals at the end."""
        reported_s = -REPORT_S
        try:
            while True:
                self.spinner.spin_once(0.1)
                if clock.monotonic() - reported_s > REPORT_S:
                    reported_s = clock.monotonic()
                    self.report_changes()
        finally:
            for row in serving.counted(self.servers):
                self.message_filter.log.report(serving.told(row))
            self.end()

    def report_changes(self) -> None:
        """Log the streams whose counts of clients, drops or refusals have changed."""
        before, self.counted = self.counted, serving.counted(self.servers)
        for old, new in zip(before, self.counted, strict=True):
            if {**old, "frames": 0} != {**new, "frames": 0}:
                self.message_filter.log.report(serving.told(new))

    def end(self) -> None:
        """Close the servers and the event loop."""
        for server in self.servers:
            self.asyncio_thread.wait(server.end())
        self.asyncio_thread.close()


def read_serving(node: ManagedNode) -> Serving:
    """Declare and read the parameters of the servers."""
    host: str = declare(node, "host", "127.0.0.1", descriptor("address of this computer at which clients connect"))
    port: int = declare(node, "port", 4712, descriptor("TCP and UDP port; 0: a free one", "", 0, 60000))
    text = "HOST:PORT that data also go to by UDP, or a multicast group; empty: none"
    to = [address for address in declare(node, "to", [""], descriptor(text)) if address]
    idcode: int = declare(node, "idcode", 1, descriptor("number of the stream, or of the first", "", 1, 65534))
    text = "format flags: polar, float_phasors, float_analogs, float_frequency, or none; empty: all"
    formats: str = declare(node, "format", "", descriptor(text))
    text = "true: each PMU has a server of its own, at ports from port on"
    each: bool = declare(node, "each", False, descriptor(text))
    return Serving(host, port, to, idcode, formats or None, each=each)


main = partial(
    run_node,
    "c37118_server",
    C37118Server,
    "Serves the PMUs of a graph as streams of IEEE C37.118.2; publishes nothing to it.",
)
