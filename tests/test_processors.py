"""What a run starts from has the same bits on every processor, whatever libraries choose for it.

The C library, NumPy and OpenBLAS take other code with AVX2, FMA or AVX-512 than without, and it rounds differently.
Here each of them is told to leave out what the processor has, in a process of its own.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.simulation.loop import build_loop

if TYPE_CHECKING:
    from collections.abc import Iterator

RUNS = Path(__file__).parents[1] / "config" / "runs"
INDIRECT = ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]
BOTH = ["devices=[sssc, statcom]", "controllers.0.devices=[sssc, statcom]", "controllers.0.signals=[speed, power]"]
# A run, by its file or the defaults, and what is changed in it: every kind of grid, device, measurement, link,
# controller and noise.
CASES: dict[str, tuple[str | None, list[str]]] = {
    "small": ("two_area_small", []),
    "large": ("two_area_large", []),
    "deployment": ("two_area_deployment", []),
    "ambient": ("two_area_ambient", []),
    "supervised": ("two_area_supervised", []),
    "hvdc": ("two_area_hvdc", []),
    "multiple": ("two_area_multiple", []),
    "LQG": (None, ["controllers.0.name=LQG", *BOTH, "link=pdci"]),
    "LQG, M class": (None, ["controllers.0.name=LQG", "measurement=m_class", "controllers.0.signals=[angle]"]),
    "H infinity": (None, ["controllers.0.name=Hinf", *BOTH, "link=pdci"]),
    "a law of zeros and poles": (
        None,
        [
            "controllers.0.name=linear",
            "controllers.0.linear={zeros: ['-1+2j', '-1-2j', 0.1], poles: ['-3+4.1j', '-3-4.1j', -0.7], gain: 0.3}",
        ],
    ),
    "indirect": (None, [*INDIRECT, *BOTH]),
    "smib": ("smib_supervised", []),
    "smib, lead-lag": ("lead_lag_smib_pdci", []),
    "smib, indirect": (None, ["system=smib", "scenario=nominal", *INDIRECT]),
    "kundur_12_6": ("kundur_12_6_fault", []),
    "thyristor": ("kundur_12_6_fault", ["system=kundur_12_6_thyristor_pss", "scenario=[]"]),
    "wscc_9": ("wscc_9_fault", []),
    "nets_nyps": ("nets_nyps_two_devices", []),
    "new_england_39": ("new_england_39_fault", []),
    "links": (
        None,
        [
            (
                "link={up: [{model: gamma, delay: 0.02, shape: 2.5, scale: 0.01},"
                " {model: lognormal, delay: 0.01, median: 0.02, sigma: 0.5}, {model: uniform, low: 0.001, high: 0.003},"
                " {model: normal, mean: 0.02, std: 0.01, low: 0.01, high: 0.05}, {model: noise, std: 0.001},"
                " {model: flip, probability: 0.01}, {model: gilbert_elliott, p_GB: 0.1, p_BG: 0.3, loss_B: 0.5}],"
                " down: [{model: bernoulli, loss: 0.1}, {model: duplicate, probability: 0.1}]}"
            )
        ],
    ),
}
LACKING = "-AVX2,-FMA,-FMA4,-AVX512F,-AVX2_Usable,-FMA_Usable,-FMA4_Usable,-AVX512F_Usable"  # as glibc spells it
FLAGS = Path("/proc/cpuinfo").read_text(encoding="utf-8").split() if Path("/proc/cpuinfo").exists() else []
KINDS = {"Prescott": "pni", "Haswell": "avx2", "SkylakeX": "avx512bw", "Zen": "avx2"}
ENVIRONMENTS = [
    {"GLIBC_TUNABLES": f"glibc.cpu.hwcaps={LACKING}"},
    {"NPY_DISABLE_CPU_FEATURES": "X86_V4"},
    {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4"},
    *({"OPENBLAS_CORETYPE": kind} for kind, flag in KINDS.items() if flag in FLAGS),
]


def arrays(part: Any, name: str) -> Iterator[tuple[str, bytes]]:
    """Everything that a loop consists of, by its place."""
    if isinstance(part, np.ndarray):
        yield name, part.tobytes()
    elif isinstance(part, tuple):
        names = getattr(part, "_fields", range(len(part)))
        for field, own in zip(names, part, strict=True):
            yield from arrays(own, f"{name}.{field}")
    elif isinstance(part, (bool, int, float, complex)):
        yield name, np.asarray(part).tobytes()


@cache
def digests() -> dict[str, str]:
    """The hash of each array that compiled ticks are given, by its case and place."""
    found = {}
    for case, (run, sets) in CASES.items():
        path = None if run is None else str(RUNS / f"{run}.yaml")
        loop = build_loop(load_case(path, [*sets, "duration=5"]))
        for place, content in arrays(loop._replace(programs=[]), case):
            found[place] = hashlib.sha256(content).hexdigest()[:16]
    return found


def functions() -> str:
    """The hash of what the C library's and NumPy's functions, and BLAS, make of some numbers."""
    x = np.linspace(0.1, 3.0, 1001)
    z = x + 1j * x[::-1]
    libm = np.array([f(v) for f in (math.sin, math.exp, math.log, math.tanh) for v in x.tolist()])
    blas = np.outer(x, x[::3]).T @ np.outer(x[::-1], x)
    made = [libm, np.exp(x), z * z[::-1], np.abs(z), np.tanh(x), blas]
    return " ".join(hashlib.sha256(part.tobytes()).hexdigest()[:8] for part in made)


@cache
def plain() -> dict[str, str]:
    """The environment without what chooses for a processor."""
    chosen = ("OPENBLAS", "GLIBC_TUNABLES", "NPY_")
    return {name: value for name, value in os.environ.items() if not name.startswith(chosen)}


def elsewhere(what: str, environment: dict[str, str]) -> Any:
    """What a function of this module returns in a process with such an environment."""
    code = f"import json, tests.test_processors as t; print(json.dumps(t.{what}()))"
    made = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        env={**plain(), **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(made.stdout.splitlines()[-1])


@pytest.mark.parametrize("environment", ENVIRONMENTS, ids=str)
def test_what_a_run_starts_from_has_the_same_bits(environment: dict[str, str]) -> None:
    here, there = digests(), elsewhere("digests", environment)
    assert {place for place in here if here[place] != there[place]} == set()
    assert here.keys() == there.keys()
