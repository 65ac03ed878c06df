"""What all nodes share: readiness, publishing, orderly end."""

from __future__ import annotations

import os
import signal
import sys
import time
import warnings
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from facts_damping.errors import FactsDampingError, InputError, RunError, one_line, traced
from facts_damping.escaping import escaped
from facts_damping.input_files import naming_no_files
from facts_damping.nodes.base.exit_watchdog import end_after
from facts_damping.nodes.base.parameters import accept_whole_numbers, check_declared, declare, descriptor, usage
from facts_damping.nodes.base.spinner import HEARD_S, BeginAgain, Stopped, check_wanted, stop_by_signals
from facts_damping.terminal import INTERRUPTIONS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from rclpy.node import Node
    from rclpy.publisher import Publisher
    from rclpy.topic_endpoint_info import TopicEndpointInfo

    from facts_damping.case.names import Address
    from facts_damping.nodes.base.parameters import Options
    from facts_damping.nodes.base.spinner import Spinner

# Only the emulated link loses data: reliable, and a reader keeps all that it has not taken. A publisher keeps so many
# messages for readers that are late: who stops reading for longer misses some, and holds nobody up.
DEPTH = 5000
SUBSCRIBER_QOS = QoSProfile(history=QoSHistoryPolicy.KEEP_ALL, reliability=QoSReliabilityPolicy.RELIABLE, depth=0)
PUBLISHER_QOS = QoSProfile(history=QoSHistoryPolicy.KEEP_LAST, reliability=QoSReliabilityPolicy.RELIABLE, depth=DEPTH)

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
FAST_DDS = {"fastdds": "3.", "fastrtps": "2."}  # how wheels, variables and our profiles are named after its versions

# Of what who comes late hears, too: how the run stands, what was changed in it, and who hears either.
LATCHED, LOGGED = (
    QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        reliability=QoSReliabilityPolicy.RELIABLE,
        durability=QoSDurabilityPolicy.TRANSIENT_LOCAL,
        depth=depth,
    )
    for depth in (1, 1000)
)
LATCHED_SUBSCRIBER_QOS = QoSProfile(
    history=QoSHistoryPolicy.KEEP_ALL,
    reliability=QoSReliabilityPolicy.RELIABLE,
    durability=QoSDurabilityPolicy.TRANSIENT_LOCAL,
    depth=0,
)

COMMON = "/diagnostics"  # everybody's topic
STATE = "run/state"  # the plant's
CHANGES = "run/changes"  # of every node of a graph: what was changed in it while it went on
TOPIC = "security/refused"  # of every node of a graph: what it has refused
OF_ALL = (COMMON, CHANGES, TOPIC)  # ends of topics that many nodes publish
BAG = "rosbag2_recorder"  # how the node of `ros2 bag record` is called
NODE = 12  # first bytes of a publisher's identity that all of a node's have
PATIENT_S = 1.0  # wall time after which a node says what it waits for
LEAVE_S = 5.0  # wall time that a node takes at most to leave the graph


def graph_prefix(node: Node, address: Address) -> str:
    """What leads from a node to the graph's own topics: nothing in the graph's namespace, else that namespace.

    Raises `InputError` where the node is not in the namespace that the run gives it.
    """
    own = node.get_namespace()
    if address.namespace and not own.endswith(f"/{address.namespace}"):
        raise InputError(f"namespace: {own} given; allowed: one that ends with /{address.namespace} (-r __ns:=...)")
    return own.removesuffix(address.namespace) if address.namespace else ""


def shared_topic(node: Node, topics: Iterable[str], *, joins: bool) -> str | None:
    """The first of topics, each of which has one publisher in a graph, that somebody else publishes, too.

    `joins`: one of the same name may be there still, whose place the node takes: others let it in once that is silent.
    """
    for topic in topics:
        there = node.get_publishers_info_by_topic(topic)
        names = {(one.node_namespace, one.node_name) for one in there}
        if not topic.endswith(OF_ALL) and (len(names) if joins else len(there)) > 1:
            return topic
    return None


