"""A run has the same bits whichever kernels OpenBLAS takes, and however many threads: the processor chooses both."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg  # noqa: F401 (with it, its BLAS)
from threadpoolctl import threadpool_info

from facts_damping.case.loading import load_case
from facts_damping.simulation import loop

RUNS = Path(__file__).parents[1] / "config" / "runs"
BOTH = ["devices=[sssc, statcom]", "controllers.0.devices=[sssc, statcom]", "controllers.0.signals=[speed, power]"]
INDIRECT = ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]
# What a run is computed from: the power flow, reduced networks, machines at rest, saturation; modes, residues and
# responses of the linearised plant; the optimal controller's matrices; what an identifier starts from.
CASES = {
    "two areas": (None, []),
    "two areas, LQG": (None, ["controllers.0.name=LQG", *BOTH, "link=pdci"]),
    "two areas, direct": (None, ["controllers.0.name=ANFTrMeC", "controllers.0.scheme=direct"]),
    "two areas, indirect": (None, [*INDIRECT, *BOTH]),
    "smib, LQG": (None, ["system=smib", "scenario=nominal", "controllers.0.name=LQG"]),
    "smib, indirect": (None, ["system=smib", "scenario=nominal", *INDIRECT]),
    "kundur_12_6": (f"{RUNS}/kundur_12_6_fault.yaml", []),
    "new_england_39": (f"{RUNS}/new_england_39_fault.yaml", []),
}
# Kinds of kernels: the flag of a processor that can run them, and what OpenBLAS then says that it runs.
KINDS = {"Prescott": ("pni", "Katmai"), "Haswell": ("avx2", "Haswell"), "SkylakeX": ("avx512bw", "SkylakeX")}
FLAGS = Path("/proc/cpuinfo").read_text(encoding="utf-8").split()
ENVIRONMENTS = [
    {},
    *({"OPENBLAS_CORETYPE": kind} for kind, (flag, _) in KINDS.items() if flag in FLAGS),
    {"OPENBLAS_NUM_THREADS": "4"},
]


@cache
def digests() -> str:
    """A line for each case, the hash of everything that is recorded of a second."""
    lines = []
    for name, (path, overrides) in CASES.items():
        record = vars(loop.run(load_case(path, [*overrides, "duration=1"])))
        parts = [part.tobytes() for _, part in sorted(record.items()) if isinstance(part, np.ndarray)]
        lines.append(f"{name}: {hashlib.sha256(b''.join(parts)).hexdigest()}")
    return "\n".join(lines)


def kernels() -> str:
    """What kernels of OpenBLAS are in use."""
    return ", ".join(sorted({one["architecture"] for one in threadpool_info() if one["internal_api"] == "openblas"}))


@pytest.mark.parametrize("environment", ENVIRONMENTS, ids=str)
def test_a_run_has_the_same_bits(environment: dict[str, str]) -> None:
    code = "import tests.test_bits as t; print(t.kernels()); print(t.digests())"
    clean = {name: value for name, value in os.environ.items() if not name.startswith("OPENBLAS")}
    made = subprocess.run(
        [sys.executable, "-c", code], env={**clean, **environment}, capture_output=True, text=True, check=True
    )
    used, *lines = made.stdout.splitlines()
    assert used == KINDS.get(environment.get("OPENBLAS_CORETYPE", ""), ("", used))[1]
    assert lines == digests().splitlines()
