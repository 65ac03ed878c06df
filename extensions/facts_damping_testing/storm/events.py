"""Kinds of events of a storm: what they are drawn from, and what they do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.nodes.launching.starting import PLANT, RECORDER
from facts_damping_testing.storm import actions, choices

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping_testing.storm.choices import Chance, Drawn
    from facts_damping_testing.storm.model import Event


ALL = ("lockstep", "realtime", "free")
PACED = ("realtime", "free")
KEPT = ("lockstep", "realtime")  # modes in which nodes keep their peers


class Kind(NamedTuple):
    """A kind of event."""

    group: str  # middleware, process, operator or foreign
    text: str  # with the fields of an event in braces
    draw: Callable[[Chance], Drawn]
    act: Callable[[Any, Event], None]  # of the graph of a storm and an event
    modes: tuple[str, ...] = ALL
    harmless: tuple[str, ...] = ()  # modes in which the graph must reach its end in spite of it
    weight: float = 1.0
    starts: bool = False  # it happens while the nodes start


KINDS: dict[str, Kind] = {
    # The middleware.
    "late": Kind("middleware", "messages of {node}{topic} are late by up to {size} s for {lasts} s", choices.late,
                 actions.disturbance(late_ns=actions.size_ns), harmless=ALL, weight=2.0),
    "lost": Kind("middleware", "{size} of the messages of {node}{topic} are lost for {lasts} s",
                 lambda c: choices.late(c) | {"size": round(0.01 ** c.random.random(), 3), "node": c.node()},
                 actions.disturbance(loss=lambda event: event.size)),
    "cut_off": Kind("middleware", "{node} is cut off for {lasts} s",
                    lambda c: {"node": c.node(), "lasts": c.lasts(c.random.choice([1.0, 1.0, 40.0]))},
                    actions.disturbance(cut=True)),
    "unplugged": Kind("middleware", "{node} is cut off for ever", lambda c: {"node": c.node()},
                      actions.disturbance(cut=True), weight=0.5),
    "never_matched": Kind("middleware", "{node} never matches {topic}",
                          lambda c: c.subscription(), actions.never_match, weight=0.5, starts=True),
    "deaf": Kind("middleware", "a foreign subscriber of {topic} never reads", lambda c: {"topic": c.topic()},
                 actions.deaf, harmless=ALL, weight=0.5),
    # Processes.
    "started_late": Kind("process", "{node} starts {lasts} s late",
                         lambda c: {"node": c.node(), "lasts": c.lasts(c.random.choice([2.0, 2.0, 40.0]))},
                         actions.start_late, starts=True),
    "killed": Kind("process", "{node} is killed", lambda c: {"node": c.random.choice([RECORDER, c.node()])},
                   actions.kill),
    "suspended": Kind("process", "{node} is suspended for {lasts} s",
                      lambda c: {"node": c.node(), "lasts": c.lasts(c.random.choice([1.0, 1.0, 30.0]))},
                      actions.suspend),
    "restarted": Kind("process", "{node} is killed, and started again after {lasts} s and {size} more times",
                      lambda c: {"node": c.node(PLANT, RECORDER), "lasts": c.lasts(2.0),
                                 "size": float(c.random.randrange(2))}, actions.restart, modes=PACED, weight=2.0),
    "terminated": Kind("process", "{node} gets SIGTERM", lambda c: {"node": c.node()}, actions.terminate),
    "terminated_at_line": Kind("process", "recorder gets SIGTERM at its line number {size}",
                               lambda c: {"node": RECORDER, "size": float(c.random.randrange(1, 3000))},
                               actions.terminate_at_line, weight=0.3, starts=True),
    "hung": Kind("process", "{node} hangs in a callback for {lasts} s",
                 lambda c: {"node": c.node(), "lasts": c.lasts(3.0)}, actions.hang),
    "slow": Kind("process", "each turn of {node} takes {size} s for {lasts} s",
                 lambda c: {"node": c.node(), "lasts": c.lasts(2.0), "size": c.lasts(0.02)}, actions.slow),
    "clock": Kind("process", "the clock of {node} jumps by {size} s",
                  lambda c: {"node": c.random.choice(["", c.node()]),
                             "size": c.random.choice([-1.0, 1.0]) * c.lasts(c.random.choice([1.0, 1e4]))},
                  actions.clock, harmless=ALL),
    "disk": Kind("process", "the disk of {node}: {name} for {lasts} s",
                 lambda c: {"node": c.random.choice([RECORDER, RECORDER, c.node()]),
                            "name": c.random.choice(["full", "read-only"]),
                            "lasts": c.random.choice([0.0, c.lasts(1.0)])}, actions.disk),
    # Operators.
    "service": Kind("operator", "{node}/{name} is called with {value!r}", choices.service, actions.call, weight=3.0),
    "command": Kind("operator", "{node}/{name} is called", choices.change_supervisor, actions.call, weight=2.0),
    "parameter": Kind("operator", "{node}: {name} is set to {value!r}", choices.parameter, actions.set_parameter,
                      weight=2.0),
    # Foreign nodes.
    "forged": Kind("foreign", "{topic} is forged for {lasts:g} ticks", choices.attack, actions.foreign("forged"),
                   harmless=KEPT, weight=2.0),
    "forged_with_key": Kind("foreign", "{topic} is forged with the graph's key for {lasts:g} ticks", choices.attack,
                            actions.foreign("forged_with_key"), harmless=KEPT),
    "replayed": Kind("foreign", "{topic} is replayed for {lasts:g} ticks", choices.attack, actions.foreign("replayed"),
                     harmless=KEPT),
    "malformed": Kind("foreign", "{topic} is malformed for {lasts:g} ticks", choices.attack,
                      actions.foreign("malformed"), harmless=KEPT, weight=2.0),
    "older": Kind("foreign", "{topic} has messages of an older version for {lasts:g} ticks", choices.attack,
                  actions.foreign("older"), harmless=KEPT),
    "taken_over": Kind("foreign", "{node} gets SIGTERM; its setpoints are forged for {size:g} ticks after {lasts} s",
                       lambda c: {"node": c.sender(), "lasts": c.lasts(2.0), "size": 100.0}, actions.take_over,
                       modes=PACED, weight=2.0),
    "second_plant": Kind("foreign", "a second plant starts", lambda _: {"node": PLANT}, actions.second_plant,
                         weight=0.5),
}  # fmt: skip


def words(event: Event) -> str:
    """An event in words."""
    kind = KINDS[event.kind]
    values = event.model_dump() | {"node": event.node or ("" if event.topic else "all nodes")}
    text = kind.text.format(**values)
    return text if event.lasts or "{lasts} s" not in kind.text else text.replace("for 0.0 s", "for ever")
