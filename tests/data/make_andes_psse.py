"""Eigenvalues by ANDES of PSS/E cases: `three_machines.raw` with `.dyr` of this folder, with voltages, and its own.

Writes `three_machines_andes.json` and `andes_cases.json` here; of its own cases the eigenvalues that oscillate. In an
environment of its own: `pip install andes==2.0.0`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import andes

HERE = Path(__file__).parent
OWN = {  # of which all models are modelled here as there
    "kundur_full": ("kundur/kundur.raw", "kundur/kundur_full.dyr"),
    "kundur_gencls": ("kundur/kundur.raw", "kundur/kundur_gencls.dyr"),
    "npcc_full": ("npcc/npcc.raw", "npcc/npcc_full.dyr"),
    "wecc_gencls": ("wecc/wecc.raw", "wecc/wecc_gencls.dyr"),
}


def analysed(raw: Path, dyr: Path) -> tuple[Any, list[list[float]]]:
    """The system after its power flow, and all eigenvalues, 1/s."""
    system = andes.load(str(raw), addfile=str(dyr), no_output=True, default_config=True)
    system.PFlow.run()
    system.EIG.run()
    return system, sorted(([float(mu.real), float(mu.imag)] for mu in system.EIG.mu), key=lambda pair: pair[::-1])


def main() -> None:
    """Power flow and eigenvalues."""
    system, values = analysed(HERE / "three_machines.raw", HERE / "three_machines.dyr")
    rows = zip(system.Bus.idx.v, system.Bus.v.v, system.Bus.a.v, strict=True)
    voltages = {str(bus): [float(v), float(a)] for bus, v, a in rows}
    content: dict[str, Any] = {"eigenvalues": values, "voltages": voltages}
    (HERE / "three_machines_andes.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    cases = Path(andes.__file__).parent / "cases"
    found = {}
    for name, (raw, dyr) in OWN.items():
        _, values = analysed(cases / raw, cases / dyr)
        found[name] = {"raw": raw, "dyr": dyr, "modes": [pair for pair in values if pair[1] > 1e-3]}
    rows_of = [f'"{name}": {json.dumps(one)}' for name, one in found.items()]
    text = "{\n" + ",\n".join(rows_of) + "\n}\n"
    (HERE / "andes_cases.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