def wait_for_peers(
    node: Node,
    expected: dict[Publisher[Any], int],
    heard: Sequence[str],
    peers: str,
    options: Options,
    serve: Callable[[], None],
) -> None:
    """Wait until every publisher has its subscribers and every topic that is `heard` a publisher; name what is missing.

    Subscribers that count are nodes that publish what is heard, or on the topic `peers`, as all nodes of a graph do:
    whoever else listens is nobody's peer. Who joins a graph also waits until the one whose place it takes has left.
    Meanwhile requests are answered, by `serve`.
    """
    log, told = NodeLog(node), False
    deadline, topics = time.monotonic() + options.start_timeout, [*heard, *(p.topic_name for p in expected)]
    while True:
        own = {_participant(one) for topic in (peers, *heard) for one in node.get_publishers_info_by_topic(topic)}
        missing = [
            f"a subscriber of {publisher.topic_name}"
            for publisher, count in expected.items()
            if _readers(node, publisher, own, options) < count + int(options.view)
        ]
        missing += [f"a publisher of {topic}" for topic in heard if node.count_publishers(topic) < 1]
        shared, late = shared_topic(node, topics, joins=options.join), time.monotonic() > deadline
        if shared is not None and (late or not options.join):
            raise RunError(f"another graph publishes {shared} too; set another ROS_DOMAIN_ID (0 to 101)")
        if not missing and shared is None:
            return
        if not told and time.monotonic() > deadline - options.start_timeout + PATIENT_S:
            told = True
            what = ", ".join(missing) or f"the other publisher of {shared} to leave"
            log.info(f"waits, {options.start_timeout:g} s at most, for {what}")
        if late:
            raise RunError(f"missing after {options.start_timeout:g} s: {', '.join(missing)}")
        pause_briefly(serve)


def pause_briefly(serve: Callable[[], None]) -> None:
    """Wait a little, and answer requests; messages that come meanwhile wait in their queues."""
    time.sleep(0.01)
    serve()
    check_wanted()


def _participant(end: TopicEndpointInfo) -> bytes:
    """Which node an end of a topic is of: the GUID prefix of its identity (RTPS 2.5, 8.2.4.1)."""
    return bytes(end.endpoint_gid)[:NODE]


def _readers(node: Node, publisher: Publisher[Any], own: set[bytes], options: Options) -> int:
    """Number of a publisher's readers that are peers; and where they are wanted, of one live view and one `ros2 bag`.

    A live view may miss messages. At most as many as the publisher itself has found.
    """
    readers = node.get_subscriptions_info_by_topic(publisher.topic_name)
    peers = sum(_participant(reader) in own for reader in readers)
    views = any(reader.qos_profile.reliability == QoSReliabilityPolicy.BEST_EFFORT for reader in readers)
    bags = any(reader.node_name.startswith(BAG) for reader in readers)
    wanted = int(options.view and views) + int(options.recorder and bags)
    return min(peers + wanted, publisher.get_subscription_count())


def finish(publishers: Iterable[Publisher[Any]], timeout: float) -> None:
    """Wait, `timeout` seconds at most, until every reader has acknowledged what was published."""
    deadline = time.monotonic() + timeout
    for publisher in publishers:
        left = max(0.0, deadline - time.monotonic())
        publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=left))


class NodeLog:
    """What a node says: to people, by ROS 2's logging, and in lines to a program that started it (`progress`)."""

    def __init__(self, node: Node) -> None:
        """Declare the parameter, if that has not been done."""
        text = "true: progress and reasons as lines on standard output and error, for a program that runs the graph"
        if not node.has_parameter("progress"):
            declare(node, "progress", False, descriptor(text))
        self._name, self._logger = node.get_fully_qualified_name().lstrip("/"), node.get_logger()
        self.lines = bool(node.get_parameter("progress").value)

    def line(self, text: str) -> None:
        """A line for the program."""
        if self.lines:
            sys.stdout.write(f"{escaped(text)}\n")
            sys.stdout.flush()

    def info(self, text: str) -> None:
        """Something to be known."""
        self._logger.info(escaped(text))

    def warning(self, text: str) -> None:
        """Something that may be wrong."""
        self._logger.warning(escaped(text))

    def error(self, text: str) -> None:
        """Something that is wrong, to both."""
        self.line(text)
        self._logger.error(escaped(text))

    def fatal(self, text: str, details: str) -> None:
        """Why the node ends; `details`: where that is from, in lines."""
        self._logger.fatal(escaped(text))
        sys.stderr.write(escaped(details))
        if self.lines:
            sys.stderr.write(f"{self._name}: {escaped(text)}\n")


