"""Compile entry points given by name: the processes started by `store.prepare`."""

from __future__ import annotations

import gc
import importlib
import sys
import traceback

from facts_damping.compiling.functions import ENTRY_POINTS
from facts_damping.compiling.store import BAD_INPUT, compile_missing
from facts_damping.errors import FactsDampingError, InputError

gc.disable()  # short-lived process: garbage collection would take a quarter of its time
try:
    from facts_damping.compiling.with_numba import object_code

    for symbol in sys.argv[1:]:
        importlib.import_module(symbol.rpartition(".")[0])
    compile_missing([ENTRY_POINTS[symbol] for symbol in sys.argv[1:]], object_code)
except FactsDampingError as error:
    traceback.print_exception(error.__cause__)
    sys.stderr.write(f"{error}\n")
    sys.exit(BAD_INPUT if isinstance(error, InputError) else 1)
