"""The case by RAMSES of STEPSS (Fortran): machines by Park's equations; trapezoidal rule."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import stepss

from facts_damping_bench.grid import DURATION, FAULT_BUS, FAULT_END, FAULT_START, FAULT_X, RATE, Grid, TimedRun

if TYPE_CHECKING:
    from pathlib import Path

TOLERANCE = 1e-6  # of Newton's method, p.u.
SHORTEST = 1e-6  # s, of a step
SETTINGS = (
    "$S_BASE {base} ;",
    "FNOM {frequency} ;",
    "$OMEGA_REF SYN ;",
    "$SCHEME DE ;",
    "$NEWTON_TOLER {tolerance} {tolerance} {tolerance} ;",
    "$PLOT_STEP {every} ;",
    "$NB_THREADS 1 ;",
    "$SKIP_CONV F ;",
    "$FULL_UPDATE F ;",
    "$CALL_GP F ;",
    "$DISP_PROF F ;",
)


def prepare(grid: Grid, folder: Path) -> Path:  # noqa: ARG001 (what every program's module takes)
    """Its files go into the folder."""
    return folder


class Windings(NamedTuple):
    """An axis of a machine: mutual inductance, two rotor windings, p.u."""

    La: float
    L1: float
    L2: float
    R1: float
    R2: float


def _windings(grid: Grid, xl: Any, x: Any, x1: Any, x2: Any, t1: Any, t2: Any) -> Windings:
    """The windings to which GENROU's equations are equal; RAMSES would convert the same figures to others."""
    La, a1, a2, omega = x - xl, x1 - xl, x2 - xl, 2.0 * math.pi * grid.frequency
    L1, L2 = 1.0 / (1.0 / a1 - 1.0 / La), 1.0 / (1.0 / a2 - 1.0 / a1)
    return Windings(La, L1, L2, (La + L1) / (omega * t1), (L2 + a1) / (omega * t2))


def _records(grid: Grid) -> list[str]:
    """The case as RAMSES takes it: a record a line."""
    base, lines = grid.base, []
    for bus, kv in grid.nominal.items():
        v = grid.voltage[bus]
        lines += [f"BUS {bus} {kv} ;", f"LFRESV {bus} {abs(v):.15g} {np.angle(v):.15g} ;"]
    for x in grid.branches:
        z = grid.impedance(x.a)
        if x.transformer:
            lines.append(f"TRANSFO {x.name} {x.a} {x.b} {100 * x.r:.12g} {100 * x.x:.12g} 0. 0. 100. 0. {base} 1 ;")
        else:
            half = 1e6 * x.charging / z / 2
            lines.append(f"LINE {x.name} {x.a} {x.b} {x.r * z:.12g} {x.x * z:.12g} {half:.12g} 0. 1 ;")
    for name, bus, power in grid.loads:
        lines.append(f"IMPLOAD {name} {bus} 0. 0. {-power.real * base} {-power.imag * base} ;")
    lines += [f"SHUNT {name} {bus} {q * base} 1 ;" for name, bus, q in grid.shunts]
    for m in grid.machines:
        d = _windings(grid, m.Xl, m.Xd, m.Xd1, m.Xd2, m.Td01, m.Td02)
        q = _windings(grid, m.Xl, m.Xq, m.Xq1, m.Xq2, m.Tq01, m.Tq02)
        parts = [m.Xl, d.La, d.L1, d.L2, q.La, q.L1, q.L2, 0.0, 6.0, m.Ra, d.R1, d.R2, q.R1, q.R2]
        lines.append(f"SYNC_MACH {m.name} {m.bus} 1. 1. 0. 0. {m.rating} {m.rating} {m.H} {m.D} {d.La:.12g}")
        lines += [f"RL {' '.join(f'{part:.12g}' for part in parts)}", "EXC CONSTANT", "TOR CONSTANT ;"]
    return lines


def run(path: Path, grid: Grid, step: float) -> TimedRun:
    """One run, from the power flow given to it."""
    began = time.perf_counter()
    z = FAULT_X * grid.impedance(FAULT_BUS)
    figures = {"base": grid.base, "frequency": grid.frequency, "tolerance": TOLERANCE, "every": 0.999 / RATE}
    files = {
        "case.dat": [*_records(grid), *(text.format(**figures) for text in SETTINGS)],
        "fault.dst": [
            f"0.0 CONTINUE SOLVER TR {step} {SHORTEST} 0. ALL",
            f"{FAULT_START} FAULT BUS {FAULT_BUS} 0. {z}",
            f"{FAULT_END} CLEAR BUS {FAULT_BUS}",
            f"{DURATION} STOP",
        ],
        "observed.dat": ["SYNC *"],
    }
    for name, lines in files.items():
        (path / name).write_text("\n".join(lines) + "\n")
    asked = stepss.cfg()
    asked.addData("case.dat")
    asked.addDst("fault.dst")
    asked.addObs("observed.dat")
    asked.addTrj("speeds.trj")
    asked.addOut("run.trace")
    ram = stepss.sim()
    ram.execSim(asked, 0.0)
    ready = time.perf_counter()
    ram.contSim(ram.getInfTime())
    ended = time.perf_counter()
    extractor = stepss.extractor("speeds.trj")
    curves = [extractor.getSync(m.name).S for m in grid.machines]
    return TimedRun(ready - began, ended - ready, np.array(curves[0].time), np.array([c.value for c in curves]).T - 1.0)
