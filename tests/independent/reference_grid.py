"""The network of the reference model: stages between events, admittances of all buses, loads, power flow."""

from __future__ import annotations

import cmath
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

from facts_damping.devices.hvdc import Hvdc
from facts_damping.devices.sssc import Sssc
from facts_damping.devices.statcom import Statcom
from facts_damping.parameters.events import Clear
from facts_damping.parameters.plant.grid import InfiniteBus
from facts_damping_library.devices.tcsc import Tcsc

from .reference_devices import Link, losses

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.parameters.events import Event
    from facts_damping.parameters.plant.grid import Line
    from facts_damping.parameters.plant.system import System

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Stage:
    """What holds between two events; faults by their bus or line: location (none: at a bus) and impedance."""

    out: frozenset[str] = frozenset()
    tripped: frozenset[str] = frozenset()
    faults: dict[str, tuple[float | None, complex]] = field(default_factory=dict)
    loads: dict[str, float] = field(default_factory=dict)
    powers: dict[str, float] = field(default_factory=dict)

    def after(self, event: Event) -> Stage:
        """The stage that an event leads to."""
        if event.kind == "fault":
            place = (None if event.line is None else event.location, complex(event.r, event.x))
            return replace(self, faults={**self.faults, event.line or event.bus or "": place})
        if event.kind == "clear":
            cleared = event.line or event.bus
            return replace(self, faults={name: fault for name, fault in self.faults.items() if name != cleared})
        if event.kind == "line_out":
            return replace(self, out=self.out | {event.line})
        if event.kind == "line_in":
            return replace(self, out=self.out - {event.line})
        if event.kind == "load_step":
            return replace(self, loads={**self.loads, event.load: 1.0 + event.change})
        if event.kind == "mechanical_power_step":
            return replace(self, powers={**self.powers, event.machine: 1.0 + event.change})
        if event.kind == "generator_trip":
            return replace(self, tripped=self.tripped | {event.machine})
        raise ValueError(f"{event.kind} given; allowed: the kinds above")


HEALTHY = Stage()


def timeline(events: Sequence[Event]) -> list[tuple[float, Stage]]:
    """Instants and the stages that begin there; a fault with a duration clears itself."""
    rows = list(events)
    rows += [
        Clear(time=fault.time + fault.duration, kind="clear", bus=fault.bus, line=fault.line)
        for fault in events
        if fault.kind == "fault" and fault.duration is not None
    ]
    stages = [(0.0, HEALTHY)]
    for row in sorted(rows, key=lambda event: event.time):
        stages.append((row.time, stages[-1][1].after(row)))
    return stages


def pi_section(line: Line, fraction: float, line_model: str) -> tuple[complex, complex]:
    """Series and one shunt admittance of a fraction of a line's length."""
    z, y = complex(line.r, line.x) * line.length * fraction, 1j * line.b * line.length * fraction
    if line_model == "distributed" and y:
        characteristic, g = cmath.sqrt(z / y), cmath.sqrt(z * y)
        # From V1 = cosh(g) V2 + Zc sinh(g) I2: series Zc sinh(g), shunt (cosh(g) - 1)/(Zc sinh(g)).
        z, y = characteristic * cmath.sinh(g), 2.0 * (cmath.cosh(g) - 1.0) / (characteristic * cmath.sinh(g))
    return 1.0 / z, y / 2.0


