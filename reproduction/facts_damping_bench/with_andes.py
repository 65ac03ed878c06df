"""The case by ANDES (CURENT, Python): GENROU, trapezoidal rule by Newton's method."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import andes
import numpy as np

from facts_damping_bench.grid import DURATION, FAULT_BUS, FAULT_END, FAULT_START, FAULT_X, Grid, TimedRun

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

LINE_OFFSET = 1e-8  # p.u., what ANDES adds to r and x of a line
EVENT_DELAY = 5e-5  # s, by which events act late: half of ANDES's step of 0.1 ms after an event has the slope before it
TOLERANCE = 1e-6  # of Newton's method in a step
DATA = {"ra": "Ra", "xl": "Xl", "xd": "Xd", "xd1": "Xd1", "xd2": "Xd2", "xq": "Xq", "xq1": "Xq1", "xq2": "Xq2"}
TIMES = {"Td10": "Td01", "Td20": "Td02", "Tq10": "Tq01", "Tq20": "Tq02"}


def prepare(grid: Grid, folder: Path) -> None:  # noqa: ARG001 (what every program's module takes)
    """Its equations as code, which it keeps in the user's folder."""
    andes.config_logger(stream_level=50)


def build(grid: Grid) -> Any:
    """The system with its power flow solved."""
    ss = andes.System(no_output=True, default_config=True)
    ss.config.mva = grid.base
    for name, kv in grid.nominal.items():
        ss.add("Bus", idx=name, name=name, Vn=kv)
    for x in grid.branches:
        at = {"bus1": x.a, "bus2": x.b, "Sn": grid.base, "Vn1": grid.nominal[x.a], "Vn2": grid.nominal[x.b]}
        ss.add("Line", idx=x.name, **at, r=x.r - LINE_OFFSET, x=x.x - LINE_OFFSET, b=x.charging)
    for name, bus, power in grid.loads:
        ss.add("PQ", idx=name, bus=bus, Vn=grid.nominal[bus], p0=power.real, q0=power.imag)
    for name, bus, q in grid.shunts:
        ss.add("Shunt", idx=name, bus=bus, Sn=grid.base, Vn=grid.nominal[bus], b=q)
    for m in grid.machines:
        static = {"idx": f"static {m.name}", "bus": m.bus, "Sn": m.rating, "Vn": grid.nominal[m.bus], "v0": m.V}
        if m.slack:
            ss.add("Slack", a0=np.deg2rad(m.angle), **static)
        else:
            ss.add("PV", p0=(m.P or 0.0) / grid.base, **static)
        data = {to: getattr(m, of) for to, of in (DATA | TIMES).items()}
        at = {"bus": m.bus, "gen": static["idx"], "Sn": m.rating, "Vn": grid.nominal[m.bus], "fn": grid.frequency}
        ss.add("GENROU", idx=m.name, **at, M=2 * m.H, D=m.D, **data)
    ss.add("Fault", bus=FAULT_BUS, tf=FAULT_START - EVENT_DELAY, tc=FAULT_END - EVENT_DELAY, rf=0.0, xf=FAULT_X)
    constant_impedances(ss)
    ss.setup()
    if not ss.PFlow.run():
        raise RuntimeError("the power flow does not converge")
    return ss


def constant_impedances(ss: Any) -> None:
    """Loads are impedances in time."""
    config = ss.PQ.config
    config.pq2z, config.p2p, config.p2i, config.p2z = 0, 0.0, 0.0, 1.0
    config.q2q, config.q2i, config.q2z = 0.0, 0.0, 1.0


def run(prepared: None, grid: Grid, step: float) -> TimedRun:  # noqa: ARG001
    """One run."""
    began = time.perf_counter()
    ss = build(grid)
    return simulated(ss, step, began)


def simulated(ss: Any, step: float, began: float, order: Sequence[int] | None = None) -> TimedRun:
    """A run in time of a system with its power flow; `began`: instant of the clock, s; `order`: of GENROU, GENCLS."""
    config = ss.TDS.config
    config.tf, config.tstep, config.fixt, config.tol = DURATION, step, 1, TOLERANCE
    config.no_tqdm, config.criteria = 1, 0
    ss.TDS.init()
    ready = time.perf_counter()
    if not ss.TDS.run():
        raise RuntimeError("the simulation failed")
    ended = time.perf_counter()
    ss.dae.ts.unpack()
    speeds = np.concatenate([np.array(model.omega.a, int) for model in (ss.GENROU, ss.GENCLS)])
    speed_deviation = np.array(ss.dae.ts.x)[:, speeds if order is None else speeds[order]] - 1.0
    return TimedRun(ready - began, ended - ready, np.array(ss.dae.ts.t), speed_deviation)
