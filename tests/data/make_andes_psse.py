"""Eigenvalues and voltages of `three_machines.raw` with `.dyr` by ANDES: writes `three_machines_andes.json` here.

In an environment of its own: `pip install andes==2.0.0`.
"""

from __future__ import annotations

import json
from pathlib import Path

import andes

HERE = Path(__file__).parent


def main() -> None:
    """Power flow and eigenvalues, 1/s."""
    case = str(HERE / "three_machines")
    system = andes.load(f"{case}.raw", addfile=f"{case}.dyr", no_output=True, default_config=True)
    system.PFlow.run()
    system.EIG.run()
    values = sorted(([float(mu.real), float(mu.imag)] for mu in system.EIG.mu), key=lambda pair: (pair[1], pair[0]))
    rows = zip(system.Bus.idx.v, system.Bus.v.v, system.Bus.a.v, strict=True)
    voltages = {str(bus): [float(v), float(a)] for bus, v, a in rows}
    (HERE / "three_machines_andes.json").write_text(
        json.dumps({"eigenvalues": values, "voltages": voltages}, indent=1) + "\n", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
