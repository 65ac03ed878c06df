"""Reads MATLAB files in a separate process, because damaged files can crash SciPy's reader."""

from __future__ import annotations

import resource
import subprocess
import sys
from io import BytesIO

import numpy as np

MEMORY = 2_000_000_000  # bytes that the reader may use
PATIENCE_S = 60.0  # s of wall time that the reader may take


def as_npz(content: bytes) -> bytes:
    """Arrays of a MAT file as an NPZ file; whatever is not a numeric array becomes text. Raises ValueError."""
    command = [sys.executable, __file__]
    done = subprocess.run(command, input=content, capture_output=True, check=False, timeout=PATIENCE_S)
    if done.returncode:
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        raise ValueError(lines[-1] if lines else f"its reader was ended by signal {-done.returncode}")
    return done.stdout


def _convert() -> None:
    from scipy.io import loadmat  # noqa: PLC0415 (here alone: loading it takes longer than a run)

    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    content = loadmat(BytesIO(sys.stdin.buffer.read()))
    numbers = {name: array for name, array in content.items() if not name.startswith("__")}
    archive = BytesIO()
    arrays = {name: array if array.dtype.kind in "fiuc" else np.array("no numbers") for name, array in numbers.items()}
    np.savez(archive, allow_pickle=False, **arrays)
    sys.stdout.buffer.write(archive.getvalue())


if __name__ == "__main__":
    _convert()
