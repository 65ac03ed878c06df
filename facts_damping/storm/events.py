"""Kinds of events of a storm: what they are drawn from, and what they do."""

from __future__ import annotations

import signal
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.case.names import controller_addresses, replaceable, setpoint_topics, supervisor_addresses
from facts_damping.control.table import kind_of
from facts_damping.monitor_table import COMMANDS
from facts_damping.nodes.launching.graph import PLANT, RECORDER
from facts_damping.nodes.loopback.middleware import Disturbance
from facts_damping.nodes.recorder import topics
from facts_damping.signals import NEVER, to_ns

if TYPE_CHECKING:
    import random
    from collections.abc import Callable

    from facts_damping.case.model import Case
    from facts_damping.storm.model import Event
    from facts_damping.storm.stage import Stage

ALL = ("lockstep", "realtime", "free")
PACED = ("realtime", "free")
KEPT = ("lockstep", "realtime")  # modes in which nodes keep their peers
ODD = (0.0, -1.0, 1.0, 1e9, -1e9, 1e-9, 0.5, "x", True, 3, [1.0])  # values for parameters
EVENTS = (
    "{kind: load, name: load_1, change: 0.1}",
    "{kind: line_out, line: line_1}",
    "{kind: fault, line: line_1, location: 0.5}",
    "{kind: nonsense}",
    "[",
    "",
)  # what may be asked of the plant
LINKS = ("fibre", "pdci", "ideal", "{up: [], down: []}", "{up: [{model: constant, delay: 0.2}]}", "nonsense", "../x")
SUBSCRIBED = {
    "supervisor": ("plant/state", "pmu/delivered", "setpoints"),
    "controller": ("pmu/delivered",),
    "identifier": ("pmu/delivered",),
    "link": ("pmu/frames", "setpoints"),
    "plant": ("setpoints/delivered",),
}  # ends of topics by role; the recorder subscribes to all
TRANSITIONS = (1, 2, 3, 4, 5, 6, 7, 99)  # lifecycle_msgs/msg/Transition


Drawn = dict[str, Any]


@dataclass
class Chance:
    """Random choices for the events of a case."""

    random: random.Random
    case: Case
    mode: str

    @property
    def duration(self) -> float:
        """Simulated time of the run, s."""
        return self.case.ticks / self.case.run.frame_rate

    def node(self, *without: str) -> str:
        """A node other than some."""
        return self.random.choice([name for name in nodes(self.case) if name not in without])

    def sender(self) -> str:
        """A node that sends setpoints."""
        return self.random.choice([name for name in replaceable(self.case) if "identifier" not in name])

    def subscription(self) -> Drawn:
        """A node and the end of a topic that it subscribes to."""
        node = self.node()
        own = next((ends for role, ends in SUBSCRIBED.items() if role in node), None)
        return {"node": node, "topic": self.random.choice(own) if own else self.topic()}

    def topic(self) -> str:
        """A topic of the graph."""
        return self.random.choice(sorted(topics(self.case)))

    def lasts(self, longest: float) -> float:
        """A time, s, rather short than long."""
        return round(longest * self.random.random() ** 3 + 0.001, 4)

    def seed(self) -> float:
        """A seed of the event's own random numbers."""
        return float(self.random.randrange(2**31))


def nodes(case: Case) -> list[str]:
    """Names of the nodes of a graph, relative to it."""
    return [PLANT, RECORDER, *replaceable(case)]


class Kind(NamedTuple):
    """A kind of event."""

    group: str  # middleware, process, operator or foreign
    text: str  # with the fields of an event in braces
    draw: Callable[[Chance], Drawn]
    act: Callable[[Stage, Event], None]
    modes: tuple[str, ...] = ALL
    harmless: tuple[str, ...] = ()  # modes in which the graph must reach its end in spite of it
    weight: float = 1.0
    starts: bool = False  # it happens while the nodes start


