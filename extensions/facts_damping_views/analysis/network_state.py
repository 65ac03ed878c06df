"""Voltages and currents where no PMU is, from those where one is and the data of the network.

All deviations from the operating point follow from those x of the currents that units, loads and devices inject:

    dV = Z x,    Z = (Y + loads as impedances)^-1,    measurements m = H x + noise

The smallest x, each weighed by the rating behind it, that explains the measurements is

    x = T H* (H T H* + S)^-1 m

with the squares of the ratings in T and of the measurements' errors in S: the conditional mean of Gaussian variables. A
load's part beside its impedance counts with 0.3 of its power. The operating point is the system's power flow.

Source: F. Schweppe, J. Wildes, Power system static-state estimation, IEEE Trans. PAS 89, 1970; with prior variances: C.
Rasmussen, C. Williams, Gaussian processes for machine learning, 2006, (2.23).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.devices.base import Parallel, Transmission
from facts_damping.parameters.plant.pmus import Pmu
from facts_damping.plant.grid import network, power_flow
from facts_damping_views.analysis.energy_flow import PRESENT, Phasors

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Complex1, Complex2, Float1
    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.grid.network import Branch

LOAD = 0.3  # of a load's power: size of what it injects beside its impedance
DEVICE, INFINITE = 1.0, 100.0  # p.u., sizes of what a device or an infinite bus injects
ERROR = 1e-3  # of measurements, relative to the sizes above; currents relative to themselves, at least 0.01 p.u.


class Grid(NamedTuple):
    """A grid for the estimation: operating point, response (buses, sources) and sizes (sources,), p.u."""

    buses: dict[str, int]  # indices
    sections: dict[str, Branch]
    voltage: Complex1  # (buses,)
    response: Complex2
    size: Float1
    units: dict[str, int]  # index among the sources
    currents: dict[str, complex]  # of units


def grid(system: System, out: Collection[str] = ()) -> Grid:
    """Response of a grid's voltages to what is injected; `out`: branches and units out of service."""
    flow = power_flow.solve(system)
    topology = network.Topology(lines_out=frozenset(out))
    index = {name: i for i, name in enumerate(flow.names)}
    present = network.branches(system, topology)
    present += [network.device_section(d, network.at_rest(d)) for d in network.series_devices(system)]
    magnitude = dict(zip(flow.names, np.abs(flow.voltage).tolist(), strict=True))
    shunts = network.shunts(system, topology, magnitude)
    entries = network.admittance(index, present, shunts.items())
    matrix = np.zeros((len(index), len(index)), complex)
    matrix[entries.row, entries.column] = entries.value
    units = [unit for unit in system.units if unit.name not in out]
    parallel = [d for d in system.devices if isinstance(d, Parallel | Transmission)]
    sources = [(unit.bus, unit.rating / system.base_power) for unit in units]
    sources += [(x.bus, LOAD * abs(complex(x.P, x.Q)) / system.base_power) for x in system.loads]
    sources += [(bus, DEVICE) for d in parallel for bus in d.buses]
    sources += [(row.bus, INFINITE) for row in system.infinite_buses]
    at = np.zeros((len(index), len(sources)))
    at[[index[bus] for bus, _ in sources], np.arange(len(sources))] = 1.0
    currents = {u.name: (flow.generation[u.name] / flow.by_bus[u.bus]).conjugate() for u in units}
    return Grid(
        index,
        {branch.name: branch for branch in present},
        flow.voltage,
        np.linalg.solve(matrix, at.astype(complex)),
        np.array([size for _, size in sources]),
        {unit.name: i for i, unit in enumerate(units)},
        currents,
    )


def _flow_row(of: Grid, pmu: Pmu) -> Complex1:
    """Current of a PMU at a bus as a sum over voltages, (buses,)."""
    row = np.zeros(len(of.voltage), complex)
    for name in pmu.branches:
        if (branch := of.sections.get(name)) is not None:
            end = 0 if branch.from_bus == pmu.bus else 1
            row[of.buses[branch.from_bus]] += branch.admittance[end, 0]
            row[of.buses[branch.to_bus]] += branch.admittance[end, 1]
    return row


