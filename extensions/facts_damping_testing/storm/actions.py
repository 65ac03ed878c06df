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
    from facts_damping_testing.storm.stage import Stage


def disturbance(**fields: Any) -> Callable[[Stage, Event], None]:
    """Adds a disturbance of the middleware; `fields`: its fields by those of the event."""

    def act(stage: Stage, event: Event) -> None:
        now = stage.world.now_ns
        ends = now + to_ns(event.lasts) if event.lasts else NEVER
        given = {name: value(event) if callable(value) else value for name, value in fields.items()}
        node = event.node.rpartition("/")[2]
        rows = stage.world.middleware.disturbances
        rows.append(Disturbance(now, ends, node, event.topic, seed=stage.storm.seed + len(rows) + 1, **given))

    return act


def size_ns(event: Event) -> int:
    """The size of an event, which is a time, in ns."""
    return to_ns(event.size)


def kill(stage: Stage, event: Event) -> None:
    """Kill a node."""
    stage.signal(event.node, signal.SIGKILL)


def suspend(stage: Stage, event: Event) -> None:
    """Suspend a node for a time, or for ever."""
    stage.signal(event.node, signal.SIGSTOP)
    if event.lasts:
        stage.later(event.lasts, partial(stage.signal, event.node, signal.SIGCONT))


def terminate(stage: Stage, event: Event) -> None:
    """Send SIGTERM to a node."""
    stage.signal(event.node, signal.SIGTERM)


def restart(stage: Stage, event: Event) -> None:
    """Kill a node, and let it be started again once or twice."""
    stage.signal(event.node, signal.SIGKILL)
    for i in range(1 + int(event.size)):
        stage.later(event.lasts * (i + 1), partial(stage.asked.append, (event.node, True)))


def hang(stage: Stage, event: Event) -> None:
    """Let a node hang in a callback."""
    if process := stage.process(event.node):
        process.busy_until_ns = max(process.busy_until_ns, stage.world.now_ns + to_ns(event.lasts))


def slow(stage: Stage, event: Event) -> None:
    """Let each turn of a node take a time."""
    if process := stage.process(event.node):
        process.turn_ns = to_ns(event.size)
        stage.later(event.lasts, lambda: setattr(process, "turn_ns", 0))


def clock(stage: Stage, event: Event) -> None:
    """Set the clock of a node, or of all."""
    for name in [event.node] if event.node else list(stage.running):
        if process := stage.process(name):
            process.clock_offset_ns += to_ns(event.size)


def disk(stage: Stage, event: Event) -> None:
    """Let the disk of a node fail."""
    if process := stage.process(event.node):
        process.values["disk"] = event.name
        if event.lasts:
            stage.later(event.lasts, lambda: process.values.pop("disk", None))


def terminate_at_line(stage: Stage, event: Event) -> None:
    """Send SIGTERM to a node at one of its lines."""
    stage.at_line[event.node] = int(event.size)


def start_late(stage: Stage, event: Event) -> None:
    """Let a node start late."""
    stage.late_s[event.node] = event.lasts


def never_match(stage: Stage, event: Event) -> None:
    """Let a subscription never match."""
    stage.world.middleware.unmatched = event.node.rpartition("/")[2], event.topic


def call(stage: Stage, event: Event) -> None:
    """Call a service of a node."""
    stage.outsider.call(event.node, event.name, event.value)


def set_parameter(stage: Stage, event: Event) -> None:
    """Set a parameter of a node."""
    stage.outsider.set_parameter(event.node, event.name, event.value)


def foreign(what: str) -> Callable[[Stage, Event], None]:
    """Publishes foreign messages from now on, one per tick, for a number of ticks."""

    def act(stage: Stage, event: Event) -> None:
        stage.attacks.append([what, event.topic, int(event.size), int(event.lasts)])
        if what == "replayed":
            stage.outsider.keep(event.topic)

    return act


def take_over(stage: Stage, event: Event) -> None:
    """End a node, and forge its setpoints afterwards."""
    stage.signal(event.node, signal.SIGTERM)
    end = "delivered" if "link" in event.node else "supervised" if "supervisor" in event.node else "setpoints"
    topics_ = [topic for topic in setpoint_topics(stage.case) if topic.endswith(end) and _of(topic, event.node)]
    for topic in topics_[:1]:
        stage.later(event.lasts, partial(stage.attacks.append, ["forged", topic, 1, int(event.size)]))


def _of(topic: str, node: str) -> bool:
    """Whether a node publishes a topic; links publish in their namespace."""
    return topic.startswith(node.removesuffix("wan_link"))


def second_plant(stage: Stage, event: Event) -> None:
    """Start a second plant."""
    stage.asked.append((event.node, False))


def deaf(stage: Stage, event: Event) -> None:
    """Subscribe to a topic and never read it."""
    stage.outsider.ignore(event.topic)
