"""What all nodes share: parameters from the run's fields, start, readiness, orderly end."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import rclpy
from annotated_types import Ge, Gt, Le, Lt
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import Parameter
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from facts_damping.configuration import Case, load_case
from facts_damping.errors import FactsDampingError, InputError, RunError
from facts_damping.parameters.run import Run

if TYPE_CHECKING:
    from collections.abc import Callable

    from pydantic.fields import FieldInfo
    from rclpy.node import Node
    from rclpy.publisher import Publisher

RCLError = rclpy_implementation.RCLError

# Only the emulated link loses data: reliable, and nothing is overwritten before it is read.
RELIABLE = QoSProfile(history=QoSHistoryPolicy.KEEP_ALL, reliability=QoSReliabilityPolicy.RELIABLE, depth=0)

# Fields of a run that are parameters of every node; the others are reached through `set`.
RUN_FIELDS = ("system", "scenario", "link", "frame_rate", "duration", "seed")

OPTIONS: dict[str, tuple[Any, str]] = {
    "mode": (
        "lockstep",
        "lockstep: the plant waits for each tick's setpoints; realtime: it is paced by the clock",
    ),
    "timeout": (5.0, "longest wait for a silent node once the run goes, s"),
    "start_timeout": (30.0, "longest wait for the other nodes at the start, s"),
    "recorder": (False, "true: wait for a recorder before starting"),
}


@dataclass(frozen=True)
class Options:
    """Options of every node."""

    mode: str
    timeout: float
    start_timeout: float
    recorder: bool

    @property
    def realtime(self) -> bool:
        """Whether the plant is paced by the clock."""
        return self.mode == "realtime"


def descriptor(description: str, unit: str = "", low: Any = None, high: Any = None, read_only: bool = True) -> Any:
    """A ROS parameter's descriptor with meaning, unit and range."""
    made = ParameterDescriptor(description=f"{description} [{unit}]" if unit else description, read_only=read_only)
    if isinstance(low, int) and isinstance(high, int):
        made.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
    elif low is not None and high is not None:
        made.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high), step=0.0)]
    return made


def field_descriptor(field: FieldInfo) -> Any:
    """The descriptor of a run's field, from its declaration."""
    low = next((m.ge if isinstance(m, Ge) else m.gt for m in field.metadata if isinstance(m, (Ge, Gt))), None)
    high = next((m.le if isinstance(m, Le) else m.lt for m in field.metadata if isinstance(m, (Le, Lt))), None)
    extra = field.json_schema_extra
    unit = str(extra.get("unit", "")) if isinstance(extra, dict) else ""
    return descriptor(field.description or "", unit, low, high)


def read_case(node: Node) -> Case:
    """Declare the run's parameters and read the case that they describe."""
    text = "name of a run under config/runs, or path of a YAML file; empty: all defaults"
    run: Any = node.declare_parameter("run", "", descriptor(text)).value
    sets: Any = node.declare_parameter(
        "set", Parameter.Type.STRING_ARRAY, descriptor("changes to the run: key.path=value")
    ).value
    sets = list(sets or [])
    case = load_case(run or None, sets)
    changed = []
    for name in RUN_FIELDS:
        value = case.duration if name == "duration" else getattr(case.run, name)
        if isinstance(value, (str, int, float)):
            given: Any = node.declare_parameter(name, value, field_descriptor(Run.model_fields[name])).value
            if given != value:
                changed.append(f"{name}={given}")
    return load_case(run or None, [*changed, *sets]) if changed else case


def read_options(node: Node) -> Options:
    """Declare and read the options of every node."""
    limits = {"timeout": (0.05, 3600.0), "start_timeout": (0.05, 3600.0)}
    values = {
        name: node.declare_parameter(name, default, descriptor(text, "", *limits.get(name, ()))).value
        for name, (default, text) in OPTIONS.items()
    }
    options = Options(**values)
    if options.mode not in ("lockstep", "realtime"):
        raise InputError(f"mode: '{options.mode}' given; allowed: lockstep, realtime")
    return options


def wait_for_peers(node: Node, expected: dict[Publisher[Any], int], options: Options) -> None:
    """Wait until every publisher has its subscribers and every subscription a publisher; name what is missing."""
    deadline = time.monotonic() + options.start_timeout
    while True:
        missing = [
            f"a subscriber of {publisher.topic_name}"
            for publisher, count in expected.items()
            if publisher.get_subscription_count() < count
        ]
        missing += [
            f"a publisher of {subscription.topic_name}"
            for subscription in node.subscriptions
            if node.count_publishers(subscription.topic_name) < 1
        ]
        shared = [s.topic_name for s in node.subscriptions if node.count_publishers(s.topic_name) > 1]
        if shared:
            raise RunError(
                f"{node.get_name()}: another graph publishes {shared[0]} too; set another ROS_DOMAIN_ID (0 to 101)"
            )
        if not missing:
            return
        if time.monotonic() > deadline:
            raise RunError(f"{node.get_name()}: missing after {options.start_timeout:g} s: {', '.join(missing)}")
        time.sleep(0.01)  # messages that come meanwhile wait in their queues
        if not rclpy.ok():
            raise ExternalShutdownException


def publish(publisher: Publisher[Any], message: Any) -> None:
    """Publish; name the topic whose reader has stopped reading, and end quietly when the context is going."""
    try:
        publisher.publish(message)
    except RCLError as error:
        if not rclpy.ok():
            raise ExternalShutdownException from error
        raise RunError(f"{publisher.topic_name}: a subscriber (the recorder?) no longer reads: {error}") from error


def finish(publishers: list[Publisher[Any]], timeout: float) -> None:
    """Wait until every reader has acknowledged what was published."""
    for publisher in publishers:
        publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=timeout))


def run_node(name: str, body: Callable[[Node], None], signals: SignalHandlerOptions = SignalHandlerOptions.ALL) -> None:
    """Run a node's body to its end: exit status 0 done or interrupted, 1 failed, 2 bad input; one line says why."""
    status = 0
    rclpy.init(args=sys.argv, signal_handler_options=signals)
    node = rclpy.create_node(name, enable_rosout=False, start_parameter_services=True)
    try:
        body(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (FactsDampingError, ParameterException) as error:
        status = 1 if isinstance(error, RunError) else 2
        sys.stderr.write(f"{node.get_name()}: {' '.join(str(error).split())}\n")
    except Exception:
        if rclpy.ok():
            raise
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    sys.exit(status)
