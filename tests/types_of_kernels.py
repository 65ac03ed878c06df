"""A process that tells of each part of kernels for how many combinations of types it is compiled.

Types are inferred as a compiler process infers them, and nothing is made of them, which takes a third of the time.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

from facts_damping.compiling import with_numba
from facts_damping.compiling.kernels import ENTRY_POINTS

compiler: Any = importlib.import_module("numba.core.compiler")  # Numba's types say little of its insides
dispatcher: Any = importlib.import_module("numba.core.dispatcher")
passes: Any = importlib.import_module("numba.core.typed_passes")
typing: Any = importlib.import_module("numba.core.typing")
target: Any = importlib.import_module("numba.core.registry").cpu_target


def _nothing(*_: Any) -> bool:
    return True


def _typed(_pass: Any, state: Any) -> bool:
    """All that callers ask of a function: its types."""
    signature = typing.signature(state.return_type, *state.args)
    state.cr = compiler.compile_result(signature=signature, objectmode=False)
    return True


def main() -> None:
    """Print each part, of all that some modules import, and for how many combinations it is compiled."""
    for name in sys.argv[1:]:
        importlib.import_module(name)
    for one in (passes.PreLowerStripPhis, passes.IRLegalization, passes.NativeLowering):
        one.run_pass = _nothing
    passes.NoPythonBackend.run_pass = _typed
    dispatcher._DispatcherBase.add_overload = with_numba._add_overload
    for entry in ENTRY_POINTS.values():
        own, flags = with_numba._signature_of(entry), compiler.Flags()
        contexts = target.typing_context, target.target_context
        types = own.args, own.return_type
        compiler.compile_extra(*contexts, entry.py_func, *types, flags, {}, pipeline_class=with_numba._Passes)
    for part in with_numba._dispatchers:
        print(f"{part.py_func.__module__}.{part.py_func.__qualname__}", len(part.overloads))


if __name__ == "__main__":
    main()
