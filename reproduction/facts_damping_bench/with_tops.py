"""The case by TOPS (Python): its machine model without stator resistance, modified Euler's method."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
import tops.dynamic as tops
from tops import solvers

from facts_damping_bench.grid import DURATION, FAULT_BUS, FAULT_END, FAULT_START, FAULT_X, RATE, Grid, TimedRun

if TYPE_CHECKING:
    from pathlib import Path

DATA = {"S_n": "rating", "V": "V", "H": "H", "X_d": "Xd", "X_q": "Xq", "X_d_t": "Xd1", "X_q_t": "Xq1"}
DATA |= {"X_d_st": "Xd2", "X_q_st": "Xq2"}
DATA |= {"T_d0_t": "Td01", "T_q0_t": "Tq01", "T_d0_st": "Td02", "T_q0_st": "Tq02"}


def prepare(grid: Grid, folder: Path) -> None:
    """Nothing."""


def _tables(grid: Grid) -> dict[str, Any]:
    """The case as TOPS takes it: a list a kind, names of columns first."""
    lines: list[list[Any]] = [["name", "from_bus", "to_bus", "length", "S_n", "V_n", "unit", "R", "X", "B"]]
    trafos: list[list[Any]] = [["name", "from_bus", "to_bus", "S_n", "V_n_from", "V_n_to", "R", "X"]]
    for x in grid.branches:
        a, b = grid.nominal[x.a], grid.nominal[x.b]
        if x.transformer:
            trafos.append([x.name, x.a, x.b, grid.base, a, b, x.r, x.x])
        else:
            lines.append([x.name, x.a, x.b, 1, grid.base, a, "p.u.", x.r, x.x, x.charging])
    base = grid.base
    loads = [[name, bus, s.real * base, s.imag * base, "Z"] for name, bus, s in grid.loads]
    shunts = [[name, bus, grid.nominal[bus], q * base, "Z"] for name, bus, q in grid.shunts]
    machines = []
    for m in grid.machines:
        power = grid.power[m.name].real * base
        damping = m.D - power / m.rating  # its mechanical power is constant; with this the torque is
        data = [getattr(m, of) for of in DATA.values()]
        machines.append([m.name, m.bus, grid.nominal[m.bus], power, damping, *data])
    return {
        "base_mva": base,
        "f": grid.frequency,
        "slack_bus": grid.slack().bus,
        "buses": [["name", "V_n"], *([name, kv] for name, kv in grid.nominal.items())],
        "lines": lines,
        "transformers": trafos,
        "loads": [["name", "bus", "P", "Q", "model"], *loads],
        "shunts": [["name", "bus", "V_n", "Q", "model"], *shunts],
        "generators": {"GEN": [["name", "bus", "V_n", "P", "D", *DATA], *machines]},
    }


def run(prepared: None, grid: Grid, step: float) -> TimedRun:  # noqa: ARG001 (what every program's module takes)
    """One run; after an event voltages are solved anew, which its solver leaves to who calls it."""
    began = time.perf_counter()
    ps = tops.PowerSystemModel(model=_tables(grid))
    ps.init_dyn_sim()
    solver = solvers.ModifiedEulerDAE(ps.state_derivatives, ps.solve_algebraic, 0, ps.x_0.copy(), 1e9, max_step=step)
    machines, bus = ps.gen["GEN"], list(grid.nominal).index(FAULT_BUS)
    fault = {round(FAULT_START / step): -1j / FAULT_X, round(FAULT_END / step): 0.0}
    every, speeds = round(1.0 / (RATE * step)), []
    ready = time.perf_counter()
    for k in range(round(DURATION / step) + 1):
        if k in fault:
            ps.y_bus_red_mod[bus, bus] = fault[k]
            solver.v[:] = ps.solve_algebraic(solver.t, solver.x)
        if k % every == 0:
            speeds.append(machines.speed(solver.x, solver.v).copy())
        solver.step()
    ended = time.perf_counter()
    return TimedRun(ready - began, ended - ready, np.arange(len(speeds)) / RATE, np.array(speeds))
