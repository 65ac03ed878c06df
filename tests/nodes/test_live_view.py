"""The live view: a WebSocket client gets what the graph publishes, and the graph does not notice it."""

from __future__ import annotations

import json
import signal
import socket
import struct
import threading
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import pytest
import rclpy
from facts_damping_msgs.msg import GridEvent, RefusedMessages
from mcap.reader import make_reader
from rclpy.context import Context
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from facts_damping.case.loading import load_case
from facts_damping.errors import RunError
from facts_damping.nodes.base.discovery import wait_for_peers
from facts_damping.nodes.base.parameters import Options
from facts_damping.nodes.base.qos import PUBLISHER_QOS, SUBSCRIBER_QOS
from facts_damping.nodes.base.topics import REFUSALS
from facts_damping.nodes.launching import graph, starting
from facts_damping.nodes.launching.starting import Parts
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from facts_damping_views.nodes.live_view import LISTENING
from tests.nodes.graphs import LOADED_S, PATIENCE_S, assert_same, nodes_left, payloads, quiet, wait_until

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from websockets.sync.client import ClientConnection

    from facts_damping.nodes.launching.processes import Process

PROTOCOL = Subprotocol("foxglove.sdk.v1")  # https://github.com/foxglove/ws-protocol, which it goes on from
MESSAGE, TIME = 1, 2  # first byte of what the server sends as bytes


class Client:
    """Subscribes to every channel that is advertised and keeps what comes."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.connection: ClientConnection | None = None
        self.channels: dict[int, dict[str, Any]] = {}
        self.messages: dict[str, list[tuple[int, bytes]]] = {}
        self.times: list[int] = []
        self.info: dict[str, Any] = {}
        self.subscribed: threading.Event | None = None
        self.thread = threading.Thread(target=self._listen, daemon=True)
        self.thread.start()

    def _connected(self) -> ClientConnection:
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                return connect(f"ws://127.0.0.1:{self.port}", subprotocols=[PROTOCOL], max_size=None)
            except OSError:
                assert time.monotonic() < deadline
                time.sleep(0.05)

    def _listen(self) -> None:
        with self._connected() as connection:
            self.connection = connection
            try:
                for data in connection:
                    self._text(connection, json.loads(data)) if isinstance(data, str) else self._bytes(data)
            except ConnectionClosed:
                pass

    def _text(self, connection: ClientConnection, message: dict[str, Any]) -> None:
        if message["op"] == "serverInfo":
            self.info = message
        elif message["op"] == "advertise":
            self.channels |= {channel["id"]: channel for channel in message["channels"]}
            wanted = [{"id": channel["id"], "channelId": channel["id"]} for channel in message["channels"]]
            connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
            self.subscribed = connection.ping()  # it is answered in order

    def wait(self) -> None:
        wait_until(lambda: self.subscribed is not None)
        assert self.subscribed is not None
        assert self.subscribed.wait(PATIENCE_S)

    def _bytes(self, data: bytes) -> None:
        if data[0] == MESSAGE:
            subscription, log_time = struct.unpack_from("<IQ", data, 1)
            self.messages.setdefault(self.channels[subscription]["topic"], []).append((log_time, data[13:]))
        elif data[0] == TIME:
            self.times.append(struct.unpack_from("<Q", data, 1)[0])

    def end(self) -> None:
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()


@pytest.fixture
def client(port: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Client]:
    """A client that graphs wait for once their view serves."""
    created, serving = Client(port), starting.wait_for_view

    def serving_client(view: Process) -> None:
        serving(view)
        created.wait()

    monkeypatch.setattr(starting, "wait_for_view", serving_client)
    yield created
    if created.connection is not None:
        created.connection.close()
    created.thread.join(PATIENCE_S)


def recorded_channels(folder: Path) -> dict[str, tuple[str, str, str]]:
    """Type, encoding of the schema and its text by topic."""
    with next((folder / "recording").glob("*.mcap")).open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    schemas = summary.schemas
    by_topic = {channel.topic: schemas[channel.schema_id] for channel in summary.channels.values()}
    return {topic: (schema.name, schema.encoding, schema.data.decode()) for topic, schema in by_topic.items()}


def stamp(cdr: bytes) -> int:
    """Time in a message's header, ns, from 0."""
    sec, nanosec = struct.unpack_from("<iI", cdr, 4)
    return int(max(0, 10**9 * sec + nanosec))


SETS = ["duration=3", "link=delay_100ms", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]


def test_client_gets_what_is_recorded_and_the_recording_keeps_its_bits(
    domain: int, tmp_path: Path, port: int, client: Client
) -> None:
    case = load_case(None, SETS)
    graph.run(case, "realtime", tmp_path, quiet, parts=Parts(view_port=port))
    client.end()
    fields = ("schemaName", "schemaEncoding", "schema")
    advertised = {row["topic"]: tuple(row[name] for name in fields) for row in client.channels.values()}
    assert advertised == recorded_channels(tmp_path)
    assert {channel["encoding"] for channel in client.channels.values()} == {"cdr"}
    assert "time" in client.info["capabilities"]
    # Of what the recorder says itself it gets bytes without the padding at the end.
    recorded = {
        topic: [message.rstrip(b"\0") for message in messages] for topic, messages in payloads(tmp_path).items()
    }
    assert set(client.messages) == set(recorded)
    for topic, messages in client.messages.items():
        assert [log_time for log_time, _ in messages] == [stamp(message) for _, message in messages], topic
        # In real time the answer to the last tick may come when the recorder has ended.
        last = max(map(stamp, recorded[topic]))
        data = [message.rstrip(b"\0") for log_time, message in messages if log_time <= last]
        # Best effort: it may have missed the first ones, when it was not connected yet, and any later one.
        assert len(data) >= 0.5 * len(recorded[topic]), topic
        assert set(data) <= set(recorded[topic]), topic
        places = [recorded[topic].index(message) for message in data]
        if topic != "/diagnostics":  # of several nodes, whose messages meet in any order
            assert places == sorted(set(places)), topic
    stamps = [log_time for log_time, _ in client.messages["/plant/state"]]
    assert stamps == sorted(stamps)
    assert stamps[-1] == 179 * 10**9 // 60
    assert set(stamps) <= set(client.times) | {stamps[0]}
    assert nodes_left(tmp_path) == []


