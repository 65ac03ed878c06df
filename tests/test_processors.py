"""What a run starts from, and digests of whole runs, have the same bits on every processor.

The C library, NumPy and OpenBLAS take other code with AVX2, FMA or AVX-512 than without, and it rounds differently.
OpenBLAS sums in another order in several threads. Here each of them is told of another processor, in a process of its
own. Kernels are compiled for the least processor of a kind on all.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.simulation.loop import build_loop
from tests.data import digests as table

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
FLAGS = Path("/proc/cpuinfo").read_text(encoding="utf-8").split()
# Kernels of OpenBLAS: the flag of a processor that can run them, and what OpenBLAS then says that it runs; and what
# others are told meanwhile.
PROCESSORS: dict[str, tuple[str, str, dict[str, str]]] = {
    "Prescott": (
        *("pni", "Katmai"),
        {"GLIBC_TUNABLES": f"glibc.cpu.hwcaps={LACKING}", "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4"},
    ),
    "Haswell": (
        *("avx2", "Haswell"),
        {"NPY_DISABLE_CPU_FEATURES": "X86_V4"},
    ),
    "SkylakeX": ("avx512bw", "SkylakeX", {"OPENBLAS_NUM_THREADS": "4"}),
}


def arrays(part: Any, name: str) -> Iterator[tuple[str, bytes]]:
    """Everything that a loop consists of, by its place."""
    if isinstance(part, np.ndarray):
        yield name, part.tobytes()
    elif isinstance(part, tuple):
        names = getattr(part, "_fields", range(len(part)))
        for field, value in zip(names, part, strict=True):
            yield from arrays(value, f"{name}.{field}")
    elif isinstance(part, (bool, int, float, complex)):
        yield name, np.asarray(part).tobytes()


def starts() -> dict[str, str]:
    """The hash of each array that compiled ticks are given, by its case and place."""
    hashes = {}
    for case, (run, sets) in CASES.items():
        path = None if run is None else str(RUNS / f"{run}.yaml")
        loop = build_loop(load_case(path, [*sets, "duration=5"]))
        for place, content in arrays(loop._replace(programs=[]), case):
            hashes[place] = hashlib.sha256(content).hexdigest()[:16]
    return hashes


def main() -> None:
    """Print the table of digests, made anew, and what runs start from."""
    sys.argv[1:] = ["--print"]
    table.main()
    print(json.dumps(starts()))


@pytest.fixture(scope="module")
def here() -> dict[str, str]:
    return starts()


@pytest.mark.parametrize("name", PROCESSORS)
def test_bits_are_those_of_other_processors(name: str, here: dict[str, str]) -> None:
    flag, kernels, environment = PROCESSORS[name]
    chosen = ("OPENBLAS", "GLIBC_TUNABLES", "NPY_")
    plain = {
        name_of_variable: value
        for name_of_variable, value in os.environ.items()
        if not name_of_variable.startswith(chosen)
    }
    kind = {"OPENBLAS_CORETYPE": name} if flag in FLAGS else {}
    completed = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", "tests.test_processors"],
        env={**plain, **kind, **environment},
        cwd=table.ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    first, *digests, last = completed.stdout.splitlines()
    assert not kind or first.endswith(f": {kernels}")
    assert digests == [f"{row['digest']} {row['name']}" for row in table.rows()]
    there = json.loads(last)
    assert {place for place in here if here[place] != there[place]} == set()
    assert here.keys() == there.keys()


if __name__ == "__main__":
    main()
