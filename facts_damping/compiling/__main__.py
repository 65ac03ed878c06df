"""Compiles entry points, given by their names: what `store.prepare` starts as processes of its own."""

from __future__ import annotations

import gc
import importlib
import sys

from facts_damping.compiling.kernels import ENTRY_POINTS
from facts_damping.compiling.store import compile_missing

gc.disable()  # a process that ends soon: a quarter of its time would go into looking for garbage
for symbol in sys.argv[1:]:
    importlib.import_module(symbol.rpartition(".")[0])
compile_missing([ENTRY_POINTS[symbol] for symbol in sys.argv[1:]])
