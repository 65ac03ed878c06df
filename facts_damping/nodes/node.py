"""What all nodes share: readiness, publishing, orderly end."""

from __future__ import annotations

import os
import signal
import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from facts_damping.errors import FactsDampingError, InputError, RunError
from facts_damping.nodes.spinning import HEARD_S, Stopped, check_wanted, stop_by_signals

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from rclpy.node import Node
    from rclpy.publisher import Publisher

    from facts_damping.case.names import Address
    from facts_damping.nodes.parameters import Options
    from facts_damping.nodes.spinning import Spinner

# Only the emulated link loses data: reliable, and a reader keeps all that it has not taken. A publisher keeps so many
# messages for readers that are late: who stops reading for longer misses some, and holds nobody up.
DEPTH = 5000
HEARING = QoSProfile(history=QoSHistoryPolicy.KEEP_ALL, reliability=QoSReliabilityPolicy.RELIABLE, depth=0)
SAYING = QoSProfile(history=QoSHistoryPolicy.KEEP_LAST, reliability=QoSReliabilityPolicy.RELIABLE, depth=DEPTH)

PROFILES, RANGE = "FASTDDS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE"

COMMON = "/diagnostics"  # everybody's topic
LEAVE_S = 5.0  # wall time that a node takes at most to leave the graph


def graph_prefix(node: Node, address: Address) -> str:
    """What leads from a node to the graph's own topics: nothing in the graph's namespace, else that namespace.

    Raises `InputError` where the node is not in the namespace that the run gives it.
    """
    own = node.get_namespace()
    if address.namespace and not own.endswith(f"/{address.namespace}"):
        raise InputError(f"namespace: {own} given; allowed: one that ends with /{address.namespace} (-r __ns:=...)")
    return own.removesuffix(address.namespace) if address.namespace else ""


def shared_topic(node: Node, topics: Iterable[str]) -> str | None:
    """The first of topics, each of which has one publisher in a graph, that somebody else publishes, too."""
    return next((topic for topic in topics if topic != COMMON and node.count_publishers(topic) > 1), None)


def wait_for_peers(node: Node, expected: dict[Publisher[Any], int], heard: Sequence[str], options: Options) -> None:
    """Wait until every publisher has its subscribers and every topic that is `heard` a publisher; name what is missing.

    Who joins a graph also waits until the one whose place it takes has left.
    """
    deadline = time.monotonic() + options.start_timeout
    while True:
        missing = [
            f"a subscriber of {publisher.topic_name}"
            for publisher, count in expected.items()
            if publisher.get_subscription_count() < count + max(viewers(node, publisher), int(options.view))
        ]
        missing += [f"a publisher of {topic}" for topic in heard if node.count_publishers(topic) < 1]
        shared, late = shared_topic(node, [*heard, *(p.topic_name for p in expected)]), time.monotonic() > deadline
        if shared is not None and (late or not options.join):
            raise RunError(f"another graph publishes {shared} too; set another ROS_DOMAIN_ID (0 to 101)")
        if not missing and shared is None:
            return
        if late:
            raise RunError(f"missing after {options.start_timeout:g} s: {', '.join(missing)}")
        time.sleep(0.01)  # messages that come meanwhile wait in their queues
        check_wanted()


def viewers(node: Node, publisher: Publisher[Any]) -> int:
    """Number of readers that may miss messages: these are nobody's peers."""
    readers = node.get_subscriptions_info_by_topic(publisher.topic_name)
    return sum(reader.qos_profile.reliability == QoSReliabilityPolicy.BEST_EFFORT for reader in readers)


def finish(publishers: Iterable[Publisher[Any]], timeout: float) -> None:
    """Wait, `timeout` seconds at most, until every reader has acknowledged what was published."""
    deadline = time.monotonic() + timeout
    for publisher in publishers:
        left = max(0.0, deadline - time.monotonic())
        publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=left))


class Part(Protocol):
    """What a node is beside its ROS side: set up by its constructor, then run."""

    spinner: Spinner

    def run(self) -> None:
        """Work until done or interrupted."""


def _from_wheels() -> bool:
    """Whether the middleware is that of the wheels, Fast DDS 3: the profile is in its words, others would complain."""
    try:
        return version("ros-fastdds").startswith("3.")
    except PackageNotFoundError:
        return False


def _set_up_middleware() -> None:
    """Have Fast DDS use UDP alone and, if it is that of the wheels, a profile of ours, unless the user says otherwise.

    In shared memory a node that is killed would leave what is its own to whoever comes next in the domain.
    """
    os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    if PROFILES in os.environ or not _from_wheels():
        return
    this_host = os.environ.get(RANGE) == "LOCALHOST"
    os.environ[PROFILES] = str(Path(__file__).with_name("fastdds_this_host.xml" if this_host else "fastdds.xml"))
    if this_host:
        os.environ[RANGE] = "SYSTEM_DEFAULT"  # as the profile says


def run_node(name: str, make: Callable[[Node], Part]) -> None:
    """Make a node and run it to its end: exit status 0 done or interrupted, 1 failed, 2 bad input.

    One line on standard error says why.
    """
    status = 0
    _set_up_middleware()
    stop_by_signals()
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(name, enable_rosout=False, start_parameter_services=True)
    try:
        part = make(node)
        try:
            part.run()
        except RunError as error:
            raise RunError(f"{error}{part.spinner.remark()}") from error
        finally:
            part.spinner.close()
        finish(node.publishers, HEARD_S)
    except Stopped:
        finish(node.publishers, HEARD_S)
    except (FactsDampingError, ParameterException) as error:
        status = 1 if isinstance(error, RunError) else 2
        sys.stderr.write(f"{node.get_fully_qualified_name().lstrip('/')}: {' '.join(str(error).split())}\n")
    finally:
        _leave(node)
    sys.exit(status)


def _leave(node: Node) -> None:
    """Destroy a node whose work is done and written.

    Now and then, once in some fifty runs on a loaded machine, a destructor of Fast DDS waits for ever (3.2, in
    `ResourceEvent::unregister_timer`), with Python's lock held. Then the process is ended from outside, by its alarm.
    """
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, LEAVE_S)
    node.destroy_node()
    rclpy.try_shutdown()
    signal.setitimer(signal.ITIMER_REAL, 0.0)
