"""Files of compiled entry points: search, compilation of missing ones in processes, loading.

A file name has the function and its key, so a file is never stale; its last bytes are a checksum, so a damaged one is
compiled again. Files of a wheel are in the package, all others in the user's cache, which nobody else may write. A new
file of a function replaces old ones.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import shutil
import stat
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from llvmlite import binding

from facts_damping.compiling.functions import ENTRY_POINTS
from facts_damping.compiling.keys import PACKAGE, callees, key, target
from facts_damping.errors import FactsDampingError, InputError, RunError, one_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from facts_damping.compiling.functions import EntryFunction

SHIPPED = Path(__file__).parent / "objects"
MOST_FILES = 4  # of a function
BAD_INPUT = 2  # exit status of a process that compiles
CHECKSUM = hashlib.sha256().digest_size  # bytes at the end of a file
_engines: list[Any] = []
_addresses: dict[str, int] = {}
_code: dict[str, bytes] = {}  # object code that is read and not yet loaded, by file name


def home() -> Path:
    """The cache folder: NUMBA_CACHE_DIR if set, or a folder in the user's cache."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(folder) if folder else Path(base) / "facts_damping" / "kernels"


def file_name(entry: EntryFunction) -> str:
    """Name of an entry point's file."""
    return f"{entry.symbol}-{key(entry)}.o"


def _is_trusted(about: os.stat_result) -> bool:
    """Whether nobody but this user, and the administrator, can have written a file or folder."""
    return about.st_uid in (0, os.geteuid()) and not about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


@cache
def _check_trusted(folder: Path) -> None:
    """Raise `InputError` for a cache folder in which others could put code that this process would run."""
    with _writing(), contextlib.suppress(FileNotFoundError):
        about = folder.stat()
        if not _is_trusted(about):
            whose = "that others can write" if about.st_uid in (0, os.geteuid()) else f"of user {about.st_uid}"
            raise InputError(
                f"{folder}: a cache of compiled functions {whose} given; allowed: a folder of your own that only you "
                "can write (chmod go-w, or NUMBA_CACHE_DIR=FOLDER)"
            )


