"""The case by DPsim (C++): static phasors, sixth-order machines of type b (Anderson and Fouad) behind a VBR."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

import dpsimpy
import numpy as np

from facts_damping_bench.grid import DURATION, FAULT_BUS, FAULT_END, FAULT_START, FAULT_X, RATE, Grid, TimedRun

if TYPE_CHECKING:
    from pathlib import Path

OPEN, CLOSED = 1e6, 1e-3  # ohm; further apart, and rounding in its network solution spoils the run
SMALL = 1e-12  # S, where a line has none


def prepare(grid: Grid, folder: Path) -> None:  # noqa: ARG001 (what every program's module takes)
    """Its logs go into the folder."""
    dpsimpy.Logger.set_log_dir(str(folder))


def _network(grid: Grid, nodes: dict[str, Any]) -> list[Any]:
    """Lines, transformers, loads and shunts as SI figures: V, ohm, H, F, S."""
    sp, omega, off, parts = dpsimpy.sp.ph1, 2 * math.pi * grid.frequency, dpsimpy.LogLevel.off, []
    for x in grid.branches:
        if x.transformer:  # the higher voltage is its first end
            part, z = sp.Transformer(x.name, x.name, off, with_resistive_losses=False), grid.impedance(x.b)
            high, low = grid.nominal[x.b] * 1e3, grid.nominal[x.a] * 1e3
            part.set_parameters(high, low, high / low, 0.0, x.r * z, x.x * z / omega)
            part.connect([nodes[x.b], nodes[x.a]])
        else:
            z = grid.impedance(x.a)
            part = sp.PiLine(x.name, off)
            part.set_parameters(R=x.r * z, L=x.x * z / omega, C=x.charging / z / omega, G=SMALL)
            part.connect([nodes[x.a], nodes[x.b]])
        parts.append(part)
    for bus, y in grid.admittance.items():
        z, resistor = grid.impedance(bus), sp.Resistor(f"resistor_{bus}", off)
        resistor.set_parameters(z / y.real)
        if y.imag > 0:
            reactor = sp.Capacitor(f"capacitor_{bus}", off)
            reactor.set_parameters(y.imag / z / omega)
        else:
            reactor = sp.Inductor(f"inductor_{bus}", off)
            reactor.set_parameters(-z / y.imag / omega)
        for part in (resistor, reactor):
            part.connect([dpsimpy.sp.SimNode.gnd, nodes[bus]])
            parts.append(part)
    return parts


def _machine(grid: Grid, m: Any, nodes: dict[str, Any]) -> Any:
    generator, power = dpsimpy.sp.ph1.SynchronGenerator6bOrderVBR(m.name, dpsimpy.LogLevel.off), grid.power[m.name]
    generator.set_operational_parameters_per_unit(
        *(m.rating * 1e6, grid.nominal[m.bus] * 1e3, grid.frequency, m.H, m.Xd, m.Xq, m.Xl, m.Xd1, m.Xq1),
        *(m.Td01, m.Tq01, m.Xd2, m.Xq2, m.Td02, m.Tq02),
    )
    volts = grid.voltage[m.bus] * grid.nominal[m.bus] * 1e3
    generator.set_initial_values(power * grid.base * 1e6, power.real * grid.base * 1e6, volts)
    generator.connect([nodes[m.bus]])
    return generator


def run(prepared: None, grid: Grid, step: float) -> TimedRun:  # noqa: ARG001
    """One run, from the power flow given to it; called a step at a time, which spares its log files."""
    began = time.perf_counter()
    nodes = {}
    for bus, kv in grid.nominal.items():
        nodes[bus] = dpsimpy.sp.SimNode(bus, dpsimpy.PhaseType.Single)
        nodes[bus].set_initial_voltage(grid.voltage[bus] * kv * 1e3)
    machines = [_machine(grid, m, nodes) for m in grid.machines]
    fault = dpsimpy.sp.ph1.Switch("fault", dpsimpy.LogLevel.off)
    fault.set_parameters(OPEN, CLOSED, closed=False)
    behind = dpsimpy.sp.SimNode("fault", dpsimpy.PhaseType.Single)
    fault.connect([behind, nodes[FAULT_BUS]])
    reactor = dpsimpy.sp.ph1.Inductor("reactor", dpsimpy.LogLevel.off)
    reactor.set_parameters(FAULT_X * grid.impedance(FAULT_BUS) / (2 * math.pi * grid.frequency))
    reactor.connect([dpsimpy.sp.SimNode.gnd, behind])
    parts = [*machines, *_network(grid, nodes), fault, reactor]
    sim = dpsimpy.Simulation("bench", dpsimpy.LogLevel.off)
    sim.set_system(dpsimpy.SystemTopology(grid.frequency, [*nodes.values(), behind], parts))
    sim.set_domain(dpsimpy.Domain.SP)
    sim.set_time_step(step)
    sim.set_final_time(DURATION + 1.0)
    sim.do_system_matrix_recomputation(True)
    # Half a step before the instant at which it switches, so that no rounding of the time decides.
    sim.add_event(dpsimpy.event.SwitchEvent(FAULT_START - step / 2, fault, True))
    sim.add_event(dpsimpy.event.SwitchEvent(FAULT_END - step / 2, fault, False))
    sim.start()
    speeds = [m.attr("w_r") for m in machines]
    every, deviations = round(1.0 / (RATE * step)), [[0.0] * len(machines)]
    ready = time.perf_counter()
    for _ in range(round(DURATION * RATE)):
        for _ in range(every):
            sim.next()
        deviations.append([speed.get() - 1.0 for speed in speeds])
    ended = time.perf_counter()
    return TimedRun(ready - began, ended - ready, np.arange(len(deviations)) / RATE, np.array(deviations))
