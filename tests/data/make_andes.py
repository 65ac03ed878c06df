"""Figures of ANDES for example 12.6 with the plant's options: writes kundur_12_6_*_andes.csv of README.md beside this.

In an environment of its own, from the root of the repository:

    pip install andes==2.0.0
    python tests/data/make_andes.py

The system is built from the YAML file that the package reads; nothing of the package is used. ANDES adds 1e-8 p.u.
to r and x of every line; that is taken off here.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Any

import andes
import numpy as np
import yaml

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    Controls = Sequence[tuple[str, dict[str, Any]]]

ROOT = Path(__file__).parents[2]
REFERENCES = ROOT / "config" / "references"
KUNDUR = ROOT / "config" / "systems" / "kundur_12_6.yaml"
LINE_OFFSET = 1e-8  # p.u., what ANDES adds to r and x of a line
EVENT_DELAY = 5e-5  # s, by which events act late: half of ANDES's step of 0.1 ms after an event has the slope before it
NO_LIMIT = 99.0

IMPEDANCE, CURRENT, POWER = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)  # power, current, impedance
SATURATION = {"S10": 0.0392, "S12": 0.2227}
TAPS = [  # G1 by two transformers that are not alike, so that tap and shift drive a current around
    {"name": "T1", "from": "B1", "to": "B5", "rating": 450, "x": 0.15},
    {"name": "T5", "from": "B1", "to": "B5", "rating": 450, "x": 0.15, "tap": 1.03, "phase_shift": 2.0},
    {"name": "T2", "from": "B2", "to": "B6", "rating": 900, "x": 0.15, "tap": 0.97},
]
STATIC = (
    {"KA": 200.0, "TR": 0.01, "TF": 1.0}
    | dict.fromkeys(("TA", "TB", "TC", "KC", "KF"), 0.0)
    | {"VIMAX": NO_LIMIT, "VIMIN": -NO_LIMIT, "VRMAX": NO_LIMIT, "VRMIN": -NO_LIMIT}
)
REDUCED = STATIC | {"TB": 10.0, "TC": 1.0}
DC = (
    {"TR": 0.05, "KA": 20.0, "TA": 0.055, "TE": 0.36, "KF1": 0.125, "TF1": 1.8}
    | dict.fromkeys(("TB", "TC", "E1", "SE1", "E2", "SE2"), 0.0)
    | {"VRMAX": NO_LIMIT, "VRMIN": -NO_LIMIT}
)
DC_KE, DC_SATURATION = 1.0, (0.0056, 1.075)  # p.u.; SE(Efd) = A exp(B Efd)
STABILISER = (
    {"MODE": 1, "K1": 20.0, "T1": 0.0, "MODE2": 0, "K2": 0.0, "T2": 0.0, "T3": 10.0, "T4": 10.0}
    | {"T5": 0.05, "T6": 0.02, "T7": 3.0, "T8": 5.4, "T9": 0.0, "T10": 0.0}
    | {"LSMAX": 0.2, "LSMIN": -0.2, "VCU": 0.0, "VCL": 0.0}
)
# ANDES leaves Tr out of its equations and integrates with a gain of 1 where HYGOV has 1 / (r Tr): so r Tr = 1.
GOVERNOR = (
    {"R": 0.05, "r": 0.5, "Tr": 2.0, "Tf": 0.05, "Tg": 0.2}
    | {"VELM": 10.0, "GMAX": 1.0, "GMIN": 0.0}
    | {"Tw": 1.0, "At": 1.2, "Dt": 0.5, "qNL": 0.08}
)
CIRCUITS = {"ra": "Ra", "xl": "Xl", "xd": "Xd", "xd1": "Xd1", "xd2": "Xd2", "xq": "Xq", "xq1": "Xq1", "xq2": "Xq2"}
TIMES = {"Td10": "Td01", "Td20": "Td02", "Tq10": "Tq01", "Tq20": "Tq02"}


def build(
    base: float = 100.0,
    P: Sequence[float] = IMPEDANCE,
    Q: Sequence[float] = IMPEDANCE,
    controls: Controls = (),
    taps: Sequence[dict[str, Any]] = (),
    losses: float = 0.0,
    more: Callable[[Any], None] | None = None,
    **machine_data: float,
) -> Any:
    """A system of ANDES with its power flow solved.

    Args:
        base: system base, MVA; governors need that of their machine
        P: fractions of constant power, current and impedance in the loads' active power
        Q: the same for their reactive power
        controls: models of ANDES at every machine and their data; a dict has a value for each machine
        taps: transformers in the place of those of the same name, or beside them
        losses: active power of capacitor_1 at 1 p.u., MW
        more: adds what else there is, events for instance
        machine_data: fields of ANDES's machine model that the file does not have
    """
    data = yaml.safe_load(KUNDUR.read_text(encoding="utf-8"))
    ratio = base / data["base_power"]
    transformers = {t["name"]: t for t in [*data["transformers"], *taps]}
    kv = {bus["name"]: bus["nominal_voltage"] for bus in data["buses"]}
    ss = andes.System(no_output=True, default_config=True)
    ss.config.mva = base
    for name, nominal in kv.items():
        ss.add("Bus", idx=name, name=name, Vn=nominal)
    for branch in [*data["lines"], *transformers.values()]:
        a, b = branch["from"], branch["to"]
        scale = base / branch["rating"] if "rating" in branch else ratio * branch["length"]
        r, x = branch.get("r", 0.0) * scale - LINE_OFFSET, branch["x"] * scale - LINE_OFFSET
        charging = branch.get("b", 0.0) * branch.get("length", 1.0) / ratio
        turn = {"tap": branch.get("tap", 1.0), "phi": np.deg2rad(branch.get("phase_shift", 0.0))}
        ss.add("Line", idx=branch["name"], bus1=a, bus2=b, Sn=base, Vn1=kv[a], Vn2=kv[b], r=r, x=x, b=charging, **turn)
    for load in data["loads"]:
        power = {"p0": load["P"] / base, "q0": load["Q"] / base}
        ss.add("PQ", idx=load["name"], bus=load["bus"], Vn=kv[load["bus"]], **power)
    for shunt in data["shunts"]:
        drawn = losses / base if shunt["name"] == "capacitor_1" else 0.0
        y = {"g": drawn, "b": shunt["Q"] / base}
        ss.add("Shunt", idx=shunt["name"], bus=shunt["bus"], Sn=base, Vn=kv[shunt["bus"]], **y)
    for machine in data["machines"]:
        add_machine(ss, machine, base, controls, {"Vn": kv[machine["bus"]], **machine_data})
    config = ss.PQ.config
    config.pq2z = 0
    config.p2p, config.p2i, config.p2z = P
    config.q2q, config.q2i, config.q2z = Q
    if more is not None:
        more(ss)
    ss.setup()
    ss.PFlow.config.tol = 1e-12
    if not ss.PFlow.run():
        raise RuntimeError("the power flow does not converge")
    return ss


def add_machine(ss: Any, m: dict[str, Any], base: float, controls: Controls, more: dict[str, float]) -> None:
    """A machine with its controls, and the generator of the power flow that it takes the place of."""
    static = {"idx": f"static {m['name']}", "bus": m["bus"], "Sn": m["rating"], "Vn": more["Vn"], "v0": m["V"]}
    if m.get("slack"):
        ss.add("Slack", a0=np.deg2rad(m["angle"]), **static)
    else:
        ss.add("PV", p0=m["P"] / base, **static)
    common = {"idx": m["name"], "bus": m["bus"], "gen": static["idx"], "Sn": m["rating"], "fn": 60.0, "M": 2 * m["H"]}
    ss.add("GENROU", **common, **{to: m[of] for to, of in (CIRCUITS | TIMES).items()}, **more)
    for model, fields in controls:
        at = {"avr": f"EXST1 {m['name']}"} if model == "ST2CUT" else {"syn": m["name"]}
        data = {name: value[m["name"]] if isinstance(value, dict) else value for name, value in fields.items()}
        ss.add(model, idx=f"{model} {m['name']}", **at, **data)


def eigenvalues(ss: Any, *without: str) -> np.ndarray:
    """Eigenvalues of a system, 1/s.

    `without` begins the names of states that act on no other one: they are left out with their eigenvalues.
    """
    ss.EIG.run()
    A = np.array(ss.EIG.As)
    out = np.array([name.startswith(without) for name in ss.EIG.x_name])
    if np.abs(A[np.ix_(~out, out)]).max(initial=0.0) > 1e-12:
        raise RuntimeError(f"{without} act on other states")
    values = np.linalg.eigvals(A[np.ix_(~out, ~out)])
    return np.asarray(values[np.lexsort((values.imag, values.real))])


def dc(**options: Any) -> Controls:
    """DC exciters: IEEEX1 has no exponential saturation, so KE takes the slope of KE Efd + SE(Efd) Efd at the start."""
    ss = build(**options)
    ss.EIG.run()
    A, B = DC_SATURATION
    start = zip(ss.GENROU.idx.v, ss.GENROU.vf.v, strict=True)
    slopes = {name: DC_KE + A * np.exp(B * Efd) * (1 + B * Efd) for name, Efd in start}
    return [("IEEEX1", {**DC, "KE": slopes})]


def write(name: str, header: list[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a CSV, numbers with twelve digits."""
    with (REFERENCES / f"kundur_12_6_{name}_andes.csv").open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(header)
        out.writerows([x if isinstance(x, str) else f"{x:.12g}" for x in row] for row in rows)