@contextlib.contextmanager
def _writing() -> Iterator[None]:
    """Raise `InputError` if the cache folder cannot be used within the block."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{home()}: cannot be written: {error.strerror}; allowed: a folder with room for compiled functions "
            "(NUMBA_CACHE_DIR=FOLDER)"
        ) from error


def _no_link(path: str, flags: int) -> int:
    """Open a file, but none that a link points at."""
    return os.open(path, flags | os.O_NOFOLLOW, 0o644)


def _read(path: Path) -> bytes | None:
    """Object code in a file, if it is whole and, in the cache, written by this user."""
    with contextlib.suppress(OSError), open(path, "rb", opener=_no_link) as file:
        content = file.read()
        code = content[:-CHECKSUM]
        trusted = path.parent == SHIPPED or _is_trusted(os.fstat(file.fileno()))
        if trusted and hashlib.sha256(code).digest() == content[-CHECKSUM:]:
            return code
    return None


def _is_there(entry: EntryFunction) -> bool:
    """Whether an entry point is compiled; then its code is read."""
    name = file_name(entry)
    if entry.symbol in _addresses or name in _code:
        return True
    code = _read(SHIPPED / name)
    if code is None:
        _check_trusted(home())
        code = _read(home() / name)
    if code is not None:
        _code[name] = code
    return code is not None


def _with_callees(entries: Iterable[EntryFunction]) -> dict[str, EntryFunction]:
    """Entry points and all that they call, directly or indirectly."""
    by_symbol: dict[str, EntryFunction] = {}
    todo = list(entries)
    while todo:
        entry = todo.pop()
        if entry.symbol not in by_symbol:
            by_symbol[entry.symbol] = entry
            todo += callees(entry)
    return by_symbol


def prepare(entries: Iterable[EntryFunction]) -> None:
    """Compile missing entry points and all that they call, with as many processes as processors.

    Raises `InputError` if the cache folder cannot be used, `RunError` if a function cannot be compiled.
    """
    wanted = _with_callees(entries)
    if all(map(_is_there, wanted.values())):
        return
    shipped = {name: entry for name, entry in ENTRY_POINTS.items() if name.startswith(f"{PACKAGE}.")}
    missing = [entry for entry in (wanted | shipped).values() if not _is_there(entry)]  # likely needed soon
    with _writing():
        home().mkdir(mode=0o755, parents=True, exist_ok=True)
    symbols = sorted(entry.symbol for entry in missing)
    sys.stderr.write(f"compiling {len(missing)} numerical kernels, once on this machine: seconds\n")
    command = [sys.executable, "-m", "facts_damping.compiling", *symbols]
    many = min(os.cpu_count() or 1, len(missing))
    paths = os.pathsep.join(path or str(Path.cwd()) for path in sys.path)
    surroundings = {**os.environ, "PYTHONPATH": paths, "NUMBA_CPU_NAME": target()}
    surroundings |= {"NUMBA_CPU_FEATURES": "", "NUMBA_OPT": "3", "OPENBLAS_NUM_THREADS": "1"}
    surroundings |= {"NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING": "1"}
    processes = [subprocess.Popen(command, env=surroundings, stderr=subprocess.PIPE) for _ in range(many)]
    outputs = [process.communicate()[1].decode(errors="replace").strip() for process in processes]
    left = [entry.symbol for entry in missing if not _is_there(entry)]  # nothing, if another process did it
    for process, output in zip(processes, outputs, strict=True) if left else ():
        if process.returncode:
            raise _failure(output, bad_input=process.returncode == BAD_INPUT)
    if left:
        raise RunError(f"{', '.join(left[:3])}: changed while it was compiled; allowed: files that stay as they are")


def _failure(output: str, *, bad_input: bool) -> FactsDampingError:
    """The error of a process that compiles, from its output, whose last line says what is wrong."""
    reason = one_line(output.rpartition("\n")[2] or "the compiler of numerical kernels has ended without a word")
    error = InputError(reason) if bad_input else RunError(reason)
    error.details = output
    return error


@contextlib.contextmanager
def _claimed(entry: EntryFunction, *, wait: bool) -> Iterator[bool]:
    """Lock an entry point; yield whether this process should compile it. Without `wait`, a held lock yields False."""
    with _writing():
        lock = _no_link(str(home() / f"{entry.symbol}.lock"), os.O_CREAT | os.O_WRONLY)
    with os.fdopen(lock, "w"):
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            yield False
            return
        yield not _is_there(entry)


def compile_missing(entries: Iterable[EntryFunction], object_code: Callable[[EntryFunction], bytes]) -> None:
    """Compile in this process by `object_code` what no other process is compiling, then wait for the others."""
    for wait in (False, True):
        for entry in entries:
            if _is_there(entry):
                continue
            with _claimed(entry, wait=wait) as missing:
                if missing:
                    try:
                        code = object_code(entry)
                    except Exception as error:  # Numba has many kinds
                        raise RunError(f"{entry.symbol}: cannot be compiled: {one_line(error)}") from error
                    _write(entry, code)


def _write(entry: EntryFunction, code: bytes) -> None:
    """Write an entry point's file whole or not at all. Raises `InputError`."""
    path = home() / file_name(entry)
    beside = path.with_suffix(f".{os.getpid()}")
    try:
        with _writing():
            beside.unlink(missing_ok=True)
            with open(beside, "xb", opener=_no_link) as file:
                file.write(code + hashlib.sha256(code).digest())
            beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
    for old in sorted(home().glob(f"{entry.symbol}-*.o"), key=lambda file: file.stat().st_mtime)[:-MOST_FILES]:
        old.unlink(missing_ok=True)


def ship(entries: Iterable[EntryFunction]) -> None:
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


def address(entry: EntryFunction) -> int:
    """The address of a compiled entry point; its callees are loaded first."""
    if entry.symbol not in _addresses:
        prepare([entry])
        for callee in callees(entry):
            address(callee)
        if not _engines:
            _engines.append(_new_engine())
        _engines[0].add_object_file(binding.ObjectFileRef.from_data(_code.pop(file_name(entry))))
        _engines[0].finalize_object()
        _addresses[entry.symbol] = _engines[0].get_function_address(entry.symbol)
        binding.add_symbol(entry.symbol, _addresses[entry.symbol])
    return _addresses[entry.symbol]