def _gain(of: Grid, pmus: Sequence[Pmu], at: Sequence[int]) -> Complex2:
    """What is injected (sources,) by what the PMUs at buses `at` measure, their voltages, then their currents."""
    rows: list[Complex1] = [of.response[bus] for bus in at]
    currents: list[float] = []
    for pmu in pmus:
        if pmu.machine is not None:
            rows.append(np.eye(len(of.size), dtype=np.complex128)[of.units[pmu.machine]])
            currents.append(abs(of.currents[pmu.machine]))
        else:
            rows.append(_flow_row(of, pmu) @ of.response)
            currents.append(float(abs(_flow_row(of, pmu) @ of.voltage)))
    h = np.array(rows)
    errors = ERROR * np.concatenate([np.ones(len(pmus)), np.maximum(currents, 0.01)])
    spread = (of.size**2)[:, None] * h.conj().T
    return np.asarray(spread @ np.linalg.inv(h @ spread + np.diag(errors**2)))


def extended(system: System, measured: Phasors, more: Sequence[Pmu], out: Collection[str] = ()) -> Phasors:
    """What the PMUs of a system measure, and what PMUs at further buses would: columns behind those of the system."""
    of = grid(system, out)
    there = np.isfinite(measured.voltage * measured.current).mean(axis=0) >= PRESENT
    pmus = [
        (s, pmu) for s, pmu in enumerate(system.pmus) if there[s] and (pmu.machine is None or pmu.machine in of.units)
    ]
    columns, at = [s for s, _ in pmus], [of.buses[system.pmu_buses()[pmu.name]] for _, pmu in pmus]
    gain, rested = _gain(of, [pmu for _, pmu in pmus], at), of.voltage[at]
    time_s = np.nanmedian(measured.time_s, axis=1)
    voltage, current = (_filled(time_s, values[:, columns]) for values in (measured.voltage, measured.current))
    turn = np.exp(1j * _rotation(voltage, rested))[:, None]
    readings = np.hstack([voltage, current]) / turn
    deviation = (readings - readings.mean(axis=0)) @ gain.T  # (frames, sources)
    volts, amperes = [], []
    everywhere = of.voltage + deviation @ of.response.T
    for pmu in more:
        volts.append(everywhere[:, of.buses[str(pmu.bus)]] * turn[:, 0])
        amperes.append(everywhere @ _flow_row(of, pmu) * turn[:, 0])
    times = np.repeat(time_s[:, None], len(more), axis=1)
    return Phasors(
        np.hstack([measured.time_s, times]),
        np.column_stack([measured.voltage, *volts]),
        np.column_stack([measured.current, *amperes]),
    )


def _filled(time_s: Float1, values: NDArray[np.complex128]) -> Complex2:
    """Values with missing frames filled by straight lines in polar coordinates."""
    columns = []
    for column in values.T:
        ok = np.isfinite(column)
        size = np.interp(time_s, time_s[ok], np.abs(column[ok]))
        columns.append(size * np.exp(1j * np.interp(time_s, time_s[ok], np.unwrap(np.angle(column[ok])))))
    return np.column_stack(columns)


def _rotation(voltage: Complex2, rested: Complex1) -> Float1:
    """Common angle of voltages against those at rest over time, rad: the mean over places."""
    return np.asarray(np.unwrap(np.angle((voltage * (rested.conj() / np.abs(rested) ** 2)).sum(axis=1))))


def at_borders(areas: Mapping[str, str], branches: Mapping[str, tuple[str, str]]) -> list[Pmu]:
    """PMUs that there would have to be at branches between areas; `areas`: of buses; `branches`: their buses."""
    return [
        Pmu(name=f"{name}.border", bus=a, branches=[name])
        for name, (a, b) in branches.items()
        if areas.get(a) != areas.get(b)
    ]
