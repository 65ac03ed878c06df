"""Eigenvalues by ANDES of PSS/E cases: `three_machines.raw` with `.dyr` of this folder, with voltages, and its own.

Writes `three_machines_andes.json` and `andes_cases.json` here; of its own cases the eigenvalues that oscillate; and
`npcc_andes.json`: voltages of NPCC, and speeds after a fault. In an environment of its own: `pip install andes==2.0.0`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import andes
import numpy as np

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


BUS, ON, OFF, X = 37, 1.0, 1.1, 0.02  # of the fault, s, p.u.
UNTIL, STEP, SHOWN = 5.0, 0.001, 0.1  # s
EVENT_DELAY = 5e-5  # s, by which events act late: half of ANDES's step of 0.1 ms after an event has the slope before it


def npcc(raw: Path, dyr: Path) -> dict[str, Any]:
    """Voltages, p.u. and rad, by bus, and speeds after a fault at a bus, p.u., machines by bus and generator."""
    ss = andes.load(str(raw), addfile=str(dyr), setup=False, no_output=True, default_config=True)
    ss.add("Fault", bus=BUS, tf=ON - EVENT_DELAY, tc=OFF - EVENT_DELAY, rf=0.0, xf=X)
    config = ss.PQ.config
    config.pq2z, config.p2p, config.p2i, config.p2z = 0, 0.0, 0.0, 1.0
    config.q2q, config.q2i, config.q2z = 0.0, 0.0, 1.0
    ss.setup()
    ss.PFlow.config.tol = 1e-10
    if not ss.PFlow.run():
        raise RuntimeError("the power flow does not converge")
    rows = zip(ss.Bus.idx.v, ss.Bus.v.v, ss.Bus.a.v, strict=True)
    voltages = {str(bus): [float(v), float(a)] for bus, v, a in rows}
    config = ss.TDS.config
    config.tf, config.tstep, config.fixt, config.tol, config.criteria, config.no_tqdm = UNTIL, STEP, 1, 1e-7, 0, 1
    ss.TDS.init()
    if not ss.TDS.run():
        raise RuntimeError("the simulation failed")
    ss.dae.ts.unpack()
    at = [pair for model in (ss.GENROU, ss.GENCLS) for pair in zip(model.bus.v, model.gen.v, strict=True)]
    order = sorted(range(len(at)), key=lambda i: at[i])
    speeds = np.concatenate([np.array(model.omega.a, int) for model in (ss.GENROU, ss.GENCLS)])[order]
    t, speeds_found = np.array(ss.dae.ts.t), np.array(ss.dae.ts.x)[:, speeds]
    shown = np.round(np.arange(SHOWN, UNTIL + 1e-9, SHOWN), 9)
    table = [[round(float(np.interp(instant, t, w)), 9) for w in speeds_found.T] for instant in shown]
    return {"voltages": voltages, "bus": BUS, "on": ON, "off": OFF, "x": X, "t": shown.tolist(), "speeds": table}


def main() -> None:
    """Power flow, eigenvalues, and a fault."""
    system, values = analysed(HERE / "three_machines.raw", HERE / "three_machines.dyr")
    rows = zip(system.Bus.idx.v, system.Bus.v.v, system.Bus.a.v, strict=True)
    voltages = {str(bus): [float(v), float(a)] for bus, v, a in rows}
    content: dict[str, Any] = {"eigenvalues": values, "voltages": voltages}
    (HERE / "three_machines_andes.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    cases = Path(andes.__file__).parent / "cases"
    cases_found = {}
    for name, (raw, dyr) in OWN.items():
        _, values = analysed(cases / raw, cases / dyr)
        cases_found[name] = {"raw": raw, "dyr": dyr, "modes": [pair for pair in values if pair[1] > 1e-3]}
    rows_of = [f'"{name}": {json.dumps(case_content)}' for name, case_content in cases_found.items()]
    text = "{\n" + ",\n".join(rows_of) + "\n}\n"
    (HERE / "andes_cases.json").write_text(text, encoding="utf-8")
    course = npcc(*(cases / name for name in OWN["npcc_full"]))
    rows_of = [f'"{name}": {json.dumps(case_content)}' for name, case_content in course.items()]
    (HERE / "npcc_andes.json").write_text("{\n" + ",\n".join(rows_of) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
