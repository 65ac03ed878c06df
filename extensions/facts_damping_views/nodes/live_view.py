"""live_view: shows a running graph in Foxglove by foxglove-sdk's WebSocket server; publishes nothing in the graph."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from facts_damping.errors import InputError
from facts_damping.extras import library
from facts_damping.nodes.base.log import NodeLog
from facts_damping.nodes.base.managed import AlwaysActive
from facts_damping.nodes.base.parameters import declare, descriptor, read_case
from facts_damping.nodes.base.qos import listening
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.spinner import Spinner
from facts_damping.nodes.base.topics import PLANT_STATE
from facts_damping.nodes.recorder import message_type, topics
from facts_damping.recording.columns import stamp_ns
from facts_damping.recording.schemas import schema_text

if TYPE_CHECKING:
    from facts_damping.nodes.base.managed import ManagedNode

LISTENING = listening(1000)

HOST, PORT = "127.0.0.1", 8765


class LiveView:
    """Subscribes to all topics and forwards the raw messages at the time of their stamps."""

    activation = AlwaysActive()

    def __init__(self, node: ManagedNode) -> None:
        case = read_case(node)
        self.host: str = declare(node, "host", HOST, descriptor("address that the server listens at"))
        self.port: int = declare(node, "port", PORT, descriptor("its port; 0: a free one", "", 0, 65535))
        self.sdk = sdk = library("foxglove", "foxglove", "foxglove-sdk")
        schemas: dict[Any, Any] = {}
        clock = node.resolve_topic_name(PLANT_STATE)
        for topic, kind in topics(case).items():
            name, of = node.resolve_topic_name(topic), message_type(kind)
            if of not in schemas:
                schemas[of] = sdk.Schema(name=of, encoding="ros2msg", data=schema_text(of).encode())
            channel = sdk.Channel(name, schema=schemas[of], message_encoding="cdr")
            take = partial(self.on_message, channel, name == clock)
            node.create_subscription(kind, topic, take, LISTENING, raw=True)
        self.log, self.spinner = NodeLog(node), Spinner(node)

    def ready(self) -> None:
        """Start the server. Raises `InputError` if host or port cannot be used."""
        host, port, time = self.host, self.port, self.sdk.Capability.Time
        try:
            self.server = self.sdk.start_server(name="facts_damping", host=host, port=port, capabilities=[time])
        except (RuntimeError, ValueError, OSError) as error:
            raise InputError(f"host, port: {host}, {port} given: {error}; allowed: ones that are free here") from error
        self.address = f"ws://{host}:{self.server.port}"

    def on_message(self, channel: Any, tells_time: bool, data: bytes) -> None:
        """Forward one message."""
        stamp = stamp_ns(data)
        if tells_time:
            self.server.broadcast_time(stamp)
        channel.log(data, log_time=stamp)

    def run(self) -> None:
        """Serve until stopped."""
        self.log.line(self.address)
        self.log.info(f"open in Foxglove: {self.address}")
        try:
            while True:
                self.spinner.spin_once(0.1)
        finally:
            self.server.stop()


main = partial(run_node, "live_view", LiveView, "A running graph in Foxglove, by WebSocket; publishes nothing to it.")