class NodeBody(Protocol):
    """What a node is beside its ROS side: set up by its constructor, made ready, then run."""

    spinner: Spinner

    def ready(self) -> None:
        """Wait for others, and take what is needed from here on."""

    def run(self) -> None:
        """Work until done or interrupted."""


def profile(this_host: bool) -> tuple[str, Path] | None:
    """Our profile in the words of the wheels' Fast DDS, and the variable that it is given by; others would complain."""
    for name, major in FAST_DDS.items():
        with suppress(PackageNotFoundError):
            if version(f"ros-{name}").startswith(major):
                file = f"{name}_this_host.xml" if this_host else f"{name}.xml"
                return f"{name.upper()}_DEFAULT_PROFILES_FILE", Path(__file__).with_name(file)
    return None


def _set_up_middleware() -> None:
    """Have Fast DDS use UDP alone and, if it is that of wheels, a profile of ours, unless the user says otherwise.

    In shared memory a node that is killed would leave what is its own to whoever comes next in the domain.
    """
    os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    this_host = os.environ.get(RANGE) == "LOCALHOST"
    ours = profile(this_host)
    if ours is None or ours[0] in os.environ:
        return
    os.environ[ours[0]] = str(ours[1])
    if this_host:
        os.environ[RANGE] = "SYSTEM_DEFAULT"  # as the profile says


def run_node(name: str, make: Callable[[Node], NodeBody], does: str) -> None:
    """Make a node and run it to its end: exit status 0 done or interrupted, 1 failed, 2 bad input.

    One line says why. `does`: what `--help` says first. Where the graph runs free, another plant has it made anew.
    """
    _set_up_middleware()
    stop_by_signals()
    warnings.filterwarnings("ignore", "failed to send response", RuntimeWarning)  # who asked may have left
    if _asks_for_help():
        os.environ[RANGE] = "OFF"  # nobody need know of a node that does not run
    status = None
    while status is None:
        try:
            if not rclpy.ok():
                rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
            node = rclpy.create_node(name, start_parameter_services=True)
        except Exception as error:  # noqa: BLE001 (arguments of ROS 2 that rclpy cannot use, each kind in its own way)
            sys.stderr.write(f"{name}: {one_line(error)}\n")
            sys.exit(2)
        status = _run(node, make, does)
        if status is not None:
            _limit_the_end(status)
        node.destroy_node()
    rclpy.try_shutdown()
    sys.exit(status)


def _asks_for_help() -> bool:
    return not {"-h", "--help"}.isdisjoint(sys.argv[1:])


def _run(node: Node, make: Callable[[Node], NodeBody], does: str) -> int | None:
    """Run a node to its end; its exit status, or None where it has to begin again."""
    accept_whole_numbers(node)
    log = NodeLog(node)
    try:
        part = make(node)
        if _asks_for_help():
            sys.stdout.write(f"{usage(node, does)}\n")
            return 0
        check_declared(node)
        try:
            with naming_no_files("a message, a service or a parameter"):
                part.ready()
                part.run()
        except RunError as error:
            raise RunError(f"{error}{part.spinner.remark()}") from error
        finally:
            part.spinner.close()
        finish(node.publishers, HEARD_S)
        log.info("ended")
    except Stopped:
        finish(node.publishers, HEARD_S)
        log.info("ended: stopped by a signal")
    except BeginAgain:
        log.info("another plant has begun: this node begins again, too")
        return None
    except (FactsDampingError, ParameterException) as error:
        log.fatal(one_line(error), traced(error))
        return 1 if isinstance(error, RunError) else 2
    return 0


def _limit_the_end(status: int) -> None:
    """Have a process whose work is done and written end as it should, also if its middleware does not let it."""
    for number in INTERRUPTIONS:
        signal.signal(number, signal.SIG_IGN)  # it ends; Python, when it ends, would let them kill it
    sys.stdout.flush()
    end_after(LEAVE_S, status)
