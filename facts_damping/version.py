"""The version of the package, which setup.py reads here, and those of the software that it computes with."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version

__version__ = "0.2.0"

NUMERICAL = ("numpy", "scipy", "numba", "llvmlite")  # llvmlite contains LLVM


@cache
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not a pip package"


def versions(*more: str) -> dict[str, str]:
    """Versions of a run's software: this package, Python, the kind of processor, `NUMERICAL` and `more` packages."""
    known = {"facts_damping": __version__, "python": platform.python_version(), "processor": platform.machine()}
    return known | {package: _version(package) for package in (*NUMERICAL, *more)}