class Grid:
    """Passive branches and shunts of one stage as a matrix over all buses; points of faults on lines come last."""

    def __init__(self, system: System, stage: Stage) -> None:
        on_lines = [name for name, (location, _) in stage.faults.items() if location is not None]
        on_lines = [name for name in on_lines if name not in stage.out]
        self.buses = [bus.name for bus in system.buses] + [f"{name}@fault" for name in on_lines]
        self.row = {name: i for i, name in enumerate(self.buses)}
        self.Y = np.zeros((len(self.buses), len(self.buses)), complex)
        for line in system.lines:
            if line.name in on_lines:
                location, point = stage.faults[line.name][0] or 0.0, f"{line.name}@fault"
                self._line(system, line, location, line.from_bus, point)
                self._line(system, line, 1.0 - location, point, line.to_bus)
            elif line.name not in stage.out:
                self._line(system, line, 1.0, line.from_bus, line.to_bus)
        for unit in system.transformers:
            if unit.name in stage.out:
                continue
            scale = unit.rating / system.base_power
            y, t = scale / complex(unit.r, unit.x), cmath.rect(unit.tap, np.deg2rad(unit.phase_shift))
            magnetising = complex(1.0 / unit.magnetising_r if unit.magnetising_r else 0.0)
            magnetising += 1.0 / (1j * unit.magnetising_x) if unit.magnetising_x else 0.0
            both = [self.row[unit.from_bus], self.row[unit.to_bus]]
            self.Y[np.ix_(both, both)] += [[y / abs(t) ** 2 + scale * magnetising, -y / t.conjugate()], [-y / t, y]]
        for shunt in system.shunts:
            at = self.row[shunt.bus]
            self.Y[at, at] += complex(shunt.P, shunt.Q) / system.base_power
        places = {name if location is None else f"{name}@fault": z for name, (location, z) in stage.faults.items()}
        present = {self.row[name]: impedance for name, impedance in places.items() if name in self.row}
        for at, impedance in present.items():
            self.Y[at, at] += 1.0 / impedance if impedance else 0.0
        self.bolted = sorted(at for at, impedance in present.items() if not impedance)

    def _line(self, system: System, line: Line, fraction: float, start: str, stop: str) -> None:
        series, shunt = pi_section(line, fraction, system.line_model)
        both = [self.row[start], self.row[stop]]
        self.Y[np.ix_(both, both)] += [[series + shunt, -series], [-series, series + shunt]]


class Loads:
    """All loads of a system: currents that they draw, S = P f(r) + j Q f(r) with r = |V|/V0."""

    def __init__(self, system: System) -> None:
        self.names = [load.name for load in system.loads]
        buses = [bus.name for bus in system.buses]
        self.at = np.array([buses.index(load.bus) for load in system.loads], dtype=int)
        self.S = np.array([complex(load.P, load.Q) / system.base_power for load in system.loads], complex)
        self.nominal = np.array([load.at == "nominal" for load in system.loads], dtype=bool)
        self.P_fractions = (
            np.array([list(load.P_fractions.model_dump().values()) for load in system.loads]).reshape(-1, 3).T
        )
        self.Q_fractions = (
            np.array([list(load.Q_fractions.model_dump().values()) for load in system.loads]).reshape(-1, 3).T
        )
        self.V_min = np.array([load.V_min for load in system.loads])
        self.V0 = np.ones(len(system.loads))

    def currents(self, V: Complex, scale: Array) -> Complex:
        """Current drawn by each load: the conjugate of S/V, written with S/|V|^2 so that V = 0 has an answer."""
        at = V[self.at]
        r = np.maximum(np.abs(at) / self.V0, self.V_min)
        G = self.P_fractions[0] + self.P_fractions[1] / r + self.P_fractions[2] / r**2
        B = self.Q_fractions[0] + self.Q_fractions[1] / r + self.Q_fractions[2] / r**2
        return np.asarray(scale * (self.S.real * G - 1j * self.S.imag * B) * at / self.V0**2)


@dataclass(frozen=True)
class Flow:
    """Solved power flow, p.u. of the system base: voltages by bus, powers by machine, currents by SSSC."""

    V: dict[str, complex]
    S: dict[str, complex]
    I: dict[str, complex]  # noqa: E741
    residual: float


def _first_angles(system: System, grid: Grid) -> Array:
    """Angles at no load: those of the sources, carried on over phase-shifting transformers."""
    known = {row.bus: np.deg2rad(row.angle) for row in system.infinite_buses}
    known |= {m.bus: np.deg2rad(m.angle) for m in system.units if m.slack}
    steps = [(row.from_bus, row.to_bus, 0.0) for row in system.lines]
    steps += [(row.from_bus, row.to_bus, np.deg2rad(row.phase_shift)) for row in system.transformers]
    steps += [(*row.ends, 0.0) for row in system.devices if isinstance(row, Sssc | Tcsc)]
    for _ in grid.buses:
        for start, stop, lead in steps:
            if start in known:
                known.setdefault(stop, known[start] - lead)
            elif stop in known:
                known[start] = known[stop] + lead
    return np.array([known.get(bus, 0.0) for bus in grid.buses])


