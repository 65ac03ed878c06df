"""What the process of a controller may read: the files beside its own, packages there, and libraries.

Files are listed when a controller is first scored, and again when its file has changed: what is written later, such as
cards and recordings, is not among them. Nothing below the package's `config` is.
"""

from __future__ import annotations

import ast
import os
import sys
import sysconfig
from functools import cache, lru_cache
from importlib.machinery import PathFinder
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from facts_damping import errors
from facts_damping.errors import InputError
from facts_damping.extensions import given
from facts_damping.input_files import is_file, read_bytes, share_folder
from facts_damping.parameters.run import Fmu

if TYPE_CHECKING:
    from collections.abc import Iterable

    from facts_damping.parameters.run import Controller

MOST_FILES = 1000  # beside that of a class
SYSTEM = (
    "/lib",
    "/lib64",
    "/usr/lib",
    "/usr/lib64",
    "/usr/local/lib",
    "/usr/share/zoneinfo",
    "/sys/devices/system/cpu",
)
SYSTEM_FILES = ("/etc/ld.so.cache", "/etc/localtime", "/dev/null", "/dev/zero", "/dev/urandom", "/dev/random")
LIBRARIES = ("site-packages", "dist-packages")
# What the template may load for classes: libraries that are known, as their code runs there unconfined.
LOADED = (
    *("casadi", "control", "cvxpy", "facts_damping", "jax", "numba", "numpy", "onnxruntime", "osqp", "pandas"),
    *("scipy", "sklearn", "slycot", "sympy", "torch"),
)


class Readable(NamedTuple):
    """Paths without links: what may be read."""

    libraries: tuple[str, ...]  # folders with all below them
    folders: tuple[str, ...]  # the controller's, with all below them
    files: tuple[str, ...]
    listed: tuple[str, ...]  # folders of which the names may be read


def code_roots() -> tuple[str, str]:
    """Folders in which the packages of the core, and of its extensions, lie."""
    return str(Path(errors.__file__).parents[1]), str(Path(__file__).parents[3])


@cache
def libraries() -> tuple[str, ...]:
    """Folders of Python, of libraries and of this package's code."""
    names = ("stdlib", "platstdlib", "purelib", "platlib")
    folders = [sysconfig.get_path(name) for name in names]
    folders += [entry for entry in sys.path if Path(entry).name in LIBRARIES]
    folders += [str(Path(prefix) / "lib") for prefix in (sys.prefix, sys.base_prefix)]
    folders += os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    core, wings = (Path(root) for root in code_roots())
    packages = [core / "facts_damping", *(wing for wing in wings.glob("facts_damping_*") if wing.is_dir())]
    folders += [*map(str, packages), *SYSTEM]
    config = (share_folder() / "config").resolve()
    whole = dict.fromkeys(Path(folder).resolve() for folder in folders if folder and Path(folder).is_dir())
    return tuple(str(folder) for folder in whole if folder not in (config, *config.parents))


def file_of_fmu(controller: Controller) -> Path:
    """File of a controller that is an FMU."""
    fmu = controller.fmu
    return Path(fmu.file if isinstance(fmu, Fmu) else str(fmu))


def readable_of(controller: Controller) -> Readable:
    """What the process of a class or an FMU may read. Raises `InputError` for a folder with too many files."""
    fmu = None if controller.fmu is None else str(file_of_fmu(controller))
    file = Path(fmu if fmu is not None else str(controller.policy).rpartition(":")[0])
    written = file.stat().st_mtime_ns if file.suffix in (".py", ".fmu") and is_file(file) else 0
    return _readable(str(controller.policy), fmu, str(Path.cwd()), written)


@lru_cache(maxsize=64)
def _readable(policy: str, fmu: str | None, _folder: str, _written: int) -> Readable:
    """The same for a class, or the file of an FMU: again for another current folder, or when its file has changed."""
    own_files, own_folders = _of_class(policy) if fmu is None else _beside(Path(fmu).resolve().parent)
    system = (path for path in SYSTEM_FILES if Path(path).exists())
    whole = {str(folder.resolve()): None for folder in own_folders if not _is_config(folder)}
    beside = {str(path.resolve().parent): None for path in (*own_files, *own_folders)}
    files = {str(path.resolve()): None for path in own_files if not _is_config(path)}
    return Readable(libraries(), tuple(whole), (*system, *files), tuple(beside))


def _is_config(path: Path) -> bool:
    """Whether a path leads below the package's `config`, or holds it."""
    config, whole = (share_folder() / "config").resolve(), path.resolve()
    return config == whole or config in whole.parents or whole in config.parents


def _of_class(policy: str) -> tuple[list[Path], list[Path]]:
    entries = given("policies")
    place = (entries[policy].value if policy in entries else policy).rpartition(":")[0]
    if place.endswith(".py"):
        return _beside(Path(place).resolve().parent)
    spec = PathFinder.find_spec(place.partition(".")[0], [str(Path.cwd()), *sys.path])  # which runs nothing
    if spec is None:  # which the class's own process will meet
        return [], []
    if spec.submodule_search_locations is not None:
        return [], [Path(folder) for folder in spec.submodule_search_locations]
    return _beside(Path(str(spec.origin)).resolve().parent)


def _beside(folder: Path) -> tuple[list[Path], list[Path]]:
    """Files in a folder, and packages there with their compiled code."""
    files, folders = [], []
    entries = sorted(folder.iterdir()) if folder.is_dir() else []
    for entry in entries:
        if entry.is_file():
            files.append(entry)
        elif entry.name == "__pycache__" or (entry / "__init__.py").is_file():
            folders.append(entry)
    if len(files) > MOST_FILES:
        raise InputError(f"{folder}: {len(files)} files beside a class given; allowed: at most {MOST_FILES}")
    return files, folders


def imported(policy: str | None) -> list[str]:
    """Modules of the libraries in `LOADED` that the file of a class imports, by its text, which is not run."""
    path = Path((policy or "").rpartition(":")[0])
    if path.suffix != ".py" or not is_file(path):
        return []
    try:
        tree = ast.parse(read_bytes(path))
    except (SyntaxError, ValueError):  # which the class's own process will meet
        return []
    names = [name.split(".") for name in _names(ast.walk(tree))]
    return [".".join(parts) for parts in names if parts[0] in LOADED and not any(part[:1] == "_" for part in parts)]


def _names(nodes: Iterable[ast.AST]) -> list[str]:
    names: dict[str, None] = {}
    for node in nodes:
        if isinstance(node, ast.Import):
            names |= dict.fromkeys(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names |= dict.fromkeys([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
    return list(names)


def within(path: str, folders: Iterable[str]) -> bool:
    """Whether a path without links is one of the folders, or below one."""
    return any(path == folder or path.startswith(f"{folder}/") for folder in folders)