def _disturbance(**fields: Any) -> Callable[[Stage, Event], None]:
    """Adds a disturbance of the middleware; `fields`: its fields by those of the event."""

    def act(stage: Stage, event: Event) -> None:
        now = stage.world.now_ns
        ends = now + to_ns(event.lasts) if event.lasts else NEVER
        given = {name: value(event) if callable(value) else value for name, value in fields.items()}
        node = event.node.rpartition("/")[2]
        rows = stage.world.middleware.disturbances
        rows.append(Disturbance(now, ends, node, event.topic, seed=stage.storm.seed + len(rows) + 1, **given))

    return act


def _late(chance: Chance) -> Drawn:
    one = chance.random.random()
    where: Drawn = {} if one < 0.3 else {"node": chance.node()} if one < 0.7 else {"topic": chance.topic()}
    return {"lasts": chance.lasts(2.0), "size": chance.lasts(0.4), **where}


def _size_ns(event: Event) -> int:
    return to_ns(event.size)


def _kill(stage: Stage, event: Event) -> None:
    stage.signal(event.node, signal.SIGKILL)


def _suspend(stage: Stage, event: Event) -> None:
    stage.signal(event.node, signal.SIGSTOP)
    if event.lasts:
        stage.later(event.lasts, partial(stage.signal, event.node, signal.SIGCONT))


def _terminate(stage: Stage, event: Event) -> None:
    stage.signal(event.node, signal.SIGTERM)


def _restart(stage: Stage, event: Event) -> None:
    stage.signal(event.node, signal.SIGKILL)
    for i in range(1 + int(event.size)):
        stage.later(event.lasts * (i + 1), partial(stage.asked.append, (event.node, True)))


def _hang(stage: Stage, event: Event) -> None:
    if process := stage.process(event.node):
        process.busy_until_ns = max(process.busy_until_ns, stage.world.now_ns + to_ns(event.lasts))


def _slow(stage: Stage, event: Event) -> None:
    if process := stage.process(event.node):
        process.turn_ns = to_ns(event.size)
        stage.later(event.lasts, lambda: setattr(process, "turn_ns", 0))


def _clock(stage: Stage, event: Event) -> None:
    for name in [event.node] if event.node else list(stage.running):
        if process := stage.process(name):
            process.clock_offset_ns += to_ns(event.size)


def _disk(stage: Stage, event: Event) -> None:
    if process := stage.process(event.node):
        process.values["disk"] = event.name
        if event.lasts:
            stage.later(event.lasts, lambda: process.values.pop("disk", None))


def _terminate_at_line(stage: Stage, event: Event) -> None:
    stage.at_line[event.node] = int(event.size)


def _start_late(stage: Stage, event: Event) -> None:
    stage.late_s[event.node] = event.lasts


def _never_match(stage: Stage, event: Event) -> None:
    stage.world.middleware.unmatched = event.node.rpartition("/")[2], event.topic


def _call(stage: Stage, event: Event) -> None:
    stage.outsider.call(event.node, event.name, event.value)


def _set(stage: Stage, event: Event) -> None:
    stage.outsider.set_parameter(event.node, event.name, event.value)


def _service(chance: Chance) -> Drawn:
    """A service of one of the nodes, with a request."""
    node = chance.node()
    own = {PLANT: ["pause", "resume", "step", "reset", "rearm", "apply"], RECORDER: []}.get(node)
    if own is None:
        own = list(COMMANDS) if "supervisor" in node else ["arm", "apply"] if "link" in node else ["arm"]
    name = chance.random.choice([*own, *own, "change_state"])
    values: dict[str, tuple[Any, ...]] = {
        "step": (0, 1, 3),
        "apply": EVENTS if node == PLANT else LINKS,
        "change_state": TRANSITIONS,
    }
    return {"node": node, "name": name, "value": chance.random.choice(values.get(name, (None,)))}


