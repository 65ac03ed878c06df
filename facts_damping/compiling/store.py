"""Files of compiled entry points: search, compilation of missing ones in processes, loading.

A file name has the function and its key, so a file is never stale. Files of a wheel are in the package, all others in
the user's cache. A new file of a function replaces old ones.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from llvmlite import binding

from facts_damping.compiling.kernels import ENTRY_POINTS
from facts_damping.compiling.keys import PACKAGE, callees, key, target

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from facts_damping.compiling.kernels import EntryPoint

SHIPPED = Path(__file__).parent / "objects"
KEPT = 4  # files kept per function
_engines: list[Any] = []
_addresses: dict[str, int] = {}


def home() -> Path:
    """The cache folder: NUMBA_CACHE_DIR if set, or a folder in the user's cache."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(given) if given else Path(base) / "facts_damping" / "numba"


def file_name(entry: EntryPoint) -> str:
    """Name of an entry point's file."""
    return f"{entry.symbol}-{key(entry)}.o"


def _found(entry: EntryPoint) -> Path | None:
    """The file of an entry point, if it exists."""
    name = file_name(entry)
    return next((path for folder in (SHIPPED, home()) if (path := folder / name).is_file()), None)


def _with_callees(entries: Iterable[EntryPoint]) -> dict[str, EntryPoint]:
    """Entry points and all that they call, directly or indirectly."""
    found: dict[str, EntryPoint] = {}
    todo = list(entries)
    while todo:
        one = todo.pop()
        if one.symbol not in found:
            found[one.symbol] = one
            todo += callees(one)
    return found


def prepare(entries: Iterable[EntryPoint]) -> None:
    """Compile missing entry points and all that they call, with as many processes as processors."""
    wanted = _with_callees(entries)
    if all(_found(one) is not None for one in wanted.values()):
        return
    own = {name: one for name, one in ENTRY_POINTS.items() if name.startswith(f"{PACKAGE}.")}  # likely needed soon
    missing = [one for one in (wanted | own).values() if _found(one) is None]
    home().mkdir(parents=True, exist_ok=True)
    symbols = sorted(one.symbol for one in missing)
    sys.stderr.write(f"compiling {len(missing)} numerical kernels, once on this machine: seconds\n")
    command = [sys.executable, "-m", "facts_damping.compiling", *symbols]
    many = min(os.cpu_count() or 1, len(missing))
    paths = os.pathsep.join(path or str(Path.cwd()) for path in sys.path)
    surroundings = {**os.environ, "PYTHONPATH": paths, "NUMBA_CPU_NAME": target()}
    surroundings |= {"NUMBA_CPU_FEATURES": "", "NUMBA_OPT": "3", "OPENBLAS_NUM_THREADS": "1"}
    surroundings |= {"NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING": "1"}
    processes = [subprocess.Popen(command, env=surroundings) for _ in range(many)]
    if any([process.wait() for process in processes]) or any(_found(one) is None for one in missing):  # noqa: C419
        left = ", ".join(one.symbol for one in missing if _found(one) is None)
        raise RuntimeError(f"the compiler of the numerical kernels has failed: {left}")


@contextlib.contextmanager
def _claimed(entry: EntryPoint, *, wait: bool) -> Iterator[bool]:
    """Lock an entry point; yield whether this process should compile it. Without `wait`, a held lock yields False."""
    with (home() / f"{entry.symbol}.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            yield False
            return
        yield _found(entry) is None


def compile_missing(entries: Iterable[EntryPoint]) -> None:
    """Compile in this process what no other process is compiling, then wait for the others."""
    from facts_damping.compiling import with_numba  # noqa: PLC0415 (only who compiles needs it)

    for wait in (False, True):
        for entry in entries:
            if _found(entry) is not None:
                continue
            with _claimed(entry, wait=wait) as mine:
                if mine:
                    _keep(entry, with_numba.object_code(entry))


def _keep(entry: EntryPoint, code: bytes) -> None:
    """Write an entry point's file atomically."""
    path = home() / file_name(entry)
    made = path.with_suffix(f".{os.getpid()}")
    made.write_bytes(code)
    made.replace(path)
    for old in sorted(home().glob(f"{entry.symbol}-*.o"), key=lambda one: one.stat().st_mtime)[:-KEPT]:
        old.unlink(missing_ok=True)


def ship(entries: Iterable[EntryPoint]) -> None:
    """Write the files of entry points, and of all that they call, into the package for a wheel."""
    chosen = _with_callees(entries).values()
    prepare(chosen)
    shutil.rmtree(SHIPPED, ignore_errors=True)
    SHIPPED.mkdir()
    for entry in chosen:
        shutil.copy(home() / file_name(entry), SHIPPED)


def _new_engine() -> Any:
    """The linker of object code."""
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    kind = binding.Target.from_triple(binding.get_process_triple())
    machine = kind.create_target_machine(reloc="static", codemodel="jitdefault", jit=True)
    return binding.create_mcjit_compiler(binding.parse_assembly(""), machine)


def address(entry: EntryPoint) -> int:
    """The address of a compiled entry point; its callees are loaded first."""
    if entry.symbol not in _addresses:
        prepare([entry])
        for one in callees(entry):
            address(one)
        if not _engines:
            _engines.append(_new_engine())
        path = _found(entry)
        if path is None:
            raise RuntimeError(f"{entry.symbol}: its file is missing")
        _engines[0].add_object_file(binding.ObjectFileRef.from_path(str(path)))
        _engines[0].finalize_object()
        _addresses[entry.symbol] = _engines[0].get_function_address(entry.symbol)
        binding.add_symbol(entry.symbol, _addresses[entry.symbol])
    return _addresses[entry.symbol]