def small_signals() -> None:
    """Each option, and some together: eigenvalues; start with saturation; voltages with taps."""
    static, reduced, governor = [("EXST1", STATIC)], [("EXST1", REDUCED)], ("HYGOV", GOVERNOR)
    stabilised = [*static, ("ST2CUT", STABILISER)]
    book = {"P": CURRENT, "Q": IMPEDANCE, **SATURATION}
    cases: dict[str, dict[str, Any]] = {
        "taps": {"taps": TAPS, "losses": 10.0},
        "damping": {"D": 2.0},
        "saturation": SATURATION,
        "current": {"P": CURRENT, "Q": IMPEDANCE},
        "power": {"P": POWER, "Q": POWER},
        "mixture": {"P": (0.3, 0.5, 0.2), "Q": (0.1, 0.4, 0.5)},
        "static": {"controls": static},
        "static_feedback": {"controls": [("EXST1", {**STATIC, "TR": 0.0, "KF": 0.001, "TF": 0.1})]},
        "stabiliser": {"controls": stabilised},
        "governor": {"base": 900.0, "controls": [governor]},
        "stabiliser_governor": {"base": 900.0, "controls": [*stabilised, governor]},
        "book_manual": book,
        "book_thyristor": {**book, "controls": static},
        "book_thyristor_stabiliser": {**book, "controls": stabilised},
        "dc": {"controls": dc()},
        "reduction": {"controls": reduced},
        "reduction_feedback": {"controls": [("EXST1", {**REDUCED, "KF": 0.001, "TF": 0.1})]},
        "book_dc": {**book, "controls": dc(**book)},
        "book_thyristor_reduction": {**book, "controls": reduced},
    }
    rows: list[tuple[Any, ...]] = []
    for name, options in cases.items():
        ss = build(**options)
        feedback = () if name.endswith("feedback") else ("WF_x EXST1",)
        values = eigenvalues(ss, "L_y BusFreq", "WO_x BusFreq", *feedback)
        rows += [(name, value.real, value.imag) for value in values]
        if name == "saturation":
            start = zip(ss.GENROU.idx.v, ss.GENROU.vf.v, ss.GENROU.delta.v, strict=True)
            write("saturation_start", ["machine", "Efd", "delta"], start)
        if name == "taps":
            voltages = zip(ss.Bus.idx.v, ss.Bus.v.v, ss.Bus.a.v, strict=True)
            write("taps_voltages", ["bus", "V", "angle"], voltages)
    write("options_eigenvalues", ["case", "re", "im"], rows)