def _parameter(chance: Chance) -> Drawn:
    """A parameter of a node, with a fitting or an odd value."""
    node, names = chance.node(RECORDER), ["timeout", "mode", "nonsense", "use_sim_time"]
    for address, controller in zip(controller_addresses(chance.case), chance.case.controllers, strict=True):
        if node == str(address):
            names = list(kind_of(controller).parameters) or names
    if "link" in node:
        names = ["up.0.delay", "down.0.delay", "up.0.loss", "up.1.delay"]
    if node == PLANT:
        names = ["event", "noise.angle"]
    value = chance.random.choice(EVENTS if node == PLANT and chance.random.random() < 0.8 else ODD)
    return {"node": node, "name": chance.random.choice(names), "value": value}


def _change_supervisor(chance: Chance) -> Drawn:
    places = [str(one) for one in supervisor_addresses(chance.case).values()]
    if not places:
        return _service(chance)
    return {"node": chance.random.choice(places), "name": chance.random.choice(list(COMMANDS))}


def _foreign(what: str) -> Callable[[Stage, Event], None]:
    """Publishes foreign messages from now on, one per tick, for a number of ticks."""

    def act(stage: Stage, event: Event) -> None:
        stage.attacks.append([what, event.topic, int(event.size), int(event.lasts)])
        if what == "replayed":
            stage.outsider.keep(event.topic)

    return act


def _attack(chance: Chance) -> Drawn:
    return {"topic": chance.topic(), "lasts": float(chance.random.choice([1, 1, 3, 10, 100])), "size": chance.seed()}


def _take_over(stage: Stage, event: Event) -> None:
    stage.signal(event.node, signal.SIGTERM)
    end = "delivered" if "link" in event.node else "supervised" if "supervisor" in event.node else "setpoints"
    topics_ = [topic for topic in setpoint_topics(stage.case) if topic.endswith(end) and _of(topic, event.node)]
    for topic in topics_[:1]:
        stage.later(event.lasts, partial(stage.attacks.append, ["forged", topic, 1, int(event.size)]))


def _of(topic: str, node: str) -> bool:
    """Whether a node publishes a topic; links publish in their namespace."""
    return topic.startswith(node.removesuffix("wan_link"))


def _second_plant(stage: Stage, event: Event) -> None:
    stage.asked.append((event.node, False))


def _deaf(stage: Stage, event: Event) -> None:
    stage.outsider.ignore(event.topic)


