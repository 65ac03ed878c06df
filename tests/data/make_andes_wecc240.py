"""Figures of ANDES for WECC-240: writes the CSV files of `config/references/wecc240` from the RAW and DYR there.

In another environment, from the root of the repository:

    pip install andes==2.0.0
    python tests/data/make_andes_wecc240.py

ANDES is under the GPL: nothing of its program is here. What is put right of its reading: README.md of
`config/references`. Its elimination loses IEEEST with A3 = A4 = 0: the state matrix is made without them, and their
transfer functions are put to it.
"""

from __future__ import annotations

import csv
import re
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import andes
import numpy as np
from scipy.signal import tf2ss
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

HERE = Path(__file__).parents[2] / "config" / "references" / "wecc240"
RAW, DYR = HERE / "240busWECC_2018_PSS32_fixed_shunts.raw", HERE / "240busWECC_2018_PSS.dyr"
BASE = 100.0  # MVA
LINE_OFFSET = 1e-8  # p.u., what ANDES adds to r and x of a line
EVENT_DELAY = 5e-5  # s, by which events act late: half of ANDES's step of 0.1 ms after an event has the slope before it
UNIT, AT, END, STEPS_PER_SECOND, EVERY = "G1431_N", 1.0, 5.0, 120, 12  # the trip: unit, s, s, 1/s; samples kept
SWINGS = (0.2 * np.pi, 6.0 * np.pi)  # rad/s, eigenvalues with stabilisers that are kept
NOTHING = 1e-9  # of a coefficient of the state matrix
VOLTAGE, RECORD, CURRENTS = 7, "IEEEST", ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))  # of a bus; loads: P, Q: power, ...
Table = list[list[Any]]


def sections() -> list[list[list[str]]]:
    """The records of the sections of the RAW file: buses, loads, fixed shunts, generators, and so on."""
    parts: list[list[list[str]]] = [[]]
    for line in RAW.read_text().splitlines()[3:]:
        if re.match(r"\s*0\s*/", line):
            parts.append([])
        else:
            parts[-1].append([word.strip(" '") for word in line.split(",")])
    return parts


def without_stabilisers(folder: str) -> tuple[str, list[list[str]]]:
    """A DYR file without IEEEST, and their records: bus, machine, constants."""
    pattern = rf"^([^\n]*'{RECORD}'[^/]*)/"
    text = DYR.read_text()
    records = [re.findall(r"[^\s,']+", record) for record in re.findall(pattern, text, re.MULTILINE)]
    path = Path(folder) / "without.dyr"
    path.write_text(re.sub(pattern, "", text, flags=re.MULTILINE))
    return str(path), [[bus, machine, *constants] for bus, _, machine, *constants in records]


def names_of_units() -> list[str]:
    """The names that `facts-damping import` gives to the generators of the RAW file, in their order; empty: off."""
    rows = [(row[0], row[1], row[14] == "1") for row in sections()[3]]
    many = Counter(bus for bus, _, on in rows if on)
    return [(f"G{bus}_{i}" if many[bus] > 1 else f"G{bus}") if on else "" for bus, i, on in rows]


def solved(dyr: str, tripped: str | None) -> tuple[Any, Table, Table]:
    """The case with its power flow; voltages by bus, and powers by unit."""
    buses, loads, *_ = sections()
    stored = {int(row[0]): float(row[VOLTAGE]) for row in buses}
    ss = andes.load(str(RAW), addfile=dyr, no_output=True, default_config=True, setup=False)
    ss.REECB1.reg.v[:], ss.REPCA1.ree.v[:] = ss.REGCA1.idx.v, ss.REECB1.idx.v
    if tripped:
        ss.add("Toggle", {"model": "GENROU", "dev": tripped, "t": AT - EVENT_DELAY})
    ss.TDS.config.criteria = 0
    ss.setup()
    for gain in ("Kqp", "Kqi", "Kvp", "Kvi"):
        getattr(ss.REECB1, gain).v[:] = 0.0
    for part in (ss.Line.r, ss.Line.x):
        part.v[:] -= LINE_OFFSET
    for model in (ss.PV, ss.Slack):
        model.v0.v[:] = [stored[bus] for bus in model.bus.v]
    config = ss.PQ.config
    (config.p2p, config.p2i, config.p2z), (config.q2p, config.q2i, config.q2z) = CURRENTS
    ss.PFlow.config.tol = 1e-11
    P, Q, IP, IQ, YP, YQ = np.array([row[5:11] for row in loads], float).T / BASE
    for _ in range(20):  # loads of constant current and impedance are powers in its power flow
        voltage = dict(zip(ss.Bus.idx.v, ss.Bus.v.v, strict=True)) if ss.PFlow.converged else stored
        V = np.array([voltage[int(row[0])] for row in loads])
        for name, power in (("p0", P + IP * V + YP * V * V), ("q0", Q + IQ * V - YQ * V * V)):
            getattr(ss.PQ, name).v[:] = power
            getattr(ss.PQ, {"p0": "Ppf", "q0": "Qpf"}[name]).v[:] = power
        if not ss.PFlow.run():
            raise RuntimeError("the power flow does not converge")
    voltages = [list(row) for row in zip(ss.Bus.idx.v, ss.Bus.v.v, ss.Bus.a.v, strict=True)]
    names, powers = names_of_units(), []
    for model in (ss.PV, ss.Slack):
        for i, u, p, q in zip(model.idx.v, model.u.v, model.p.v, model.q.v, strict=True):
            powers += [[names[int(i) - 1], BASE * p, BASE * q]] if u else []
    return ss, voltages, powers


