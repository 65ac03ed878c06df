"""Random choices for the events of storms: nodes, topics, times, services, parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from facts_damping.case.names import controller_addresses, replaceable, supervisor_addresses
from facts_damping.control.table import kind_of
from facts_damping.monitor_table import COMMANDS
from facts_damping.nodes.launching.starting import PLANT, RECORDER
from facts_damping.nodes.recorder import topics

if TYPE_CHECKING:
    import random

    from facts_damping.case.model import Case


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
        subscribed = next((ends for role, ends in SUBSCRIBED.items() if role in node), None)
        return {"node": node, "topic": self.random.choice(subscribed) if subscribed else self.topic()}

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


def late(chance: Chance) -> Drawn:
    """Late messages: of all nodes, of one, or of one topic."""
    fraction = chance.random.random()
    where: Drawn = {} if fraction < 0.3 else {"node": chance.node()} if fraction < 0.7 else {"topic": chance.topic()}
    return {"lasts": chance.lasts(2.0), "size": chance.lasts(0.4), **where}


def service(chance: Chance) -> Drawn:
    """A service of one of the nodes, with a request."""
    node = chance.node()
    services = {PLANT: ["pause", "resume", "step", "reset", "rearm", "apply"], RECORDER: []}.get(node)
    if services is None:
        services = list(COMMANDS) if "supervisor" in node else ["arm", "apply"] if "link" in node else ["arm"]
    name = chance.random.choice([*services, *services, "change_state"])
    values: dict[str, tuple[Any, ...]] = {
        "step": (0, 1, 3),
        "apply": EVENTS if node == PLANT else LINKS,
        "change_state": TRANSITIONS,
    }
    return {"node": node, "name": name, "value": chance.random.choice(values.get(name, (None,)))}


def parameter(chance: Chance) -> Drawn:
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


def change_supervisor(chance: Chance) -> Drawn:
    """A command for a supervisor, if there is one; else a service."""
    places = [str(address) for address in supervisor_addresses(chance.case).values()]
    if not places:
        return service(chance)
    return {"node": chance.random.choice(places), "name": chance.random.choice(list(COMMANDS))}


def attack(chance: Chance) -> Drawn:
    """Foreign messages on a topic, for a number of ticks."""
    return {"topic": chance.topic(), "lasts": float(chance.random.choice([1, 1, 3, 10, 100])), "size": chance.seed()}
