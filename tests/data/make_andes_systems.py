"""Figures of ANDES for shipped systems of many machines: writes config/references/*_andes.csv (README.md there).

In an environment of its own, from the root of the repository:

    pip install andes==2.0.0
    python tests/data/make_andes_systems.py

The systems are built from the YAML files that the package reads; nothing of the package is used. A two-axis machine
is a GENROU with X'' = X', whose two subtransient circuits then stand apart, at -1/T''. GENROU starts from
X''d = X''q, so angle and flux of the start are set here. ANDES has no exponential saturation of exciters: for
eigenvalues KE takes its slope at the start, which is all that a linearisation sees; the fault is without it. Nor has
it DC4B, built here from its blocks. ANDES adds 1e-8 p.u. to r and x of every line; that is taken off here. Devices
are left out.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Any

import andes
import andes.models
import andes.models.exciter
import numpy as np
import yaml
from andes.core.block import Integrator, Lag, Washout
from andes.core.param import NumParam
from andes.core.service import ConstService, PostInitService
from andes.core.var import Algeb
from andes.models.exciter.excbase import ExcBase, ExcBaseData

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

ROOT = Path(__file__).parents[2]
REFERENCES = ROOT / "config" / "references"
SYSTEMS = ROOT / "config" / "systems"
BASE = 100.0  # MVA
T2 = 0.02  # s, time constant of the circuits that stand apart
NO_LIMIT = 99.0
LINE_OFFSET = 1e-8  # p.u., what ANDES adds to r and x of a line
CIRCUITS = {"xl": "Xl", "xd": "Xd", "xd1": "Xd1", "xd2": "Xd2", "xq": "Xq", "xq1": "Xq1", "xq2": "Xq2"}
TIMES = {"Td10": "Td01", "Td20": "Td02", "Tq10": "Tq01", "Tq20": "Tq02"}
FAULT_BUS, FAULT_LINE, FAULT_ON, FAULT_OFF, FAULT_X = "B60", "line_61_60", 1.0, 1.08, 1e-3  # s, p.u.
UNTIL, STEP, SHOWN = 5.0, 1e-3, 20  # s, s, every so many steps
EVENT_DELAY = 0.5 * STEP  # s, by which events act late: the step after an event has the slope before it


class DC4B(ExcBaseData, ExcBase):  # type: ignore[misc]
    """IEEE DC4B from blocks of ANDES, which has no such exciter: no limits; KE has the slope of the saturation."""

    def __init__(self, system: Any, config: Any) -> None:
        """Its parameters and equations."""
        ExcBaseData.__init__(self)
        for name in ("TR", "KP", "KI", "KD", "TD", "KA", "TA", "KE", "TE", "KF", "TF"):
            setattr(self, name, NumParam(default=1.0, tex_name=name))
        ExcBase.__init__(self, system, config)
        self.I0 = ConstService(v_str="KE * vf0 / KA")
        self.one = ConstService(v_str="1")
        self.vref = Algeb(v_str="v", e_str="vref0 - vref")
        self.vref0 = PostInitService(v_str="vref")
        self.LS = Lag(u=self.v, T=self.TR, K=1.0)
        self.VE = Integrator(u="VR_y - KE * VE_y", T=self.TE, K=1.0, y0=self.vf0)
        self.VF = Washout(u=self.VE_y, T=self.TF, K=self.KF)
        self.vi = Algeb(v_str="0", e_str="vref - LS_y - VF_y - vi")  # stabilisers add to it
        self.PI = Integrator(u="KI * vi", T=self.one, K=1.0, y0=self.I0)
        self.PD = Washout(u=self.vi, T=self.TD, K=self.KD)
        self.VR = Lag(u="KP * vi + PI_y + PD_y", T=self.TA, K=self.KA)
        self.vout.e_str = "ue * VE_y - vout"


andes.models.exciter.DC4B = DC4B
next(classes for name, classes in andes.models.file_classes if name == "exciter").append("DC4B")


def build(content: dict[str, Any], slopes: dict[str, float], more: Callable[[Any], None] | None = None) -> Any:
    """A system with its power flow solved and its dynamics started; slopes: KE of exciters; `more` adds the rest."""
    andes.config_logger(stream_level=50)
    ss = andes.System(no_output=True, default_config=True)
    kilovolts = {bus["name"]: bus["nominal_voltage"] for bus in content["buses"]}
    for name, nominal in kilovolts.items():
        ss.add("Bus", {"idx": name, "Vn": nominal, "v0": 1.0, "a0": 0.0})
    for row in (*content["lines"], *content["transformers"]):
        ends = {"bus1": row["from"], "bus2": row["to"], "Vn1": kilovolts[row["from"]], "Vn2": kilovolts[row["to"]]}
        values = {"r": row.get("r", 0.0) - LINE_OFFSET, "x": row["x"] - LINE_OFFSET, "b": row.get("b", 0.0)}
        values["tap"] = row.get("tap", 1.0)
        ss.add("Line", {"idx": row["name"], "Sn": BASE, "trans": int("tap" in row)} | ends | values)
    for row in content["loads"]:
        power = {"p0": row["P"] / BASE, "q0": row["Q"] / BASE}
        ss.add("PQ", {"idx": row["name"], "bus": row["bus"], "Vn": kilovolts[row["bus"]]} | power)
    for m in content["machines"]:
        _add_machine(ss, m, kilovolts[m["bus"]])
    for e in content["exciters"]:
        _add_exciter(ss, e, slopes)
    for s in content.get("stabilisers", ()):
        _add_stabiliser(ss, s)
    if any(m["model"] == "two_axis" for m in content["machines"]):
        machines = ss.GENROU
        machines.delta0.v_numeric = lambda _V, _It, xq, ra, **_: np.angle(_V + (ra + 1j * xq) * _It)
        machines.psi2q0.v_numeric = lambda psi20_dq, It_dq, xd2, xq2, **_: -psi20_dq.imag + (xd2 - xq2) * It_dq.real
    if more is not None:
        more(ss)
    ss.PFlow.config.tol = 1e-11
    ss.setup()
    if not ss.PFlow.run():
        raise RuntimeError("the power flow does not converge")
    ss.TDS.init()
    return ss


def _add_machine(ss: Any, m: dict[str, Any], kilovolts: float) -> None:
    """A machine, and the generator of the power flow that it takes the place of."""
    at = {"bus": m["bus"], "Vn": kilovolts, "Sn": m["rating"]}
    flow = {"a0": 0.0} if m.get("slack") else {"p0": m["P"] / BASE}
    ss.add("Slack" if m.get("slack") else "PV", {"idx": m["name"], "v0": m["V"]} | at | flow)
    if m["model"] == "two_axis":
        Xq1, Tq01 = m.get("Xq1", m["Xq"]), m.get("Tq01", 1.0)
        d = {"xd": m["Xd"], "xd1": m["Xd1"], "xd2": m["Xd1"], "Td10": m["Td01"], "Td20": T2}
        q = {"xq": m["Xq"], "xq1": Xq1, "xq2": Xq1, "Tq10": Tq01, "Tq20": T2}
        circuits = d | q | {"xl": 0.0}
    else:
        circuits = {to: m[of] for to, of in (CIRCUITS | TIMES).items()}
    rest = {"M": 2 * m["H"], "D": 0.0, "ra": 0.0, "S10": 0.0, "S12": 0.0}
    ss.add("GENROU", {"idx": f"machine {m['name']}", "gen": m["name"]} | at | circuits | rest)


def _add_exciter(ss: Any, e: dict[str, Any], slopes: dict[str, float]) -> None:
    at = {"idx": f"exciter {e['machine']}", "syn": f"machine {e['machine']}", "TR": e["TR"], "KA": e["KA"]}
    limits = {"VRMAX": NO_LIMIT, "VRMIN": -NO_LIMIT}
    if e["model"] == "DC4B":
        parameters = {name: e[name] for name in ("KP", "KI", "KD", "TD", "TA", "TE", "KF", "TF")}
        ss.add("DC4B", at | parameters | {"KE": slopes.get(e["machine"], e["KE"])})
    elif e["model"] == "dc":
        parameters = {
            "TA": e["TA"],
            "TE": e["TE"],
            "KF1": e["KF"],
            "TF1": e["TF"],
            "KE": slopes.get(e["machine"], e["KE"]),
        }
        ss.add("IEEEX1", at | parameters | limits | dict.fromkeys(("TB", "TC", "E1", "SE1", "E2", "SE2"), 0.0))
    else:
        none = dict.fromkeys(("TA", "TB", "TC", "KC", "KF"), 0.0) | {"TF": 1.0, "VIMAX": NO_LIMIT, "VIMIN": -NO_LIMIT}
        ss.add("EXST1", at | limits | none)


def _add_stabiliser(ss: Any, s: dict[str, Any]) -> None:
    """A washout and two lead-lags, or with a filter in front of them (IEEEST with A1 and A5 alone) three."""
    if s.get("model") == "IEEEST":
        limits = {"LSMAX": s["LSMAX"], "LSMIN": s["LSMIN"]}
        gain, washout, filtered = s["KS"], s["T6"], {"T9": s["A5"], "T10": s["A1"]}
    else:
        limits = {"LSMAX": s["maximum"], "LSMIN": s["minimum"]}
        gain, washout, filtered = s["K"], s["Tw"], {"T9": 0.0, "T10": 0.0}
    times = {"T4": washout, "T3": washout, "T5": s["T1"], "T6": s["T2"], "T7": s["T3"], "T8": s["T4"]}
    none = dict.fromkeys(("T1", "T2", "K2", "MODE2", "VCU", "VCL"), 0.0)
    ss.add("ST2CUT", {"avr": f"exciter {s['machine']}", "MODE": 1, "K1": gain} | times | filtered | none | limits)


def slope(e: dict[str, Any], Efd: float) -> float:
    """KE with the slope of SE(E) E, SE = A exp(B E), of a DC exciter."""
    if e["model"] == "dc":
        A, B = e["AEX"], e["BEX"]
    else:
        B = np.log(e["SE1"] / e["SE2"]) / (e["E1"] - e["E2"])
        A = e["SE1"] * np.exp(-B * e["E1"])
    return float(e["KE"] + A * np.exp(B * Efd) * (1 + B * Efd))


def eigenvalues(content: dict[str, Any]) -> np.ndarray:
    """Eigenvalues of a system, 1/s, without those of circuits that the two-axis model does not have."""
    start = build(content, {})
    field = dict(zip((m["name"] for m in content["machines"]), start.GENROU.vf0.v, strict=True))
    slopes = {}
    for e in content["exciters"]:
        if e["model"] in ("dc", "DC4B"):
            slopes[e["machine"]] = slope(e, field[e["machine"]])
    ss = build(content, slopes)
    ss.EIG.run()
    two_axis = any(m["model"] == "two_axis" for m in content["machines"])
    eigenvalues_found = [value for value in _coupled(ss) if not (two_axis and abs(value + 1.0 / T2) < 1e-6)]
    for m in content["machines"]:
        if m["model"] == "two_axis" and "Xq1" not in m:  # a salient pole: X'q = Xq uncouples the circuit
            eigenvalues_found.pop(int(np.argmin([abs(value + 1.0) for value in eigenvalues_found])))
    return np.array(sorted(eigenvalues_found, key=lambda value: (-value.real, value.imag)))


def _coupled(ss: Any) -> np.ndarray:
    """Eigenvalues without those of states on which no other one depends: frequency meters, a rate feedback of none."""
    A = np.array(ss.EIG.As)
    while not (used := np.abs(A - np.diag(np.diag(A))).max(axis=0) > 1e-12).all():
        A = A[np.ix_(used, used)]
    return np.asarray(np.linalg.eigvals(A))


def voltages(content: dict[str, Any]) -> list[tuple[str, float, float]]:
    """Bus, magnitude (p.u.) and angle (deg)."""
    ss = build(content, {})
    return [(n, float(v), float(np.rad2deg(a))) for n, v, a in zip(ss.Bus.idx.v, ss.Bus.v.v, ss.Bus.a.v, strict=True)]


def fault(content: dict[str, Any]) -> list[list[float]]:
    """Time (s), then speeds (p.u.): a fault at a bus, cleared by the trip of a line; exciters without saturation."""

    def more(ss: Any) -> None:
        times = {"tf": FAULT_ON - EVENT_DELAY, "tc": FAULT_OFF - EVENT_DELAY}
        ss.add("Fault", {"bus": FAULT_BUS, "xf": FAULT_X, "rf": 0.0} | times)
        ss.add("Toggle", {"model": "Line", "dev": FAULT_LINE, "t": FAULT_OFF - EVENT_DELAY})

    wide = {"minimum": -NO_LIMIT, "maximum": NO_LIMIT, "LSMIN": -NO_LIMIT, "LSMAX": NO_LIMIT}
    ss = build({**content, "stabilisers": [{**s, **wide} for s in content["stabilisers"]]}, {}, more)
    config = ss.TDS.config
    config.tf, config.tstep, config.fixt, config.shrinkt, config.tol, config.criteria = UNTIL, STEP, 1, 0, 1e-8, 0
    if not ss.TDS.run():
        raise RuntimeError("the simulation ended early")
    t, omega = np.asarray(ss.dae.ts.t), np.asarray(ss.dae.ts.x)[:, ss.GENROU.omega.a]
    shown = np.arange(0.0, UNTIL + 0.5 * STEP, SHOWN * STEP)
    return [[float(at), *(float(np.interp(at, t, w)) for w in omega.T)] for at in shown]


def write(name: str, header: list[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a CSV."""
    with (REFERENCES / f"{name}_andes.csv").open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(header)
        out.writerows([x if isinstance(x, str) else f"{x:.8f}" for x in row] for row in rows)


def main() -> None:
    """Write the files."""
    for name in ("wscc_9", "new_england_39", "nets_nyps"):
        content = yaml.safe_load((SYSTEMS / f"{name}.yaml").read_text(encoding="utf-8"))
        write(f"{name}_eigenvalues", ["re", "im"], [(v.real, v.imag) for v in eigenvalues(content)])
    content = yaml.safe_load((SYSTEMS / "nets_nyps.yaml").read_text(encoding="utf-8"))
    write("nets_nyps_voltages", ["bus", "magnitude", "angle"], voltages(content))
    write("nets_nyps_fault", ["t", *(m["name"] for m in content["machines"])], fault(content))


if __name__ == "__main__":
    main()
