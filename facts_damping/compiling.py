"""How the numerical kernels are compiled: one decorator, and an on-disk cache that cannot be stale.

Numba's own cache looks at the file of a function alone: it does not notice a change in a compiled function that
another file's compiled function calls. Here what is compiled from a file lies in a folder named after a hash of that
file and of all files of the kernels' rooms that it imports, directly or not. A change costs the compilation of what
depends on it and of no more. No fast-math: the same function gives the same bits wherever it is called from, in a node
or inside the compiled loop.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import sys
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba
from numba.core import types
from numba.core.caching import CompileResultCacheImpl

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

PACKAGE = "facts_damping"
ROOT = Path(__file__).parent
# Where compiled functions are, and what they are given: rooms, and single files.
ROOMS = (
    "compiling",
    "control",
    "elementary",
    "environment.many",
    "environment.pinning",
    "environment.watching",
    "link",
    "measurement",
    "monitors",
    "matrices",
    "neurofuzzy",
    "nodes.packing",
    "phasors",
    "plant",
    "random_numbers",
    "signals",
    "simulation.measured_plant",
    "simulation.tick",
    "supervision",
    "ziggurat",
)
KEPT = 4  # folders of one file: those of other versions of it
_IMPORT = re.compile(rf"^[ ]*from ({PACKAGE}[\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)


def _source(module: str) -> Path | None:
    """The source of a module of the kernels' rooms; None for any other name."""
    if not any(f"{module}.".startswith(f"{PACKAGE}.{room}.") for room in ROOMS):
        return None
    path = ROOT.joinpath(*module.split(".")[1:])
    return next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()), None)


@cache
def _imported(module: str) -> frozenset[str]:
    """Modules of the kernels' rooms that a module imports, also those that only its types need."""
    path, found = _source(module), set()
    for source, names in _IMPORT.findall("" if path is None else path.read_text(encoding="utf-8")):
        found |= {source, *(f"{source}.{name}" for name in re.findall(r"\w+", names))}
    return frozenset(name for name in found if _source(name))


def sources(module: str) -> list[str]:
    """All modules on which what is compiled from a module can depend, itself included, sorted."""
    found, todo = set(), {f"{PACKAGE}.compiling", module}
    while todo:
        found |= todo
        todo = {name for one in todo for name in _imported(one)} - found
    return sorted(found)


@cache
def fingerprint(module: str) -> str:
    """Hash of everything that what is compiled from a module can depend on."""
    digest = hashlib.sha256(f"{sys.version} {numba.__version__}".encode())
    for name in sources(module):
        path = _source(name)
        digest.update(name.encode() + (b"" if path is None else path.read_bytes()))
    return digest.hexdigest()[:16]


def home() -> Path:
    """The folder that holds all: NUMBA_CACHE_DIR where it is set, or one in the user's cache."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    return Path(given or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / PACKAGE / "numba")


@cache
def _folder(module: str) -> Path:
    """Where what is compiled from a module lies. Old ones of the same module go when a new one comes."""
    folder = home() / f"{module}-{fingerprint(module)}"
    if not folder.exists():
        folder.mkdir(parents=True, exist_ok=True)
        by_age = sorted(folder.parent.glob(f"{module}-*"), key=lambda f: f.stat().st_mtime, reverse=True)
        for old in by_age[KEPT:]:
            shutil.rmtree(old, ignore_errors=True)
    return folder


class _Locator:
    """Tells Numba where it keeps what it compiles of one function of this package."""

    def __init__(self, function: Any) -> None:
        self._line, self._path = function.__code__.co_firstlineno, _folder(function.__module__)

    @classmethod
    def from_function(cls, function: Any, _path: str) -> _Locator | None:
        """One for a function of the kernels' rooms; Numba looks further for others."""
        return cls(function) if _source(function.__module__) else None

    def ensure_cache_path(self) -> None:
        """Make the folder, which may have been removed."""
        self._path.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """The folder."""
        return str(self._path)

    def get_source_stamp(self) -> str:
        """What must not have changed: it is in the folder's name already."""
        return self._path.name

    def get_disambiguator(self) -> str:
        """What tells functions of one name apart: the line."""
        return str(self._line)


_locators: list[Any] = CompileResultCacheImpl._locator_classes  # noqa: SLF001 (not all versions have a setting for it)
_locators.insert(0, _Locator)


def _without_literals(compile_: Callable[[Any], Any], signature: Any) -> Any:
    """Compile a function for whole numbers, not once more for each that is written in a call: `f(x, 0)`."""
    plain: Any = types.unliteral
    return compile_(tuple(map(plain, signature)) if isinstance(signature, tuple) else signature)


def _compiled(function: Any, **options: Any) -> Any:
    """Have Numba compile a function at its first call.

    Kernels allocate nothing and keep no array, so Numba need not count references to the arrays that they are given:
    with a plant's some forty arrays the counting took more time than what the functions compute (`_nrt`).
    """
    made: Any = numba.njit(
        **{"cache": True, "error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True, **options}
    )(function)
    made.compile = partial(_without_literals, made.compile)
    return made


def _inner(function: Any) -> Any:
    """The same for compiled callers alone: what would take arguments from Python is most of a small one's compilation.

    Numba calls such a function from Python nevertheless, into nowhere; this one raises `TypeError`.
    """

    def refuse(*_arguments: Any) -> None:
        raise TypeError(f"{function.__module__}.{function.__name__}: for compiled callers alone")

    made = _compiled(function, no_cpython_wrapper=True)
    made._insert, made._compile_for_args = (lambda *_, **__: None), refuse  # noqa: SLF001 (Numba has no other place)
    return made


def branching(functions: Sequence[Callable[..., Any]]) -> Any:
    """A compiled function of a code and arguments, which calls the function at that place with them.

    So a table's rows bring their functions along, and no list of branches stands beside it. What calls it is cached as
    a whole; it must lie in a file that imports, directly or not, those of the functions. The last one is also that of
    codes beyond.
    """
    first, *others = functions
    if not others:

        def call(code: int, *arguments: Any) -> Any:  # noqa: ARG001 (it is called as the others are)
            return first(*arguments)

    else:
        after = branching(others)

        def call(code: int, *arguments: Any) -> Any:
            return first(*arguments) if code == 0 else after(code - 1, *arguments)

    return _compiled(call, cache=False)


def specialised(kernel: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
    """A kernel for arguments of the types of these, compiled or found in the cache.

    Numba looks at the types of all arguments at every call: of the hundred arrays of a controller's state for longer
    than the call takes. Here they are looked at once; what is called later must be of the same types, arrays of the
    same number of axes and order in memory.
    """
    made: Any = kernel
    found: Callable[..., Any] = made.compile(tuple(map(numba.typeof, arguments)))
    return found


if TYPE_CHECKING:  # what the functions take and return
    compiled = inner = inlined = released = numba.njit(cache=True, error_model="numpy")
else:
    compiled = _compiled
    inner = _inner
    released = partial(_compiled, nogil=True)  # others' Python goes on meanwhile
    # The optimiser writes the function into its callers: for a step's innermost loops, and for the parts of a tick,
    # which would be handed hundreds of arrays each time, a third of what a tick takes.
    inlined = partial(_compiled, forceinline=True)
