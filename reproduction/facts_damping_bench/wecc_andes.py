"""WECC-240 by ANDES, loaded from its files; loads are of constant current (P) and impedance (Q), as in the RAW.

What it misreads is put right: inverters that share a bus, units that regulate other buses, gains that are not used.
"""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING, Any, NamedTuple

import andes
import numpy as np

from facts_damping_bench.grid import FAULT_START, Grid, TimedRun
from facts_damping_bench.wecc import UNIT
from facts_damping_bench.with_andes import EVENT_DELAY, LINE_OFFSET, simulated
from facts_damping_grids.psse.reading import read_raw
from facts_damping_validation.table import figures
from facts_damping_validation.wecc240 import FOLDER, files

if TYPE_CHECKING:
    from pathlib import Path

CURRENTS = {"p2p": 0.0, "p2i": 1.0, "p2z": 0.0, "q2p": 0.0, "q2i": 0.0, "q2z": 1.0}  # parts of loads in time
UNUSED = ("Kqp", "Kqi", "Kvp", "Kvi")  # of REECB1, whose QFLAG is 0
STABILISER = re.compile(r"^[^\n]*'IEEEST'[^/]*/", re.MULTILINE)  # a record of the DYR


class Prepared(NamedTuple):
    """The DYR without stabilisers; of the RAW voltages by bus, powers of loads (p.u.), and which units stay."""

    dyr: str
    held: dict[int, float]
    drawn: np.ndarray[Any, np.dtype[np.complex128]]
    tripped: int  # of the generators of the RAW, from 1 on
    staying: list[int]  # the others in service


def prepare(grid: Grid, folder: Path) -> Prepared:  # noqa: ARG001 (what every program's module takes)
    """Its equations as code, which it keeps in the user's folder; powers of loads at the voltages of its power flow."""
    andes.config_logger(stream_level=50)
    raw, dyr = files()
    (path := folder / "without.dyr").write_text(STABILISER.sub("", dyr.read_text()))
    case = read_raw(raw)
    tables = case.tables
    solved = {int(row["bus"]): float(row["V"]) for row in figures(f"{FOLDER}/voltages")}
    at = np.array([solved[row["I"]] for row in tables["load"]])
    names = ("PL", "QL", "IP", "IQ", "YP", "YQ")
    P, Q, IP, IQ, YP, YQ = (np.array([float(row[name]) for row in tables["load"]]) / case.base_power for name in names)
    drawn = P + IP * at + YP * at * at + 1j * (Q + IQ * at - YQ * at * at)
    units = [f"G{int(row['I'])}_{str(row['ID']).strip()}" for row in tables["generator"]]
    held = {int(row["I"]): float(row["VM"]) for row in tables["bus"]}
    tripped = units.index(UNIT) + 1
    at_work = [i for i, row in enumerate(tables["generator"], 1) if int(row["STAT"]) == 1 and i != tripped]
    return Prepared(str(path), held, drawn, tripped, at_work)


def run(prepared: Prepared, grid: Grid, step: float, **_twin: Any) -> TimedRun:  # noqa: ARG001
    """One run."""
    began = time.perf_counter()
    ss = andes.load(str(files()[0]), addfile=prepared.dyr, setup=False, no_output=True, default_config=True)
    ss.REECB1.reg.v[:], ss.REPCA1.ree.v[:] = ss.REGCA1.idx.v, ss.REECB1.idx.v
    numbers = [int(gen) for gen in ss.GENROU.gen.v]
    tripped = ss.GENROU.idx.v[numbers.index(prepared.tripped)]
    ss.add("Toggle", {"model": "GENROU", "dev": tripped, "t": FAULT_START - EVENT_DELAY})
    ss.setup()
    _put_right(ss, prepared)
    if not ss.PFlow.run():
        raise RuntimeError("the power flow does not converge")
    # Ours come in the order of the RAW, which numbers its generators.
    order = [numbers.index(number) for number in prepared.staying if number in numbers]
    return simulated(ss, step, began, order)


def _put_right(ss: Any, prepared: Prepared) -> None:
    """What ANDES has otherwise than the files, as `config/references/README.md` tells."""
    for gain in UNUSED:
        getattr(ss.REECB1, gain).v[:] = 0.0
    for part in (ss.Line.r, ss.Line.x):
        part.v[:] -= LINE_OFFSET
    for model in (ss.PV, ss.Slack):
        model.v0.v[:] = [prepared.held[bus] for bus in model.bus.v]
    for name, share in CURRENTS.items():
        setattr(ss.PQ.config, name, share)
    for names, power in ((("p0", "Ppf"), prepared.drawn.real), (("q0", "Qpf"), prepared.drawn.imag)):
        for name in names:
            getattr(ss.PQ, name).v[:] = power
