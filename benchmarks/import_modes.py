"""Modes of imported PSS/E cases beside those of ANDES, which reads the same files.

    python -m venv andes && andes/bin/pip install andes==2.0.0
    python benchmarks/import_modes.py andes/bin/python FOLDER... [--pool]

Pairs of RAW and DYR files as in `imports.py`, as far as nothing of the DYR file is replaced or left out. ANDES does not
divide a turbine's power by the speed, so that is left out here, too; it takes GENCLS with H = 0 as it stands, so it has
1e7 s; and its machines hold the voltages that they have here. Of the modes from 0.1 to 3 Hz: the greatest distance of
one of ANDES from the nearest one here, 1/s. Of the start: the greatest distance of voltages, p.u. Then the models that
ANDES lacks, and those that it has otherwise than PSS/E, as far as that is known. Of ESAC1A, ESST1A, EXAC1, ESDC2A,
HYGOV, ESST3A, ESST4B and IEEEST with filters its equations were put here, and modes then agreed within 1e-4 1/s (ESDC2A
1.3e-4, ESST3A and ESST4B 5e-3); of the others it follows from its source or its warnings alone. A start on a limit,
too, is understood otherwise by each program.
"""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from imports import pairs_of

from facts_damping.errors import InputError
from facts_damping.output.tables import table
from facts_damping.parameters.plant.system import System
from facts_damping.plant.build import build
from facts_damping.small_signal.linearisation import linearise
from facts_damping_grids.psse.conversion import import_case
from facts_damping_grids.psse.reading import read_dyr

FROM, TO = 0.1, 3.0  # Hz
OTHERWISE = {
    "GENSAL": "is GENROU",
    "SCRX": "is SEXS",
    "ESAC1A": "order of constants; no feedback VF",
    "ESST1A": "order of constants",
    "EXAC1": "no TR",
    "ESDC2A": "no TR; KE = 0 as it stands",
    "EXST1": "limits of VF, not of the output",
    "ESST3A": "VE of system-base currents, without its slope",
    "ESST4B": "VE of system-base currents, without its slope",
    "HYGOV": "gate without r Tr, Tw of the system base",
    "IEEEST": "A2 = 0, A4 = 0",
}
ANDES = """
import json, sys, andes
andes.config_logger(stream_level=50)
for raw, dyr, held in json.load(sys.stdin):
    try:
        ss = andes.load(raw, addfile=dyr, no_output=True, default_config=True)
        for model in (ss.PV, ss.Slack):
            model.v0.v[:] = [held[str(bus)] for bus in model.bus.v]
        ss.PFlow.config.tol = 1e-10
        if not ss.PFlow.run():
            raise RuntimeError("its power flow does not converge")
        ss.EIG.run()
        at = [(str(b), float(v), float(a)) for b, v, a in zip(ss.Bus.idx.v, ss.Bus.v.v, ss.Bus.a.v)]
        models = {name: model.n for name, model in ss.models.items()}
        print(json.dumps([[[x.real, x.imag] for x in map(complex, ss.EIG.mu)], at, models]))
    except BaseException as error:
        print(json.dumps(f"{type(error).__name__}: {error}"))
"""


def ours(raw: Path, dyr: Path) -> tuple[dict[str, complex], Any] | None:
    """Voltages by bus and eigenvalues, 1/s, of a case; None: it is refused, or a record is not as in PSS/E."""
    try:
        case = import_case(raw, dyr)
    except InputError:
        return None
    if not case.content.get("machines") or any(
        row.replaced + row.left_out for row in case.records if row.name.isupper()
    ):
        return None
    for machine in case.content["machines"]:
        machine["speed_torque"] = False
    built = build(System.model_validate(case.content), [], [])
    return built.flow.by_bus, np.linalg.eigvals(linearise(built)[0])


def theirs(python: str, cases: list[tuple[Path, Path, dict[str, complex]]]) -> list[Any]:
    """What ANDES makes of cases: eigenvalues, voltages, numbers of models, or why it does not."""
    with tempfile.TemporaryDirectory() as folder:
        asked = []
        for i, (raw, dyr, voltages) in enumerate(cases):
            copy = Path(folder) / f"{i}.dyr"
            text = dyr.read_text(encoding="utf-8", errors="replace")
            copy.write_text(re.sub(r"('GENCLS'[\s,]+\w+[\s,]+)0(\.0*)?(?=[\s,])", r"\g<1>1e7", text), encoding="utf-8")
            asked.append([str(raw), str(copy), {name[1:]: abs(voltage) for name, voltage in voltages.items()}])
        done = subprocess.run(
            [python, "-c", ANDES], input=json.dumps(asked), capture_output=True, text=True, check=True
        )
    return [json.loads(line) for line in done.stdout.splitlines() if line[:1] in '["']


def row(dyr: Path, voltages: dict[str, complex], eigenvalues: Any, answer: Any) -> list[Any]:
    """A row of the table without its case."""
    if isinstance(answer, str):
        return ["", "", "", "", answer]
    records = Counter(record.model for record in read_dyr(dyr, []).records)
    modes = [complex(*pair) for pair in answer[0] if FROM <= pair[1] / (2.0 * math.pi) <= TO]
    far = max((float(np.abs(eigenvalues - mode).min()) for mode in modes), default=0.0)
    apart = max(abs(voltages[f"B{bus}"] - v * np.exp(1j * a)) for bus, v, a in answer[1])
    lacking = [name for name in records if not answer[2].get(name) and name not in OTHERWISE]
    other = [f"{name} {OTHERWISE[name]}" for name in records if name in OTHERWISE]
    return [len(modes), f"{far:.1e}", f"{apart:.1e}", ", ".join(lacking), "; ".join(other)]


def main() -> None:
    """The table."""
    python, *words = sys.argv[1:]
    files = [path for word in words if word != "--pool" for path in sorted(Path(word).rglob("*"))]
    cases = []
    for raw, dyr in pairs_of(files, pool="--pool" in words):
        solved = ours(raw, dyr) if raw else None
        if raw and solved:
            cases.append((raw, dyr, *solved))
    answers = theirs(python, [case[:3] for case in cases])
    rows = [
        [f"{raw.parent.name}/{raw.stem} + {dyr.stem}", *row(dyr, voltages, eigenvalues, answer)]
        for (raw, dyr, voltages, eigenvalues), answer in zip(cases, answers, strict=True)
    ]
    print("\n".join(table(("case", "modes", "1/s", "p.u.", "lacking", "otherwise in ANDES"), rows)))


if __name__ == "__main__":
    main()
