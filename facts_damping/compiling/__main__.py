"""Compile entry points given by name: the processes started by `store.prepare`."""

from __future__ import annotations

import gc
import importlib
import sys

from facts_damping.compiling.kernels import ENTRY_POINTS
from facts_damping.compiling.store import compile_missing

gc.disable()  # short-lived process: garbage collection would take a quarter of its time
for symbol in sys.argv[1:]:
    importlib.import_module(symbol.rpartition(".")[0])
compile_missing([ENTRY_POINTS[symbol] for symbol in sys.argv[1:]])
