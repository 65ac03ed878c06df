"""What happens to the graph of a storm: its events in time, attacks, and the mends at the end."""

from __future__ import annotations

import gc
import signal
import sys
from typing import TYPE_CHECKING, Any

from facts_damping.nodes import clock
from facts_damping.nodes.launching.starting import PLANT
from facts_damping_testing.attacker import forgeries
from facts_damping_testing.foreign.messages import foreign
from facts_damping_testing.foreign.outsider import Outsider
from facts_damping_testing.loopback.domain import domain
from facts_damping_testing.loopback.topics import Subscription
from facts_damping_testing.storm.events import KINDS, words
from facts_damping_testing.storm.storm_graph import MARK, PATIENCE_S, STALLED_S, Done

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping_testing.storm.model import Event
    from facts_damping_testing.storm.storm_graph import StormGraph

POLL_S = 0.05
STOP_PLANT = "change_state", "cut_off", "unplugged", "lost"  # services and events after which it may not go on
MEASURED = 300  # ticks of a storm from which its memory is measured
BEHIND = 100  # messages; more in a queue take memory themselves
UNREACHABLE = 200  # polls after which a plant that was resumed and has no new tick is stopped


def conduct(storm_graph: StormGraph) -> None:
    """Do what the events say, in time, as a process of the world."""
    storm_graph.outsider = Outsider(storm_graph.case)
    cases = storm_graph.foreign, storm_graph.case
    forged = {with_key: forgeries(case, PATIENCE_S, MARK) for with_key, case in enumerate(cases)}
    attacked = -1
    waiting = [event for event in storm_graph.storm.events if not KINDS[event.kind].starts]
    while True:
        now_s = storm_graph.time_s()
        while waiting and waiting[0].at <= now_s:
            do(storm_graph, waiting.pop(0))
        if not waiting and clock.monotonic() - 1e-9 * storm_graph.tick_at[1] > STALLED_S:
            _mend(storm_graph)
        if storm_graph.outsider.newest > attacked:
            attacked = storm_graph.outsider.newest
            _attack(storm_graph, forged, attacked)
            _measure(storm_graph, attacked)
        storm_graph.outsider.wait(clock.monotonic() + min(POLL_S, waiting[0].at - now_s if waiting else POLL_S))


def do(storm_graph: StormGraph, event: Event) -> None:
    """Let an event happen."""
    tick = storm_graph.tick_at[0]
    storm_graph.timeline.append(Done(1e-9 * storm_graph.world.now_ns, tick, event.kind, event.node, words(event)))
    KINDS[event.kind].act(storm_graph, event)


def _mend(storm_graph: StormGraph) -> None:
    """Resume a plant that is paused once all events are over, and stop one that cannot be reached."""
    if plant := storm_graph.process(PLANT):
        plant.values["mended"] = plant.values.get("mended", 0) + 1
        if plant.values["mended"] == 1:
            storm_graph.outsider.call(PLANT, "resume", None)
        elif plant.values["mended"] == UNREACHABLE:
            works = plant.responds and plant.busy_until_ns <= storm_graph.world.now_ns
            of_plant = [event for event in storm_graph.storm.events if event.node in ("", PLANT)]
            storm_graph.overdue = works and not any((event.name or event.kind) in STOP_PLANT for event in of_plant)
            storm_graph.signal(PLANT, signal.SIGTERM)


def _measure(storm_graph: StormGraph, tick: int) -> None:
    """Count the memory blocks in use, in a long storm, after each eighth of its second half.

    While a node is behind, nothing is counted: what waits takes memory itself.
    """
    ticks, last = storm_graph.case.ticks, storm_graph.memory[-1][0] if storm_graph.memory else 0
    due = ticks >= MEASURED and ticks // 2 <= tick < ticks and tick - last >= ticks // 16
    if due and all(
        len(subscription.waiting) + subscription.under_way <= BEHIND for subscription in domain().of(Subscription)
    ):
        gc.collect()
        storm_graph.memory.append((tick, sys.getallocatedblocks()))


def _attack(storm_graph: StormGraph, forged: dict[int, dict[str, Callable[[int], bytes]]], tick: int) -> None:
    """Publish one message of each attack."""
    for attack in storm_graph.attacks:
        what, topic, seed, left = attack
        forge = forged["key" in what].get(topic)
        if left > 0 and (
            data := _foreign(storm_graph, what.removesuffix("_with_key"), topic, forge, tick, seed + left)
        ):
            storm_graph.outsider.publish(topic, data)
            attack[3] = left - 1


def _foreign(storm_graph: StormGraph, what: str, topic: str, *how: Any) -> bytes:
    return foreign(what, storm_graph.outsider.kinds[topic], storm_graph.outsider.kept.get(topic, ()), *how)
