"""Compiles every kernel once, so that nothing waits for the compiler later: `python -m facts_damping.nodes.warmup`.

The plant's and the control's are compiled side by side, then the loop that calls them all.
"""

from __future__ import annotations

import multiprocessing
from typing import Any

import numpy as np

from facts_damping.case.loading import load_case
from facts_damping.compiling import specialised
from facts_damping.control.bank import act, set_estimate
from facts_damping.control.identifier import identify, store_setpoints, write_estimates
from facts_damping.link.transfer import downlink, merge, uplink
from facts_damping.nodes.packing import mark, pack, take, unpack
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure
from facts_damping.simulation import loop

PARTS = ("plant", "control")


def kernels() -> dict[str, list[tuple[Any, ...]]]:
    """Every function that nodes call, by part: with arguments of the types that it is given; sizes do not count."""
    case = load_case(None, [])
    parts = loop.build_loop(case)
    kept = parts.signals
    plant, state, work = parts.plant, parts.plant_state, parts.work
    learner, arrived = (parts.identifiers, parts.identifier_state, 0), parts.links.up.out[0]
    data, places = np.frombuffer(b"", np.uint8), np.zeros((1, 1), np.int64)
    seconds, nanoseconds, words, ticks, status = (np.zeros(1, kind) for kind in ("i4", "u4", "i8", "u8", "u2"))
    rows = places, 0, 0, places, seconds, nanoseconds, words
    return {
        "plant": [
            (advance, plant, state, 0, 0, parts.applied, 0, work),
            (measure, plant, state, 0, kept.frames[0], kept.machines[0], kept.devices[0], work),
            (derivatives, plant, state.x, state.reference, state.source, 0, state.x, work),
        ],
        "control": [
            (identify, *learner, arrived, 0),
            (act, parts.bank, parts.bank_state, 0, 0, arrived, 0, parts.issued, 0),
            (set_estimate, parts.bank_state, 0, np.zeros((1, 1)), np.zeros(1), 0),
            (store_setpoints, *learner, parts.issued, 0),
            (write_estimates, *learner, 0, kept.estimates, 0),
            (uplink, parts.links, 0, 0, 0, 0, kept.frames[0]),
            (downlink, parts.links, 0, 0, 0, parts.issued, 0),
            (merge, parts.applied, 0, parts.links.down.out[0], 0),
            (pack, *rows),
            (unpack, *rows),
            (mark, arrived, 0, 0, places, ticks, status),
            (take, data, status.view(np.uint8), places[0], status.view(np.uint8)),
        ],
    }


def compile_part(part: str) -> None:
    """Compile the kernels of a part, or find them in the cache."""
    for kernel, *arguments in kernels()[part]:
        specialised(kernel, *arguments)


def main() -> None:
    """Compile both parts, then the loop that calls them."""
    with multiprocessing.get_context("spawn").Pool(len(PARTS)) as pool:
        pool.map(compile_part, PARTS)
    loop.run(load_case(None, ["duration=0.1", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]))


if __name__ == "__main__":
    main()
