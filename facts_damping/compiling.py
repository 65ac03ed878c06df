"""How the numerical kernels are compiled: one decorator, one on-disk cache that cannot be stale.

Numba's cache does not notice a change in a compiled function that another file's compiled function
calls. So the cache lies in a folder named after a hash of this package's sources: any change, a new
folder. Old folders are removed. No fast-math: the same function gives the same bits wherever it is
called from, in a node or inside the compiled loop.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING

KEPT_CACHES = 4
# Folders without compiled functions.
NOT_COMPILED = ("analysis", "nodes", "recording", "report", "reproduction", "studies", "validation", "views")


def _fingerprint(folder: Path) -> str:
    digest = hashlib.sha256(sys.version.encode())
    for file in sorted(f for f in folder.rglob("*.py") if f.relative_to(folder).parts[0] not in NOT_COMPILED):
        digest.update(str(file.relative_to(folder)).encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "facts_damping" / "numba"
    folder = home / _fingerprint(Path(__file__).parent)
    if not folder.exists():
        folder.mkdir(parents=True, exist_ok=True)
        by_age = sorted((f for f in home.iterdir() if f.is_dir()), key=lambda f: f.stat().st_mtime, reverse=True)
        for old in by_age[KEPT_CACHES:]:
            shutil.rmtree(old, ignore_errors=True)
    return folder


if "NUMBA_CACHE_DIR" not in os.environ:
    os.environ["NUMBA_CACHE_DIR"] = str(_cache_folder())

import numba  # noqa: E402 (the cache's folder has to be set before)

numba.config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"]  # type: ignore[attr-defined]

# Kernels allocate nothing and keep no array, so Numba need not count references to the arrays that they are given:
# with a plant's some forty arrays the counting took more time than what the functions compute (`_nrt`).
if TYPE_CHECKING:  # what Numba declares does not know `_nrt`
    compiled = inlined = numba.njit(cache=True, error_model="numpy")
else:
    compiled = numba.njit(cache=True, error_model="numpy", _nrt=False)
    # The same for a function that is called from one place within a step's innermost loops: written into its caller.
    inlined = numba.njit(cache=True, error_model="numpy", _nrt=False, inline="always")