def simulate(ss: Any, name: str, end: float, every: int, **columns: Any) -> None:
    """Run to `end` (s) with a step of 1 ms; write each `every`-th of ANDES's instants, a column for each machine."""
    config = ss.TDS.config
    config.tf, config.tstep, config.fixt, config.tol, config.no_tqdm, config.criteria = end, 0.001, 1, 1e-10, 1, 0
    if not ss.TDS.run():
        raise RuntimeError("the simulation failed")
    ss.dae.ts.unpack()
    blocks = [np.array(ss.dae.ts.t)[:, None]]
    for variable in columns.values():
        stored = ss.dae.ts.x if type(variable).__name__.endswith("State") else ss.dae.ts.y
        blocks.append(np.array(stored)[:, np.array(variable.a)])
    header = ["t", *(f"{prefix}{g}" for prefix, variable in columns.items() for g in range(1, variable.n + 1))]
    write(name, header, np.hstack(blocks)[::every])


def runs() -> None:
    """Load step with all controls; fault with loads of constant active current."""

    def load_step(ss: Any) -> None:
        for field in ("Req", "Xeq"):
            step = {"model": "PQ", "dev": "load_1", "src": field, "attr": "v", "method": "*", "amount": 1.05}
            ss.add("Alter", t=1.0 - EVENT_DELAY, **step)

    def fault(ss: Any) -> None:
        ss.add("Fault", bus="B8", tf=1.0 - EVENT_DELAY, tc=1.1 - EVENT_DELAY, xf=1e-3, rf=0.0)

    controls = [("EXST1", STATIC), ("ST2CUT", STABILISER), ("HYGOV", GOVERNOR)]
    ss = build(base=900.0, controls=controls, more=load_step)
    simulate(ss, "governor_load_step", 30.0, 100, w=ss.GENROU.omega, pm=ss.GENROU.tm)
    ss = build(P=CURRENT, Q=IMPEDANCE, more=fault)
    simulate(ss, "current_fault", 10.0, 20, w=ss.GENROU.omega, d=ss.GENROU.delta)


if __name__ == "__main__":
    andes.config_logger(stream_level=30)
    small_signals()
    runs()