def of_each_other(A: np.ndarray) -> np.ndarray:
    """Eigenvalues of the states that act on each other: the largest strongly connected part of a state matrix."""
    _, part = connected_components(csr_matrix(np.abs(A) > NOTHING), connection="strong")
    coupled = part == np.bincount(part).argmax()
    return np.linalg.eigvals(A[np.ix_(coupled, coupled)])


def with_stabilisers(A: np.ndarray, states: list[str], records: list[list[str]], machines: dict[str, str]) -> Any:
    """The state matrix with stabilisers from the speed of their machines to the inputs of their SEXS."""
    n, order = len(A), 4
    whole = np.zeros((n + order * len(records),) * 2)
    whole[:n, :n] = A
    for k, (bus, machine, *constants) in enumerate(records):
        A1, A2, A3, A4, A5, A6, T1, T2, T3, T4, T5, T6, KS = map(float, constants[2:15])
        numerator, denominator = np.array([KS * T5, 0.0]), np.array([T6, 1.0])
        for factor in ([A6, A5, 1.0], [T1, 1.0], [T3, 1.0]):
            numerator = np.polymul(numerator, factor)
        for factor in ([A2, A1, 1.0], [A4, A3, 1.0], [T2, 1.0], [T4, 1.0]):
            denominator = np.polymul(denominator, factor)
        a, b, c, d = tf2ss(np.trim_zeros(numerator, "f"), np.trim_zeros(denominator, "f"))
        g = machines[f"{bus} {machine}"]
        speed, inner = states.index(f"omega GENROU {g}"), slice(n + order * k, n + order * (k + 1))
        into = np.zeros(len(whole))
        into[states.index(f"LL_x SEXS {g}")] = 1.0 / 10.0  # 1/TB
        into[states.index(f"LAW_y SEXS {g}")] = 0.1 * 100.0 / 0.1  # TA/TB K/TE
        whole[inner, inner] = a
        whole[inner, speed] += b.ravel()
        whole[:, inner] += np.outer(into, c.ravel())
        whole[:, speed] += into * d.item()
    return whole


def run(ss: Any, units: dict[str, str]) -> Table:
    """Speeds after the trip, of some units, by their names."""
    config = ss.TDS.config
    config.fixt, config.shrinkt, config.tstep, config.tf, config.tol = 1, 0, 1.0 / STEPS_PER_SECOND, END, 1e-8
    config.no_tqdm = 1
    if not ss.TDS.run():
        raise RuntimeError("the run does not end")
    times, speeds = np.array(ss.dae.ts.t), np.array(ss.dae.ts.x)[:, ss.GENROU.omega.a]
    rows = [k for k in range(EVERY, len(times), EVERY) if abs(times[k] - AT) > 1.5e-4]
    shown = [list(ss.GENROU.idx.v).index(i) for i in units]
    return [["t", *units.values()]] + [[times[k], *speeds[k, shown]] for k in rows]


def write(name: str, rows: Table, form: str) -> None:
    """A CSV file; numbers in a format."""
    with (HERE / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(
            [format(x, form) if isinstance(x, float) else x for x in row] for row in rows
        )


def main() -> None:
    """All figures."""
    andes.config_logger(stream_level=40)
    names = names_of_units()
    generators = sections()[3]
    with tempfile.TemporaryDirectory() as folder:
        dyr, records = without_stabilisers(folder)
        ss, voltages, powers = solved(dyr, None)
        write("voltages", [["bus", "V", "angle"], *voltages], ".10g")
        write("units", [["unit", "P", "Q"], *powers], ".10g")
        of = {i: int(gen) - 1 for i, gen in zip(ss.GENROU.idx.v, ss.GENROU.gen.v, strict=True)}
        ss.EIG.run()
        A, states = np.array(andes.shared.matrix(ss.EIG.As)), [str(name) for name in ss.EIG.x_name]
        machines = {f"{generators[k][0]} {generators[k][1]}": i.split("_")[1] for i, k in of.items()}
        cases = {"without": A, "with": with_stabilisers(A, states, records, machines)}
        rows: Table = [["stabilisers", "re", "im"]]
        for case, matrix in cases.items():
            values = np.sort_complex(of_each_other(matrix))
            lowest = 0.0 if case == "without" else SWINGS[0]
            highest = np.inf if case == "without" else SWINGS[1]
            rows += [[case, float(x.real), float(x.imag)] for x in values if lowest <= x.imag <= highest]
        write("eigenvalues", rows, ".9g")
        stabilised = {f"GENROU_{machines[f'{bus} {machine}']}" for bus, machine, *_ in records}
        shown = {i: names[k] for i, k in of.items() if i in stabilised}
        tripped = next(i for i, k in of.items() if names[k] == UNIT)
        write("trip", run(solved(dyr, tripped)[0], shown), ".9g")


if __name__ == "__main__":
    main()
