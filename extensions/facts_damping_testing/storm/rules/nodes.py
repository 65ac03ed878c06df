"""Rules about nodes: they go on, end with a reason, count what they refuse, and keep up."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

from facts_damping.case.names import setpoint_topics
from facts_damping.nodes.base import lines
from facts_damping.nodes.launching.starting import PLANT, RECORDER
from facts_damping_testing.storm.events import KINDS
from facts_damping_testing.storm.rules.foreign import begins_undisturbed, may_be_replaced

if TYPE_CHECKING:
    from facts_damping_testing.storm.running import Trace


GROWTH = 15.0  # memory blocks a tick; the index of a recording needs up to 10
VARIES = 10_000  # memory blocks by which a count varies
QUEUE = 20_000  # messages; more in a queue of a node that responds means that it never takes them


def time_goes_on(trace: Trace) -> list[str]:
    """No node waits for ever: the graph ends by itself, and its plant gives up before the program that runs it does."""
    if trace.overdue:
        return [f"the graph does not end: {trace.world_s:.0f} s"]
    given_up = "no progress within" in trace.reason and all(event.node != PLANT for event in trace.events)
    return [f"the plant waits for ever: {trace.reason}"] if given_up else []


def ends_are_named(trace: Trace) -> list[str]:
    """Each node ends with status 0 or with one line that says why, without a traceback."""
    broken = []
    suspended = {event.node for event in trace.events if event.kind == "suspended"}  # the graph kills what does not end
    for node in trace.nodes:
        lines = node.errors.strip().splitlines()
        if "Traceback" in node.errors:
            broken.append(f"{node.name}: traceback: {lines[-1]}")
        elif node.status and node.status > 0 and len(lines) != 1:
            broken.append(f"{node.name} ends with status {node.status} and {len(lines)} lines: {' | '.join(lines[:3])}")
        elif node.status == 1 and re.match(r"\w*(Error|Exception)\b", lines[0].split(": ", 1)[-1]):
            broken.append(f"{node.name} ends by an error that is not its own: {lines[0]}")
        elif node.status is None or (node.status < 0 and not (node.killed or trace.overdue or node.name in suspended)):
            broken.append(f"{node.name} ends with status {node.status}, though no one killed it")
    return broken


def graph_survives(trace: Trace) -> list[str]:
    """What must not end a graph does not."""
    if trace.storm is None or not trace.reason:
        return []
    kinds = {event.kind for event in trace.events}
    if trace.storm.signed and "clock" in kinds:  # docs/operate.md: the clocks of hosts must agree then
        return []
    if any(controller.external for controller in trace.case.controllers):  # a user's node may fail by a foreign message
        return []
    if all(trace.mode in KINDS[kind].harmless for kind in kinds) and begins_undisturbed(trace):
        return [f"the graph ends early: {trace.reason}"]
    return []


def refusals_are_counted(trace: Trace) -> list[str]:
    """Each node tells a cause of refusal once in its log, and counts up."""
    broken = []
    refusals = Counter((name, text) for _, name, _, text in trace.logs if text.startswith("refused a message"))
    begun = Counter(node.name.rpartition("/")[2] for node in trace.nodes)
    for (name, text), count in refusals.items():
        if count > begun[name.rpartition(".")[2]] * (2 if trace.mode == "free" else 1):
            broken.append(f"{name} says {count} times: {text}")
    for node in trace.nodes:
        counts: dict[tuple[str, ...], int] = {}
        for how, count in lines.refusals(node.output):
            if count < counts.get(how, 0) and trace.mode != "free":
                broken.append(f"{node.name}: count of {how} falls to {count}")
            counts[how] = count
    return broken


def refusals_are_complete(trace: Trace) -> list[str]:
    """The recorder has counted each foreign message that it received, as far as nothing else was wrong."""
    storm, broken = trace.storm, []
    if storm is None or trace.mode == "free" or trace.reason or storm.discovery or not begins_undisturbed(trace):
        return []
    if any(
        KINDS[event.kind].group not in ("foreign", "operator") or event.kind == "second_plant" for event in storm.events
    ):
        return []
    output = next(node.output for node in trace.nodes if node.name == RECORDER)
    newest = {how: count for how, count in lines.refusals(output) if how[2] == "/outsider"}
    signed = setpoint_topics(trace.case)
    for topic, sent in trace.sent.items():
        if may_be_replaced(trace, signed=topic in signed or "pmu/" in topic):
            continue
        counted = sum(count for how, count in newest.items() if how[1].lstrip("/") == topic.lstrip("/"))
        if counted != sent:
            broken.append(f"{counted} refusals counted on {topic}, {sent} messages sent")
    return broken


def queues_are_bounded(trace: Trace) -> list[str]:
    """No queue of a node that works grows without bound."""
    return [f"{trace.longest_queue} messages in a queue"] if trace.longest_queue > QUEUE else []


def memory_is_bounded(trace: Trace) -> list[str]:
    """In the second half of a long storm, memory grows by no more than the index of the recording needs."""
    if len(trace.memory) < 2:
        return []
    (first, before), (last, after) = trace.memory[0], trace.memory[-1]
    grown, ticks = after - before, last - first
    return [f"memory grows by {grown} blocks in {ticks} ticks"] if grown > VARIES + GROWTH * ticks else []
