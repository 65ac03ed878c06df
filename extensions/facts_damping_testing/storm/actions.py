"""What the events of storms do to a graph."""

from __future__ import annotations

import signal
from functools import partial
from typing import TYPE_CHECKING, Any

from facts_damping.case.names import setpoint_topics
from facts_damping.signals import NEVER, to_ns
from facts_damping_testing.loopback.middleware import Disturbance

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping_testing.storm.model import Event
    from facts_damping_testing.storm.storm_graph import StormGraph


def disturbance(**fields: Any) -> Callable[[StormGraph, Event], None]:
    """Adds a disturbance of the middleware; `fields`: its fields by those of the event."""

    def act(storm_graph: StormGraph, event: Event) -> None:
        now = storm_graph.world.now_ns
        ends = now + to_ns(event.lasts) if event.lasts else NEVER
        values = {name: value(event) if callable(value) else value for name, value in fields.items()}
        node = event.node.rpartition("/")[2]
        rows = storm_graph.world.middleware.disturbances
        rows.append(Disturbance(now, ends, node, event.topic, seed=storm_graph.storm.seed + len(rows) + 1, **values))

    return act


def size_ns(event: Event) -> int:
    """The size of an event, which is a time, in ns."""
    return to_ns(event.size)


def kill(storm_graph: StormGraph, event: Event) -> None:
    """Kill a node."""
    storm_graph.signal(event.node, signal.SIGKILL)


def suspend(storm_graph: StormGraph, event: Event) -> None:
    """Suspend a node for a time, or for ever."""
    storm_graph.signal(event.node, signal.SIGSTOP)
    if event.lasts:
        storm_graph.later(event.lasts, partial(storm_graph.signal, event.node, signal.SIGCONT))


def terminate(storm_graph: StormGraph, event: Event) -> None:
    """Send SIGTERM to a node."""
    storm_graph.signal(event.node, signal.SIGTERM)


def restart(storm_graph: StormGraph, event: Event) -> None:
    """Kill a node, and let it be started again once or twice."""
    storm_graph.signal(event.node, signal.SIGKILL)
    for i in range(1 + int(event.size)):
        storm_graph.later(event.lasts * (i + 1), partial(storm_graph.asked.append, (event.node, True)))


def hang(storm_graph: StormGraph, event: Event) -> None:
    """Let a node hang in a callback."""
    if process := storm_graph.process(event.node):
        process.busy_until_ns = max(process.busy_until_ns, storm_graph.world.now_ns + to_ns(event.lasts))


def slow(storm_graph: StormGraph, event: Event) -> None:
    """Let each turn of a node take a time."""
    if process := storm_graph.process(event.node):
        process.turn_ns = to_ns(event.size)
        storm_graph.later(event.lasts, lambda: setattr(process, "turn_ns", 0))


def clock(storm_graph: StormGraph, event: Event) -> None:
    """Set the clock of a node, or of all."""
    for name in [event.node] if event.node else list(storm_graph.running):
        if process := storm_graph.process(name):
            process.clock_offset_ns += to_ns(event.size)


def disk(storm_graph: StormGraph, event: Event) -> None:
    """Let the disk of a node fail."""
    if process := storm_graph.process(event.node):
        process.values["disk"] = event.name
        if event.lasts:
            storm_graph.later(event.lasts, lambda: process.values.pop("disk", None))


def terminate_at_line(storm_graph: StormGraph, event: Event) -> None:
    """Send SIGTERM to a node at one of its lines."""
    storm_graph.at_line[event.node] = int(event.size)


def start_late(storm_graph: StormGraph, event: Event) -> None:
    """Let a node start late."""
    storm_graph.late_s[event.node] = event.lasts


def never_match(storm_graph: StormGraph, event: Event) -> None:
    """Let a subscription never match."""
    storm_graph.world.middleware.unmatched = event.node.rpartition("/")[2], event.topic


def call(storm_graph: StormGraph, event: Event) -> None:
    """Call a service of a node."""
    storm_graph.outsider.call(event.node, event.name, event.value)


def set_parameter(storm_graph: StormGraph, event: Event) -> None:
    """Set a parameter of a node."""
    storm_graph.outsider.set_parameter(event.node, event.name, event.value)


def foreign(what: str) -> Callable[[StormGraph, Event], None]:
    """Publishes foreign messages from now on, one per tick, for a number of ticks."""

    def act(storm_graph: StormGraph, event: Event) -> None:
        storm_graph.attacks.append([what, event.topic, int(event.size), int(event.lasts)])
        if what == "replayed":
            storm_graph.outsider.keep(event.topic)

    return act


def take_over(storm_graph: StormGraph, event: Event) -> None:
    """End a node, and forge its setpoints afterwards."""
    storm_graph.signal(event.node, signal.SIGTERM)
    end = "delivered" if "link" in event.node else "supervised" if "supervisor" in event.node else "setpoints"
    topics_ = [topic for topic in setpoint_topics(storm_graph.case) if topic.endswith(end) and _of(topic, event.node)]
    for topic in topics_[:1]:
        storm_graph.later(event.lasts, partial(storm_graph.attacks.append, ["forged", topic, 1, int(event.size)]))


def _of(topic: str, node: str) -> bool:
    """Whether a node publishes a topic; links publish in their namespace."""
    return topic.startswith(node.removesuffix("wan_link"))


def second_plant(storm_graph: StormGraph, event: Event) -> None:
    """Start a second plant."""
    storm_graph.asked.append((event.node, False))


def deaf(storm_graph: StormGraph, event: Event) -> None:
    """Subscribe to a topic and never read it."""
    storm_graph.outsider.ignore(event.topic)