def test_neither_client_nor_view_holds_anybody_up(
    domain: int, tmp_path: Path, port: int, client: Client, started: dict[str, Any]
) -> None:
    """In lockstep: one client reads, another does not; then the view is killed."""
    case = load_case(None, ["duration=20"])
    stalled: list[ClientConnection] = []
    with ExitStack() as opened:

        def stall_and_strike(done: int, of: int) -> None:
            if not stalled:
                address = f"ws://127.0.0.1:{port}"
                wanted = [{"id": i, "channelId": i} for i in range(1, 20)]
                connection = connect(address, subprotocols=[PROTOCOL], max_queue=1, close_timeout=0.1)
                stalled.append(opened.enter_context(connection))
                stalled[0].send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
            if done > 0.8 * of and client.messages:
                started["live_view"].process.kill()

        outcome = graph.run(case, "lockstep", tmp_path, stall_and_strike, LOADED_S, parts=Parts(view_port=port))
    client.end()
    assert client.messages
    assert started["live_view"].process.exitcode == -signal.SIGKILL
    assert outcome.messages_lost == 0
    assert_same(load(outcome.recording), loop.run(case))
    assert nodes_left(tmp_path) == []


def test_port_that_is_taken_is_named(domain: int, tmp_path: Path) -> None:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        bound.listen()
        port = bound.getsockname()[1]
        text = rf"live_view: host, port: 127.0.0.1, {port} given.*allowed: ones that are free"
        with pytest.raises(RunError, match=text):
            graph.run(load_case(None, ["duration=1"]), "lockstep", tmp_path, quiet, parts=Parts(view_port=port))
    assert nodes_left(tmp_path) == []


def test_view_by_hand_serves_graph_after_graph_and_ends_quietly(
    domain: int, tmp_path: Path, port: int, start: Any
) -> None:
    view = start("live_view", port=port)
    client = Client(port)
    wait_until(lambda: bool(client.channels))

    before: list[int] = []  # messages when a graph has begun, of those before it and its first

    def interrupt(_done: int, _of: int) -> None:
        count = len(client.messages.get("/plant/state", []))
        if len(before) < len(list(tmp_path.iterdir())):
            before.append(count)
        elif count > before[-1]:
            raise KeyboardInterrupt

    for name in ("first", "second"):  # each until the client has received it
        with pytest.raises(KeyboardInterrupt):
            graph.run(load_case(None, ["duration=1000"]), "lockstep", tmp_path / name, interrupt, LOADED_S)
    view.terminate()
    out, errors = view.communicate(timeout=PATIENCE_S)
    assert (view.returncode, out, errors) == (0, f"ws://127.0.0.1:{port}\n", "")
    client.end()


def test_nodes_do_not_take_a_view_for_a_peer(loopback: Any) -> None:
    rclpy.init()
    node, other = rclpy.create_node("node"), rclpy.create_node("other")
    elsewhere = Context()  # a process of its own, for DDS
    rclpy.init(context=elsewhere)

    def wait(seconds: float, recorder: bool = False) -> None:
        options = Options("lockstep", 5.0, seconds, recorder=recorder, view=False)
        wait_for_peers(node, {publisher: 1}, [], [f"/{REFUSALS}"], options, lambda: None)

    try:
        publisher = node.create_publisher(GridEvent, "events", PUBLISHER_QOS)
        other.create_subscription(GridEvent, "events", lambda _: None, LISTENING)
        wait_until(lambda: publisher.get_subscription_count() > 0)
        with pytest.raises(RunError, match=r"missing after 0.5 s: a subscriber of /events"):
            wait(0.5)
        outsider = rclpy.create_node("outsider", context=elsewhere)
        outsider.create_subscription(GridEvent, "events", lambda _: None, SUBSCRIBER_QOS)  # `ros2 topic echo`, a bag
        with pytest.raises(RunError, match=r"missing after 0.5 s: a subscriber of /events"):
            wait(0.5)
        bag = rclpy.create_node("rosbag2_recorder", context=elsewhere)
        bag.create_subscription(GridEvent, "events", lambda _: None, SUBSCRIBER_QOS)
        wait(PATIENCE_S, recorder=True)
        with pytest.raises(RunError, match=r"missing after 0.5 s: a subscriber of /events"):
            wait(0.5)
        outsider.create_publisher(RefusedMessages, REFUSALS, PUBLISHER_QOS)  # as nodes of a graph have it
        wait(PATIENCE_S)
    finally:
        other.destroy_node()
        node.destroy_node()
        rclpy.shutdown()
        rclpy.shutdown(context=elsewhere)
