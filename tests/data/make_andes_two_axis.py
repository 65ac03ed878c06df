"""Eigenvalues of ANDES for the systems of two-axis machines: writes their files *_eigenvalues_andes.csv beside this.

In an environment of its own, from the root of the repository:

    pip install andes==2.0.0
    python tests/data/make_andes_two_axis.py

The systems are built from the YAML files that the package reads; nothing of the package is used. A two-axis machine
is a GENROU with X'' = X', whose two subtransient circuits then stand apart, at -1/T''. GENROU starts from
X''d = X''q, so angle and flux of the start are set here. ANDES has no exponential saturation of exciters: KE takes
its slope at the start, which is all that a linearisation sees.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import andes
import numpy as np
import yaml

ROOT = Path(__file__).parents[2]
REFERENCES = ROOT / "config" / "references"
SYSTEMS = ROOT / "config" / "systems"
BASE = 100.0  # MVA
T2 = 0.02  # s, time constant of the circuits that stand apart
NO_LIMIT = 99.0


def build(content: dict[str, Any], slopes: dict[str, float]) -> Any:
    """A system with its power flow solved and its dynamics started; slopes: KE of each exciter."""
    andes.config_logger(stream_level=50)
    ss = andes.System()
    kilovolts = {bus["name"]: bus["nominal_voltage"] for bus in content["buses"]}
    for name, nominal in kilovolts.items():
        ss.add("Bus", {"idx": name, "Vn": nominal, "v0": 1.0, "a0": 0.0})
    for row in (*content["lines"], *content["transformers"]):
        ends = {"bus1": row["from"], "bus2": row["to"], "Vn1": kilovolts[row["from"]], "Vn2": kilovolts[row["to"]]}
        values = {"r": row.get("r", 0.0), "x": row["x"], "b": row.get("b", 0.0), "tap": row.get("tap", 1.0)}
        ss.add("Line", {"idx": row["name"], "Sn": BASE, "trans": int("tap" in row)} | ends | values)
    for row in content["loads"]:
        power = {"p0": row["P"] / BASE, "q0": row["Q"] / BASE}
        ss.add("PQ", {"idx": row["name"], "bus": row["bus"], "Vn": kilovolts[row["bus"]]} | power)
    for m in content["machines"]:
        at = {"bus": m["bus"], "Vn": kilovolts[m["bus"]], "Sn": BASE}
        flow = {"a0": 0.0} if m.get("slack") else {"p0": m["P"] / BASE}
        ss.add("Slack" if m.get("slack") else "PV", {"idx": m["name"], "v0": m["V"]} | at | flow)
        Xq1, Tq01 = m.get("Xq1", m["Xq"]), m.get("Tq01", 1.0)
        d = {"xd": m["Xd"], "xd1": m["Xd1"], "xd2": m["Xd1"], "Td10": m["Td01"], "Td20": T2}
        q = {"xq": m["Xq"], "xq1": Xq1, "xq2": Xq1, "Tq10": Tq01, "Tq20": T2}
        rest = {"M": 2 * m["H"], "D": 0.0, "ra": 0.0, "xl": 0.0, "S10": 0.0, "S12": 0.0}
        ss.add("GENROU", {"idx": f"machine {m['name']}", "gen": m["name"]} | at | d | q | rest)
    for e in content["exciters"]:
        given = {key: e[key] for key in ("TR", "KA", "TA", "TE")} | {"KF1": e["KF"], "TF1": e["TF"]}
        none = dict.fromkeys(("TB", "TC", "E1", "SE1", "E2", "SE2"), 0.0) | {"VRMAX": NO_LIMIT, "VRMIN": -NO_LIMIT}
        ss.add("IEEEX1", {"syn": f"machine {e['machine']}", "KE": slopes.get(e["machine"], 1.0)} | given | none)
    machines = ss.GENROU
    machines.delta0.v_numeric = lambda _V, _It, xq, ra, **_: np.angle(_V + (ra + 1j * xq) * _It)
    machines.psi2q0.v_numeric = lambda psi20_dq, It_dq, xd2, xq2, **_: -psi20_dq.imag + (xd2 - xq2) * It_dq.real
    ss.PFlow.config.tol = 1e-11
    ss.setup()
    ss.PFlow.run()
    ss.TDS.init()
    return ss


def eigenvalues(content: dict[str, Any]) -> np.ndarray:
    """Eigenvalues of a system, 1/s, without those of circuits that the two-axis model does not have."""
    start = build(content, {})
    field = dict(zip((m["name"] for m in content["machines"]), start.GENROU.vf0.v, strict=True))
    slopes = {}
    for e in content["exciters"]:
        Efd = field[e["machine"]]
        slopes[e["machine"]] = e["KE"] + e["AEX"] * np.exp(e["BEX"] * Efd) * (1 + e["BEX"] * Efd)
    ss = build(content, slopes)
    ss.EIG.run()
    found = [value for value in ss.EIG.mu if abs(value + 1 / T2) > 1e-6]
    for m in content["machines"]:
        if "Xq1" not in m:  # a salient pole: X'q = Xq uncouples the circuit
            found.pop(int(np.argmin([abs(value + 1.0) for value in found])))
    return np.array(sorted(found, key=lambda value: (-value.real, value.imag)))


def main() -> None:
    """Write the files."""
    for name in ("wscc_9", "new_england_39"):
        content = yaml.safe_load((SYSTEMS / f"{name}.yaml").read_text(encoding="utf-8"))
        rows = [f"{value.real:.8f},{value.imag:.8f}" for value in eigenvalues(content)]
        (REFERENCES / f"{name}_eigenvalues_andes.csv").write_text("\n".join(["re,im", *rows, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
