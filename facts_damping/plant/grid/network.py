"""The network `I = Y V`: branches, switching state, admittance matrix, islands.

A `Topology` is the switching state: components in service, active faults, brakes, scale of each load. After an event
the admittance matrix is built anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from facts_damping.devices.base import Series
from facts_damping.errors import InputError
from facts_damping.numerics.matrices import parts
from facts_damping.numerics.phasors import line_factors, over, polar, times
from facts_damping.plant.grid.sparse import Triplets, summed

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Complex2
    from facts_damping.parameters.plant.grid import Line, Transformer
    from facts_damping.parameters.plant.system import System

SECTIONS = 4096  # lines and transformers whose two-ports a process keeps: those of a sweep's grids are mostly the same


@dataclass(frozen=True)
class FaultPlace:
    """Location of a fault: at a bus, or on a line at a fraction of its length from the first bus."""

    bus: str | None
    line: str | None
    location: float = 0.5


@dataclass(frozen=True)
class Topology:
    """The switching state of the network; the default is the state before the first event."""

    lines_out: frozenset[str] = frozenset()
    faults: Mapping[FaultPlace, complex] = field(default_factory=dict)  # place: impedance, p.u.; 0 = bolted
    load_scale: Mapping[str, float] = field(default_factory=dict)
    machines_out: frozenset[str] = frozenset()
    brakes: Mapping[str, float] = field(default_factory=dict)  # bus: conductance, p.u.


@dataclass(frozen=True)
class Branch:
    """A two-port between buses: `[I_from, I_to] = Y [V_from, V_to]`, p.u. on the system base."""

    name: str
    from_bus: str
    to_bus: str
    admittance: NDArray[np.complex128]


@lru_cache(maxsize=SECTIONS)
def line_section(line: Line, model: str, fraction: float = 1.0) -> Complex2:
    """Admittance two-port of a fraction of a line, shape (2, 2), p.u.

    pi: series z l, shunts y l / 2. distributed: series z l sinh(g l) / (g l), shunts y l / 2
    tanh(g l / 2) / (g l / 2), with g l = sqrt(z y) l (Kundur 1994, 6.1.4).
    """
    series = complex(line.r, line.x) * line.length * fraction
    shunt = 1j * line.b * line.length * fraction
    if model == "distributed" and series * shunt != 0.0:  # zero charging has no distributed effect
        of_series, of_shunt = line_factors(complex(times(series, shunt)))
        series, shunt = complex(times(series, of_series)), complex(times(shunt, of_shunt))
    return two_port(series, shunt / 2, shunt / 2)


def two_port(series: complex, shunt_from: complex, shunt_to: complex) -> Complex2:
    """Admittance two-port of a pi section: series impedance, shunt admittances, shape (2, 2)."""
    y = complex(over(1.0, series))
    return np.array([[y + shunt_from, -y], [-y, y + shunt_to]])


@lru_cache(maxsize=SECTIONS)
def transformer_section(transformer: Transformer, base_power: float) -> Complex2:
    """Admittance two-port of a transformer, shape (2, 2), p.u. on the system base.

    An ideal transformer of ratio t = tap exp(j shift) at the first bus, the series impedance behind it:
    [[y / |t|^2, -y / conj(t)], [-y / t, y]]. The magnetising branch is at the first bus: all leakage is on the other
    side (thesis A.2: L1 = 0).
    """
    ratio = transformer.rating / base_power
    magnetising = 0j
    if transformer.magnetising_r is not None:
        magnetising += ratio / transformer.magnetising_r
    if transformer.magnetising_x is not None:
        magnetising += -1j * (ratio / transformer.magnetising_x)
    y = complex(over(ratio, complex(transformer.r, transformer.x)))
    t = complex(polar(transformer.tap, math.radians(transformer.phase_shift)))
    series = y / (transformer.tap * transformer.tap)
    return np.array([[series + magnetising, -over(y, t.conjugate())], [-over(y, t), y]])


def device_section(device: Series, series: complex) -> Branch:
    """The branch of a series device as an impedance, p.u."""
    from_bus, to_bus = device.ends
    return Branch(device.name, from_bus, to_bus, two_port(series, 0, 0))


def at_rest(device: Series, lost: float = 0.0) -> complex:
    """Impedance of a series device at rest with a resistance equivalent to its losses, p.u."""
    resistance = device.rs + lost
    return complex(resistance, device.reactance) if device.reactance != 0.0 else resistance


def branches(system: System, topology: Topology) -> list[Branch]:
    """Lines and transformers in service, p.u.; a faulted line is two sections, joined at a bus `line:fault`."""
    sections = []
    faulted = {place.line: place for place in topology.faults if place.line is not None}
    for line in system.lines:
        if line.name in topology.lines_out:
            continue
        place = faulted.get(line.name)
        if place is None:
            sections.append(Branch(line.name, line.from_bus, line.to_bus, line_section(line, system.line_model)))
            continue
        middle = fault_bus(line.name)
        near, far = (line_section(line, system.line_model, part) for part in (place.location, 1 - place.location))
        sections.append(Branch(line.name, line.from_bus, middle, near))
        sections.append(Branch(line.name, middle, line.to_bus, far))
    for transformer in system.transformers:
        if transformer.name not in topology.lines_out:
            section = transformer_section(transformer, system.base_power)
            sections.append(Branch(transformer.name, transformer.from_bus, transformer.to_bus, section))
    return sections


def fault_bus(line: str) -> str:
    """Name of the bus at a fault on a line."""
    return f"{line}:fault"


def bus_names(system: System, topology: Topology) -> list[str]:
    """Names of all buses, those at faults on lines last."""
    extra = [fault_bus(p.line) for p in topology.faults if p.line is not None and p.line not in topology.lines_out]
    return [bus.name for bus in system.buses] + extra


def admittance(
    index: Mapping[str, int], present: Sequence[Branch], to_ground: Iterable[tuple[str, complex]]
) -> Triplets:
    """Bus admittance matrix of branches and shunts, (buses, buses), p.u.; `to_ground`: shunts with their buses."""
    entries = []
    for branch in present:
        ends = index[branch.from_bus], index[branch.to_bus]
        entries += [(ends[i], ends[j], branch.admittance[i, j]) for i in range(2) for j in range(2)]
    entries += [(index[bus], index[bus], value) for bus, value in to_ground]
    return summed(len(index), entries)


def shunts(system: System, topology: Topology, voltage: Mapping[str, float]) -> dict[str, complex]:
    """Shunt admittance at each bus from loads, capacitors, brakes and faults, p.u.; `voltage`: from the power flow.

    A load counts as its impedance at its reference voltage, whatever its ZIP fractions.
    """
    total: dict[str, complex] = {}
    for load in system.loads:
        power = complex(load.P, load.Q) / system.base_power * topology.load_scale.get(load.name, 1.0)
        reference = 1.0 if load.at == "nominal" else voltage[load.bus]
        total[load.bus] = total.get(load.bus, 0j) + power.conjugate() / (reference * reference)
    for shunt in system.shunts:
        total[shunt.bus] = total.get(shunt.bus, 0j) + complex(shunt.P, shunt.Q) / system.base_power
    for bus, conductance in topology.brakes.items():
        total[bus] = total.get(bus, 0j) + conductance
    for place, impedance in topology.faults.items():
        if impedance != 0 and (place.line is None or place.line not in topology.lines_out):
            bus = place.bus or fault_bus(place.line or "")
            total[bus] = total.get(bus, 0j) + complex(over(1.0, impedance))
    return total


def grounded(topology: Topology) -> set[str]:
    """Buses at zero voltage: those with a bolted fault."""
    buses = set()
    for place, impedance in topology.faults.items():
        if impedance == 0 and (place.line is None or place.line not in topology.lines_out):
            buses.add(place.bus or fault_bus(place.line or ""))
    return buses


def series_devices(system: System) -> list[Series]:
    """The devices in series with the network."""
    return [device for device in system.devices if isinstance(device, Series)]


def check_islands(system: System, topology: Topology, when: str) -> dict[str, int]:
    """Number of the island of each bus. Raises `InputError` if an island has no source."""
    names = bus_names(system, topology)
    index = {name: i for i, name in enumerate(names)}
    ends = [(b.from_bus, b.to_bus) for b in branches(system, topology)] + [d.ends for d in series_devices(system)]
    label = dict(zip(names, parts(len(names), ((index[a], index[b]) for a, b in ends)), strict=True))
    forming = {i.name: i.forming for i in system.inverters}
    sources = [u.bus for u in system.units if forming.get(u.name, True) and u.name not in topology.machines_out]
    fed = {label[bus] for bus in (*sources, *(i.bus for i in system.infinite_buses))}
    for island in sorted(set(label.values()) - fed):
        members = [name for name, number in label.items() if number == island]
        raise InputError(
            f"{when} island without a source: buses {', '.join(members)}; "
            "allowed: a machine, an infinite bus or a grid-forming inverter in each island"
        )
    return label