def power_flow(system: System, installed: Sequence[str]) -> Flow:
    """Balance of powers at every bus, with voltages, powers of sources and currents of SSSCs as unknowns.

    An SSSC is its resistance `rs`; an installed one has `g/|I|^2` more, the losses of its DC link. A STATCOM draws its
    losses, an HVDC link its order.
    """
    grid, loads = Grid(system, HEALTHY), Loads(system)
    n = len(grid.buses)
    series = [device for device in system.devices if isinstance(device, Sssc | Tcsc)]
    ends = np.array([[grid.row[bus] for bus in device.ends] for device in series], dtype=int).reshape(-1, 2)
    rs = np.array([complex(device.rs, -device.X) if isinstance(device, Tcsc) else device.rs for device in series])
    lossy = [isinstance(device, Sssc) and device.name in installed for device in series]
    g = np.array([getattr(device, "g", 0.0) * on for device, on in zip(series, lossy, strict=True)])
    sources: list[Any] = [*system.machines, *system.infinite_buses, *system.inverters]
    at = [grid.row[source.bus] for source in sources]
    fixed = [i for i, source in enumerate(sources) if isinstance(source, InfiniteBus) or source.slack]
    free = [i for i in range(len(sources)) if i not in fixed]
    held = np.array([cmath.rect(sources[i].V, np.deg2rad(sources[i].angle)) for i in fixed])
    P = np.array([0.0 if isinstance(row, InfiniteBus) else (row.P or 0.0) / system.base_power for row in sources])
    Q = np.array([getattr(row, "Q", 0.0) / system.base_power for row in sources])
    size = np.array([source.V or 1.0 for source in sources])
    holds = np.array([source.V is not None for source in sources])

    drawing = [p for p in system.devices if isinstance(p, Hvdc) or (isinstance(p, Statcom) and p.name in installed)]

    def taken_by_devices(V: Complex) -> Complex:
        draws = np.zeros(n, complex)
        for p in drawing:
            rows = [grid.row[bus] for bus in p.buses]
            if isinstance(p, Hvdc):
                draws[rows] -= Link(p, [1.0, 1.0], system.base_power).powers([1.0, 1.0], 0.0, 1.0)
            else:
                draws[rows] += losses(p, float(abs(V[rows[0]])))
        return draws

    def split(z: Array) -> tuple[Complex, Complex, Complex]:
        w = z[::2] + 1j * z[1::2]
        return w[:n], w[n : n + len(sources)], w[n + len(sources) :]

    def mismatch(z: Array, g: Array) -> Array:
        V, S, current = split(z)
        out = grid.Y @ V
        np.add.at(out, ends[:, 0], current)
        np.add.at(out, ends[:, 1], -current)
        balance = -V * np.conj(out) - taken_by_devices(V)
        np.add.at(balance, at, S)
        drawn = np.where(loads.nominal, V[loads.at] * np.conj(loads.currents(V, np.ones(len(loads.at)))), loads.S)
        np.add.at(balance, loads.at, -drawn)
        lost = np.divide(g, np.abs(current) ** 2, out=np.zeros(len(series)), where=g > 0.0)
        drop = V[ends[:, 0]] - V[ends[:, 1]] - (rs + lost) * current
        V_source = V[at]
        reactive = np.where(holds, np.abs(V_source) - size, S.imag - Q)
        set_points = (S.real[free] - P[free]) + 1j * reactive[free]
        rows = np.concatenate([balance, drop, V_source[fixed] - held, set_points])
        return np.ravel([rows.real, rows.imag])

    V0 = np.exp(1j * _first_angles(system, grid))
    V0[at] *= size
    guess = np.concatenate([V0, P, np.ones(len(series))]).view(float)
    for lost in (0.0 * g, g, g):
        guess = root(mismatch, guess, args=(lost,), method="hybr", options={"xtol": 1e-15, "maxfev": 100_000}).x
    V, S, current = split(guess)
    residual = float(np.abs(mismatch(guess, g)).max())
    if residual > 1e-10:
        raise ValueError(f"{system.name}: no power flow found, mismatch {residual:.1e} p.u.")
    return Flow(
        dict(zip(grid.buses, V.tolist(), strict=True)),
        dict(zip([source.name for source in sources], S.tolist(), strict=True)),
        dict(zip([device.name for device in series], current.tolist(), strict=True)),
        residual,
    )