KINDS: dict[str, Kind] = {
    # The middleware.
    "late": Kind("middleware", "messages of {node}{topic} are late by up to {size} s for {lasts} s", _late,
                 _disturbance(late_ns=_size_ns), harmless=ALL, weight=2.0),
    "lost": Kind("middleware", "{size} of the messages of {node}{topic} are lost for {lasts} s",
                 lambda c: _late(c) | {"size": round(c.random.random(), 3), "node": c.node()},
                 _disturbance(loss=lambda event: event.size)),
    "cut_off": Kind("middleware", "{node} is cut off for {lasts} s",
                    lambda c: {"node": c.node(), "lasts": c.lasts(c.random.choice([1.0, 1.0, 40.0]))},
                    _disturbance(cut=True)),
    "unplugged": Kind("middleware", "{node} is cut off for ever", lambda c: {"node": c.node()},
                      _disturbance(cut=True), weight=0.5),
    "never_matched": Kind("middleware", "{node} never matches {topic}",
                          lambda c: c.subscription(), _never_match, weight=0.5, starts=True),
    "deaf": Kind("middleware", "a foreign subscriber of {topic} never reads", lambda c: {"topic": c.topic()}, _deaf,
                 harmless=ALL, weight=0.5),
    # Processes.
    "started_late": Kind("process", "{node} starts {lasts} s late",
                         lambda c: {"node": c.node(), "lasts": c.lasts(c.random.choice([2.0, 2.0, 40.0]))},
                         _start_late, starts=True),
    "killed": Kind("process", "{node} is killed", lambda c: {"node": c.random.choice([RECORDER, c.node()])}, _kill),
    "suspended": Kind("process", "{node} is suspended for {lasts} s",
                      lambda c: {"node": c.node(), "lasts": c.lasts(c.random.choice([1.0, 1.0, 30.0]))}, _suspend),
    "restarted": Kind("process", "{node} is killed, and started again after {lasts} s and {size} more times",
                      lambda c: {"node": c.node(PLANT, RECORDER), "lasts": c.lasts(2.0),
                                 "size": float(c.random.randrange(2))}, _restart, modes=PACED, weight=2.0),
    "terminated": Kind("process", "{node} gets SIGTERM", lambda c: {"node": c.node()}, _terminate),
    "terminated_at_line": Kind("process", "recorder gets SIGTERM at its line number {size}",
                               lambda c: {"node": RECORDER, "size": float(c.random.randrange(1, 3000))},
                               _terminate_at_line, weight=0.3, starts=True),
    "hung": Kind("process", "{node} hangs in a callback for {lasts} s",
                 lambda c: {"node": c.node(), "lasts": c.lasts(3.0)}, _hang),
    "slow": Kind("process", "each turn of {node} takes {size} s for {lasts} s",
                 lambda c: {"node": c.node(), "lasts": c.lasts(2.0), "size": c.lasts(0.02)}, _slow),
    "clock": Kind("process", "the clock of {node} jumps by {size} s",
                  lambda c: {"node": c.random.choice(["", c.node()]),
                             "size": c.random.choice([-1.0, 1.0]) * c.lasts(c.random.choice([1.0, 1e4]))},
                  _clock, harmless=ALL),
    "disk": Kind("process", "the disk of {node}: {name} for {lasts} s",
                 lambda c: {"node": c.random.choice([RECORDER, RECORDER, c.node()]),
                            "name": c.random.choice(["full", "read-only"]),
                            "lasts": c.random.choice([0.0, c.lasts(1.0)])}, _disk),
    # Operators.
    "service": Kind("operator", "{node}/{name} is called with {value!r}", _service, _call, weight=3.0),
    "command": Kind("operator", "{node}/{name} is called", _change_supervisor, _call, weight=2.0),
    "parameter": Kind("operator", "{node}: {name} is set to {value!r}", _parameter, _set, weight=2.0),
    # Foreign nodes.
    "forged": Kind("foreign", "{topic} is forged for {lasts:g} ticks", _attack, _foreign("forged"),
                   harmless=KEPT, weight=2.0),
    "forged_with_key": Kind("foreign", "{topic} is forged with the graph's key for {lasts:g} ticks", _attack,
                            _foreign("forged_with_key"), harmless=KEPT),
    "replayed": Kind("foreign", "{topic} is replayed for {lasts:g} ticks", _attack, _foreign("replayed"),
                     harmless=KEPT),
    "malformed": Kind("foreign", "{topic} is malformed for {lasts:g} ticks", _attack, _foreign("malformed"),
                      harmless=KEPT, weight=2.0),
    "older": Kind("foreign", "{topic} has messages of an older version for {lasts:g} ticks", _attack,
                  _foreign("older"), harmless=KEPT),
    "taken_over": Kind("foreign", "{node} gets SIGTERM; its setpoints are forged for {size:g} ticks after {lasts} s",
                       lambda c: {"node": c.sender(), "lasts": c.lasts(2.0), "size": 100.0}, _take_over, modes=PACED,
                       weight=2.0),
    "second_plant": Kind("foreign", "a second plant starts", lambda _: {"node": PLANT}, _second_plant, weight=0.5),
}  # fmt: skip


def words(event: Event) -> str:
    """An event in words."""
    kind = KINDS[event.kind]
    values = event.model_dump() | {"node": event.node or ("" if event.topic else "all nodes")}
    text = kind.text.format(**values)
    return text if event.lasts or "{lasts} s" not in kind.text else text.replace("for 0.0 s", "for ever")
