"""The case by pydae (generated C): its GENROU, which has no leakage reactance; trapezoidal rule, dense matrices."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from pydae.bps import BpsBuilder
from pydae.core import Builder, Model

from facts_damping_bench.grid import DURATION, FAULT_BUS, FAULT_END, FAULT_START, FAULT_X, RATE, Grid, TimedRun

if TYPE_CHECKING:
    from pathlib import Path

TOLERANCE = 1e-12  # of the sum of squares at which Newton's method ends
JUMPS, JUMP = 10, 1e-8  # steps in which the fault comes and goes, and each, s
ANGLE = 0.01  # 1/s, what ties the angle of the slack machine while the start is sought
DATA = {"X_d": "Xd", "X1d": "Xd1", "X2d": "Xd2", "X_q": "Xq", "X1q": "Xq1", "X2q": "Xq2", "R_a": "Ra", "H": "H"}
DATA |= {"T1d0": "Td01", "T2d0": "Td02", "T1q0": "Tq01", "T2q0": "Tq02", "D": "D"}


def _data(grid: Grid) -> dict[str, Any]:
    """The case as pydae takes it."""
    base = grid.base
    shunts = [
        {"bus": bus, "R_pu": (1 / y).real, "X_pu": (1 / y).imag, "S_mva": base} for bus, y in grid.admittance.items()
    ]
    return {
        "system": {"name": "bench", "S_base": base * 1e6},
        "buses": [{"name": bus, "P_W": 0.0, "Q_var": 0.0, "U_kV": kv} for bus, kv in grid.nominal.items()],
        "lines": [
            {"bus_j": x.a, "bus_k": x.b, "R_pu": x.r, "X_pu": x.x, "Bs_pu": x.charging, "S_mva": base}
            for x in grid.branches
        ],
        "shunts": shunts,
        "syns": [
            {"bus": m.bus, "name": m.name, "type": "genrou", "S_n": m.rating * 1e6, "F_n": grid.frequency}
            | {to: getattr(m, of) for to, of in DATA.items()}
            | {"K_delta": ANGLE if m.slack else 0.0, "K_sec": 0.0}
            for m in grid.machines
        ],
    }


def _swap(problem: dict[str, Any], grid: Grid) -> None:
    """What is given at the start and what is sought: V and P for the field voltage and the mechanical power."""
    slots = [str(symbol) for symbol in problem["y_ini_list"]]
    for m in grid.machines:
        known = {f"V_{m.bus}": (m.V, f"v_f_{m.name}")}
        if m.slack:
            known["omega_coi"] = (1.0, f"p_m_{m.name}")
        else:
            known[f"p_g_{m.name}"] = ((m.P or 0.0) / m.rating, f"p_m_{m.name}")
        for name, (value, sought) in known.items():
            slots[slots.index(name)] = sought
            problem["u_ini_dict"].pop(sought)
            problem["u_ini_dict"][name] = value
    problem["y_ini_list"] = slots


def prepare(grid: Grid, folder: Path) -> Any:  # noqa: ARG001 (it writes into the process's own)
    """Its equations as C, compiled with gcc."""
    builder = BpsBuilder(_data(grid))
    builder.uz_jacs = False
    builder.construct("bench")
    _swap(builder.sys_dict, grid)
    Builder(builder.sys_dict, target="ctypes", sparse=False).build()
    return Model("bench")


def _switch(model: Any, before: float, after: float) -> None:
    """Change the susceptance at the fault (p.u.) bit by bit in very short steps.

    Its Newton's method keeps the matrix of a step's begin, and does not bear the jump of the voltages at once; and its
    first step after an event has the slope before it.
    """
    step, model.Dt = model.Dt, JUMP
    for i in range(1, JUMPS + 1):
        model.run(model.t_start + JUMP, {f"b_shunt_{FAULT_BUS}": before + (after - before) * i / JUMPS})
    model.Dt = step
    model.t_start -= JUMPS * JUMP  # these steps are none of the run's
    model.step_counter -= JUMPS


def _guess(grid: Grid) -> dict[str, float]:
    """Where its search for the start begins: angles and currents as they are, EMFs about right."""
    guess = {f"V_{bus}": abs(v) for bus, v in grid.voltage.items()}
    guess |= {f"theta_{bus}": float(np.angle(v)) for bus, v in grid.voltage.items()}
    for m in grid.machines:
        current = (grid.power[m.name] / grid.voltage[m.bus]).conjugate() * grid.base / m.rating
        angle = float(np.angle(grid.voltage[m.bus] + (m.Ra + 1j * (m.Xq or 0.0)) * current))
        turned = current * np.exp(1j * (np.pi / 2 - angle))
        guess |= {f"delta_{m.name}": angle, f"i_d_{m.name}": turned.real, f"i_q_{m.name}": turned.imag}
        guess |= {f"p_m_{m.name}": 0.8, f"v_f_{m.name}": 1.8, f"q_g_{m.name}": 0.2, f"p_g_{m.name}": 0.8}
        guess |= {f"omega_{m.name}": 1.0, f"e1q_{m.name}": 0.9, f"e2q_{m.name}": 0.9}
        guess |= {f"e1d_{m.name}": 0.4, f"e2d_{m.name}": 0.5}
    slack = guess[f"delta_{grid.slack().name}"]  # the angle that all are counted from
    return {name: x - slack if name.startswith(("delta", "theta")) else x for name, x in guess.items()}


def run(prepared: Any, grid: Grid, step: float) -> TimedRun:
    """One run."""
    began = time.perf_counter()
    shunts = {f"g_shunt_{bus}": y.real for bus, y in grid.admittance.items()}
    shunts |= {f"b_shunt_{bus}": y.imag for bus, y in grid.admittance.items()}
    angle, sound = f"K_delta_{grid.slack().name}", shunts[f"b_shunt_{FAULT_BUS}"]
    prepared.itol, prepared.max_it, prepared.Dt, prepared.decimation = TOLERANCE, 50, step, round(1.0 / (RATE * step))
    if not prepared.ini({**shunts, angle: ANGLE}, _guess(grid)):
        raise RuntimeError("no steady state was found")
    prepared.set_value(angle, 0.0)
    ready = time.perf_counter()
    prepared.run(FAULT_START, {})
    _switch(prepared, sound, sound - 1.0 / FAULT_X)
    prepared.run(FAULT_END, {})
    _switch(prepared, sound - 1.0 / FAULT_X, sound)
    prepared.run(DURATION, {})
    ended = time.perf_counter()
    prepared.post()
    speeds = np.array([prepared.get_values(f"omega_{m.name}") for m in grid.machines]).T - 1.0
    return TimedRun(ready - began, ended - ready, np.array(prepared.Time), speeds)
