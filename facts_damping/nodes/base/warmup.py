"""Has every kernel compiled that nodes call, so that nothing waits later: `python -m facts_damping.nodes.base.warmup`.

With `--ship` they go into the package, for a wheel (`make wheel`).

A node that is started on a machine where that has not been done has it done (`compile_once`).
"""

from __future__ import annotations

import importlib
import sys

from facts_damping.compiling.kernels import ENTRY_POINTS
from facts_damping.compiling.store import address, prepare, ship

ROOMS = ("facts_damping.simulation.loop", "facts_damping.nodes.transport.packing")  # they import all others


def compile_once() -> None:
    """Have all kernels compiled, if that has not been done on this machine; who comes meanwhile waits for it."""
    for room in ROOMS:
        importlib.import_module(room)
    prepare(ENTRY_POINTS.values())


def load() -> None:
    """Load all kernels into this process."""
    compile_once()
    for entry in ENTRY_POINTS.values():
        address(entry)


if __name__ == "__main__":
    if sys.argv[1:] == ["--ship"]:
        for module in (*ROOMS, "facts_damping.environment.many"):
            importlib.import_module(module)
        ship(ENTRY_POINTS.values())
    else:
        compile_once()
