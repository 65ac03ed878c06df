"""The version of the package, which setup.py reads here, and those of what it computes with."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version

__version__ = "0.2.0"

NUMERICAL = ("numpy", "scipy", "numba", "llvmlite")  # llvmlite brings LLVM


@cache
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not a pip package"


def versions(*more: str) -> dict[str, str]:
    """What a run is made with: this package, Python, the processor's kind, and packages: `NUMERICAL`, `more`."""
    found = {"facts_damping": __version__, "python": platform.python_version(), "processor": platform.machine()}
    return found | {package: _version(package) for package in (*NUMERICAL, *more)}
