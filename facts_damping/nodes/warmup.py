"""Compiles every kernel once, so that nothing waits for the compiler later: `python -m facts_damping.nodes.warmup`.

The plant's and the control's are compiled side by side, then the loop that calls them all. A node that is started on a
machine where that has not been done has it done (`compile_once`).
"""

from __future__ import annotations

import fcntl
import multiprocessing
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.case.loading import load_case
from facts_damping.compiling import fingerprint, home, specialised
from facts_damping.control.bank import act, set_estimate
from facts_damping.control.identifier import identify, store_setpoints, write_estimates
from facts_damping.link.transfer import downlink, merge, uplink
from facts_damping.nodes.packing import mark, pack, take, unpack
from facts_damping.plant.dynamics import derivatives
from facts_damping.simulation import loop, tick
from facts_damping.simulation.measured_plant import go_on, observe

if TYPE_CHECKING:
    from pathlib import Path

PARTS = ("plant", "control")


def kernels() -> dict[str, list[tuple[Any, ...]]]:
    """Every function that nodes call, by part: with arguments of the types that it is given; sizes do not count."""
    case = load_case(None, [])
    parts = loop.build_loop(case)
    kept = parts.signals
    plant, state, work = parts.plant, parts.plant_state, parts.work
    learner, arrived = (parts.identifiers, parts.identifier_state, 0), parts.links.up.out[0]
    measured = plant, state, parts.pmus, parts.pmu_state
    reported = kept.frames[0], kept.measured_ns[0], kept.status[0]
    data, places = np.frombuffer(b"", np.uint8), np.zeros((1, 1), np.int64)
    seconds, nanoseconds, words, ticks, status = (np.zeros(1, kind) for kind in ("i4", "u4", "i8", "u8", "u2"))
    rows = places, 0, 0, places, seconds, nanoseconds, words
    return {
        "plant": [
            (go_on, *measured, 0, parts.applied, 0, work),
            (observe, *measured, 0, *reported, kept.machines[0], kept.devices[0], work),
            (derivatives, plant, state.x, state.reference, state.source, 0, state.x, work),
        ],
        "control": [
            (identify, *learner, arrived, 0),
            (act, parts.bank, parts.bank_state, 0, 0, arrived, 0, parts.issued, 0),
            (set_estimate, parts.bank_state, 0, np.zeros((1, 1)), np.zeros(1), 0),
            (store_setpoints, *learner, parts.issued, 0),
            (write_estimates, *learner, 0, kept.estimates, 0),
            (uplink, parts.links, 0, 0, 0, 0, *reported),
            (downlink, parts.links, 0, 0, 0, parts.issued, 0),
            (merge, parts.applied, 0, parts.links.down.out[0], 0),
            (pack, *rows, 0),
            (unpack, *rows, 0),
            (mark, arrived, 0, places, ticks, status),
            (take, data, status.view(np.uint8), places[0], status.view(np.uint8)),
        ],
    }


def compile_part(part: str) -> None:
    """Compile the kernels of a part, or find them in the cache."""
    for kernel, *arguments in kernels()[part]:
        specialised(kernel, *arguments)


def _done() -> Path:
    """The file whose presence means that this version's kernels are compiled."""
    return home() / f"compiled-{fingerprint(tick.__name__)}-{fingerprint(pack.__module__)}"


def compile_once() -> None:
    """Have all kernels compiled, if that has not been done on this machine; who comes meanwhile waits for it."""
    if _done().exists():
        return
    home().mkdir(parents=True, exist_ok=True)
    with (home() / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not _done().exists():
            sys.stderr.write("compiling the numerical kernels, once on this machine: one to three minutes\n")
            subprocess.run([sys.executable, "-m", __name__], check=True)


def main() -> None:
    """Compile both parts, then the loop that calls them."""
    with multiprocessing.get_context("spawn").Pool(len(PARTS)) as pool:
        pool.map(compile_part, PARTS)
    loop.run(load_case(None, ["duration=0.1", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]))
    _done().touch()


if __name__ == "__main__":
    main()
