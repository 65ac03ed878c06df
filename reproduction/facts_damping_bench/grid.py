"""The case that every program runs: Kundur's example 12.6 with a fault; the same figures for all.

20 s of `kundur_12_6`: four sixth-order machines, constant field voltage and mechanical power, loads of constant
impedance. From 1.0 to 1.1 s a three-phase fault at B9, through a reactance of 0.02 p.u. (11 ohm): not every program
knows a bolted one. Instants, steps and the fault's ends fall together.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from facts_damping.case.loading import load_case
from facts_damping.plant.grid import power_flow

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.parameters.plant.machines import Machine

SYSTEM = "kundur_12_6"
DURATION = 20.0  # s
FAULT_BUS, FAULT_START, FAULT_END, FAULT_X = "B9", 1.0, 1.1, 0.02  # s, s, p.u. of 100 MVA
LOAD = 967.0  # MW at B7, as in the file
RATE = 50  # 1/s, instants at which speeds are compared; every step is a part of 20 ms


class Shown(NamedTuple):
    """What pages say of a case, and how fine its references are."""

    name: str  # on the axis of the picture
    text: str
    event: str
    finer: int = 8  # times finer than the finest step is a program's own reference


def fault_at(bus: str) -> str:
    """The fault in words."""
    return f"three-phase fault at {bus} through j {FAULT_X:g} p.u. from {FAULT_START:g} to {FAULT_END:g} s"


SHOWN = Shown(SYSTEM, SYSTEM, fault_at(FAULT_BUS))


class TimedRun(NamedTuple):
    """What a program made of the case: s of set-up, s of the run in time alone, speeds less 1 (p.u.) at times (s)."""

    setup_s: float
    wall_s: float
    time_s: NDArray[np.float64]
    speeds: NDArray[np.float64]  # (times, machines)


class Branch(NamedTuple):
    """A line or transformer, p.u. of the system base; b: all of its charging."""

    name: str
    a: str
    b: str
    r: float
    x: float
    charging: float
    transformer: bool


class Grid(NamedTuple):
    """The case as plain figures, p.u. of the system base, with the power flow solved."""

    load: float  # scale of the load at B7
    base: float  # MVA
    frequency: float  # Hz
    nominal: dict[str, float]  # kV by bus
    voltage: dict[str, complex]
    branches: list[Branch]
    loads: list[tuple[str, str, complex]]  # name, bus, P + j Q drawn at the power flow's voltage
    shunts: list[tuple[str, str, float]]  # name, bus, Q given at 1 p.u.
    admittance: dict[str, complex]  # of loads and shunts, by bus that has any
    machines: list[Machine]
    power: dict[str, complex]  # of machines, at their terminals

    def impedance(self, bus: str) -> float:
        """Impedance that is 1 p.u. at a bus, ohm."""
        return self.nominal[bus] ** 2 / self.base

    def slack(self) -> Machine:
        """The machine that balances the power flow."""
        return next(m for m in self.machines if m.slack)


def case(
    step: float, load: float = 1.0, model: str = "genrou", more: tuple[str, ...] = (), end: float = DURATION
) -> Case:
    """Our case with a step (s), the load at B7 scaled, another machine model, more fields of `--set`."""
    took = FAULT_END - FAULT_START
    fault = f"{{time: {FAULT_START}, kind: fault, bus: {FAULT_BUS}, duration: {took:g}, x: {FAULT_X}}}"
    sets = [f"system={SYSTEM}", f"scenario=[{fault}]", f"duration={end}", "devices=[]", "controllers=[]"]
    sets += [f"frame_rate={RATE}", f"system.step={step}", f"system.loads.0.P={LOAD * load}"]
    machines = [f"system.machines.{i}.{field}" for field in (f"model={model}", *more) for i in range(4)]
    return load_case(None, sets + machines)


def grid(load: float = 1.0) -> Grid:
    """The case as plain figures, the load at B7 scaled."""
    system = case(0.01, load).system
    flow, base = power_flow.solve(system), system.base_power
    branches = [
        Branch(x.name, x.from_bus, x.to_bus, x.r * x.length, x.x * x.length, x.b * x.length, transformer=False)
        for x in system.lines
    ]
    branches += [
        Branch(x.name, x.from_bus, x.to_bus, x.r * base / x.rating, x.x * base / x.rating, 0.0, transformer=True)
        for x in system.transformers
    ]
    voltage = {name: complex(v) for name, v in zip(flow.names, flow.voltage, strict=True)}
    admittance: dict[str, complex] = {}
    for x in system.loads:
        drawn = complex(x.P, -x.Q) / base / abs(voltage[x.bus]) ** 2
        admittance[x.bus] = admittance.get(x.bus, 0j) + drawn
    for y in system.shunts:
        admittance[y.bus] = admittance.get(y.bus, 0j) + 1j * y.Q / base
    return Grid(
        load,
        base,
        system.frequency,
        {bus.name: bus.nominal_voltage for bus in system.buses},
        voltage,
        branches,
        [(x.name, x.bus, complex(x.P, x.Q) / base) for x in system.loads],
        [(x.name, x.bus, x.Q / base) for x in system.shunts],
        admittance,
        list(system.machines),
        {m.name: complex(flow.generation[m.name]) for m in system.machines},
    )


def instants(end: float = DURATION) -> NDArray[np.float64]:
    """Instants after the fault at which speeds are compared, s."""
    return np.arange(round(FAULT_END * RATE) + 1, round(end * RATE) + 1) / RATE


def swings(timed_run: TimedRun, end: float = DURATION) -> NDArray[np.float64]:
    """Speeds less their mean at the instants, p.u. (machines, instants); between a program's own by a spline."""
    free = timed_run.time_s > FAULT_END + 1e-4
    free &= np.diff(timed_run.time_s, prepend=-1.0) > 1e-9  # some programs say an instant twice
    speeds = CubicSpline(timed_run.time_s[free], timed_run.speeds[free])(instants(end)).T
    return np.asarray(speeds - speeds.mean(axis=0))
