"""One program in a process of its own: `python -m facts_damping_bench.worker MODULE FOLDER PARENT`.

It takes a line of JSON a request on standard input, and answers each with a line on the standard output that it was
started with. What the program prints goes to standard error. It ends with its parent.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from facts_damping.errors import one_line
from facts_damping_bench import grid as grids
from facts_damping_bench.session import end_with_parent


def answer(program: Any, prepared: Any, request: dict[str, Any]) -> dict[str, Any]:
    """The figures of one run: s of set-up, of the run in time, of all with what it gives back, and the swings."""
    case = grids.grid(request["load"])
    began = time.perf_counter()
    timed_run = program.run(prepared, case, request["step"], **request["more"])
    took = time.perf_counter() - began
    swings = grids.swings(timed_run)
    return {"setup_s": timed_run.setup_s, "wall_s": timed_run.wall_s, "total_s": took, "swings": swings.tolist()}


def main() -> None:
    """Answer until nothing more is asked."""
    end_with_parent(int(sys.argv[3]))
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    try:
        began = time.perf_counter()
        program = importlib.import_module(sys.argv[1])
        prepared = program.prepare(grids.grid(), Path(sys.argv[2]))
        out.write(json.dumps({"prepared_s": time.perf_counter() - began}) + "\n")
        for line in sys.stdin:
            out.write(json.dumps(answer(program, prepared, json.loads(line))) + "\n")
    except Exception as error:  # noqa: BLE001 (whatever a program dies of is said in its row)
        traceback.print_exc()
        out.write(json.dumps({"error": f"{type(error).__name__}: {one_line(error)}"}) + "\n")


if __name__ == "__main__":
    main()
