"""Compiles all kernels that nodes call, so that no node waits later: `python -m facts_damping.nodes.base.warmup`.

With `--ship` the compiled kernels go into the package, for a wheel (`make wheel`).

The first node started on a machine without compiled kernels compiles them (`compile_once`).
"""

from __future__ import annotations

import importlib
import sys

from facts_damping.compiling.functions import ENTRY_POINTS
from facts_damping.compiling.store import address, prepare, ship
from facts_damping.errors import FactsDampingError, InputError, one_line, traced
from facts_damping.escaping import escaped
from facts_damping.extensions import given

ROOMS = ("facts_damping.simulation.loop", "facts_damping.nodes.transport.packing")  # modules that import all kernels


def compile_once() -> None:
    """Compile all kernels, if this machine has not done so; processes that start meanwhile wait for it."""
    for room in ROOMS:
        importlib.import_module(room)
    prepare(ENTRY_POINTS.values())


def compile_or_exit(program: str) -> None:
    """Do the same; if that cannot be done, end with a line that begins with the program's name."""
    try:
        compile_once()
    except FactsDampingError as error:
        sys.stderr.write(escaped(traced(error)) + f"{program}: {one_line(error)}\n")
        sys.exit(2 if isinstance(error, InputError) else 1)


def load() -> None:
    """Load all kernels into this process."""
    compile_once()
    for entry in ENTRY_POINTS.values():
        address(entry)


if __name__ == "__main__":
    if sys.argv[1:] == ["--ship"]:
        for module in (*ROOMS, *(row.value for row in given("kernels").values())):
            importlib.import_module(module)
        ship(ENTRY_POINTS.values())
    else:
        compile_or_exit("kernels")
