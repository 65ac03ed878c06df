"""Compiles every kernel once, so that nothing waits for the compiler later: `python -m facts_damping.warmup`.

The plant's and the control's are compiled side by side, then the loop that calls them all.
"""

from __future__ import annotations

import multiprocessing
from typing import TYPE_CHECKING, Any

import numba

from facts_damping import loop
from facts_damping.configuration import load_case
from facts_damping.control.bank import act
from facts_damping.control.identifier import identify, remember, tell
from facts_damping.link.transfer import downlink, merge, uplink
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure

if TYPE_CHECKING:
    from collections.abc import Iterator

PARTS = ("plant", "control")


def calls(part: str) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """Kernels of a part with arguments of the types that they are given; their sizes do not count."""
    case = load_case(None, [])
    parts = loop.build_loop(case)
    kept = loop.room(case, parts, 1)
    plant, state, work = parts.plant, parts.plant_state, parts.work
    learners = parts.identifiers, parts.identifier_state
    if part == "plant":
        yield advance, (plant, state, 0, 0, parts.applied, 0, work)
        yield measure, (plant, state, 0, kept.frames[0], kept.machines[0], kept.devices[0], work)
        yield derivatives, (plant, state.x, state.reference, state.source, 0, state.x, work)
    else:
        arrived = parts.links.up.out[0]
        yield identify, (*learners, 0, arrived, 0)
        yield act, (parts.bank, parts.bank_state, 0, 0, arrived, 0, parts.issued, 0)
        yield remember, (*learners, 0, parts.issued, 0)
        yield tell, (*learners, 0, 0, kept.estimates, 0)
        yield uplink, (parts.links, 0, 0, 0, 0, kept.frames[0])
        yield downlink, (parts.links, 0, 0, 0, parts.issued, 0)
        yield merge, (parts.applied, 0, parts.links.down.out[0], 0)


def compile_part(part: str) -> None:
    """Compile the kernels of a part, or find them in the cache."""
    for kernel, arguments in calls(part):
        kernel.compile(tuple(map(numba.typeof, arguments)))


def main() -> None:
    """Compile both parts, then call every compiled function as the nodes and the loop do."""
    with multiprocessing.get_context("spawn").Pool(len(PARTS)) as pool:
        pool.map(compile_part, PARTS)
    case = load_case(None, ["duration=0.1", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"])
    loop.rehearse(case)
    loop.run(case)


if __name__ == "__main__":
    main()
