"""Where foreign nodes may take part: rules do not hold there."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping_testing.storm.events import KINDS

if TYPE_CHECKING:
    from facts_damping_testing.storm.running import Trace


KNOWN = 2  # tick from which all nodes know the publishers of their topics


def may_be_replaced(trace: Trace, *, signed: bool = True) -> bool:
    """Whether a foreign node may take a node's place: without the key it may in an unsigned graph that is paced.

    docs/operate.md says so: it begins before the node, or when the node is gone. `signed`: whether signed graphs sign
    the messages that are asked about.
    """
    if trace.storm is None:
        return False
    kinds = {event.kind for event in trace.events}
    if trace.mode == "lockstep" and not any(
        done.tick < 1 and done.kind.startswith("forged") for done in trace.timeline
    ):
        return False
    foreign = any(KINDS[kind].group == "foreign" and kind != "second_plant" for kind in kinds)
    return "forged_with_key" in kinds or (foreign and not (signed and trace.storm.signed))


def begins_undisturbed(trace: Trace) -> bool:
    """Whether no foreign node was there before the nodes knew each other: it would count as another graph."""
    return all(done.tick >= KNOWN for done in trace.timeline if KINDS[done.kind].group == "foreign")
