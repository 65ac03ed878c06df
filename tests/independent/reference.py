"""Reference model of any system, written from the equations alone and by other means than the package.

All buses are kept. At every evaluation Newton's method finds bus voltages, stator currents and currents of SSSCs
together, on finite differences. Standard machines are magnetic circuits; machines start from a numerical solution
of their rest. SciPy integrates between events and corners of setpoints.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.integrate import solve_ivp

from facts_damping.devices.hvdc import Hvdc
from facts_damping.devices.load_modulation import LoadModulation
from facts_damping.devices.sssc import Sssc
from facts_damping.devices.statcom import Statcom
from facts_damping.parameters.plant.placement import place
from facts_damping_library.devices.bess import Bess
from facts_damping_library.devices.exciter_input import ExciterInput
from facts_damping_library.devices.inverter_input import InverterInput
from facts_damping_library.devices.svc import Svc
from facts_damping_library.devices.tcsc import Tcsc

from .reference_controls import Damper, Turbine, exciter_of
from .reference_devices import Battery, Capacitor, Input, Link, Modulated, Ramp, Series, Shunt, Susceptance
from .reference_grid import HEALTHY, Array, Complex, Loads, pi_section, power_flow, timeline
from .reference_inverters import Sight
from .reference_machines import ROTORS, machine_start
from .reference_network import Known, Network
from .reference_plants import Inverter

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping.parameters.events import Event
    from facts_damping.parameters.plant.system import System

    from .reference_controls import Control
    from .reference_devices import Targets
    from .reference_machines import Rotor

    Parallel = Shunt | Susceptance | Link | Modulated | Battery

AT_BUSES = (Statcom, Svc, Hvdc, LoadModulation, Bess)
EXPLICIT = ("RK23", "RK45", "DOP853")


@dataclass(frozen=True)
class Unit:
    """A machine with its controls, and where its states begin."""

    name: str
    rotor: Rotor
    exciter: Control
    damper: Damper
    turbine: Turbine
    Pm: float
    at: int

    def parts(self, x: list[float]) -> tuple[list[float], list[float], list[float], list[float], list[float]]:
        """Its states in blocks: swing, rotor, exciter, stabiliser, governor."""
        blocks, at = [], self.at
        for size in (2, *(len(block.states) for block in (self.rotor, self.exciter, self.damper, self.turbine))):
            blocks.append(x[at : at + size])
            at += size
        return blocks[0], blocks[1], blocks[2], blocks[3], blocks[4]


@dataclass(frozen=True)
class Run:
    """A simulated course; the first axis of all arrays is time."""

    names: list[str]
    machines: list[str]
    t: Array
    x: Array
    references: dict[str, Array]
    V: dict[str, Complex]

    def state(self, name: str) -> Array:
        """One state, `machine.state` or `device.state`."""
        return np.asarray(self.x[:, self.names.index(name)])

    @property
    def speeds(self) -> Array:
        """Speed deviations, p.u., (times, machines)."""
        return np.stack([self.state(f"{name}.omega") for name in self.machines], axis=1)

    @property
    def angles(self) -> Array:
        """Rotor angles, rad, (times, machines)."""
        return np.stack([self.state(f"{name}.delta") for name in self.machines], axis=1)


class Model:
    """A system at rest, its derivatives, courses and modes; `installed`: names of its devices, none: all."""

    def __init__(self, system: System, installed: Sequence[str] | None = None) -> None:
        self.system = system = place(system)
        self.omega_0 = 2.0 * np.pi * system.frequency
        self.series = [p for p in system.devices if isinstance(p, Sssc | Tcsc)]
        self.inputs = [p for p in system.devices if isinstance(p, ExciterInput)]
        at_buses = [p for p in system.devices if isinstance(p, AT_BUSES)]
        self.shunts = [(p, bus, end) for p in at_buses for end, bus in enumerate(p.buses)]
        self.installed = [p.name for p in system.devices if installed is None or p.name in installed]
        self.flow = power_flow(system, self.installed)
        self.loads = Loads(system)
        solved = np.array([abs(self.flow.V[load.bus]) for load in system.loads])
        self.loads.V0 = np.where(self.loads.nominal, 1.0, solved)
        self.names: list[str] = []
        self.start: list[float] = []
        self.units: list[Unit] = []
        currents = [self._start_machine(k) for k in range(len(system.machines))]
        self.I0, self.rotors = np.array(currents), [unit.rotor for unit in self.units]
        self.converters: dict[str, tuple[Series | Capacitor | Input | Parallel, int]] = {}
        self.parallel: dict[str, Parallel] = {}
        self.lags: dict[str, tuple[int, float]] = {}  # where the reference behind the response time is, and that
        for p in (p for p in system.devices if p.name in self.installed):
            block: Series | Capacitor | Input | Parallel
            if isinstance(p, Sssc):
                block = Series(p, abs(self.flow.I[p.name]))
            elif isinstance(p, Tcsc):
                block = Capacitor(p)
            elif isinstance(p, ExciterInput | InverterInput):
                block = Input(p)
            else:
                assert isinstance(p, AT_BUSES)
                V = [abs(self.flow.V[bus]) for bus in p.buses]
                self.parallel[p.name] = block = self._at_buses(p, V)
            self.converters[p.name] = block, len(self.start)
            self._add(p.name, block.states, block.start)
            if p.response_time > 0.0:
                self.lags[p.name] = len(self.start), p.response_time
                self._add(p.name, ["reference"], [0.0])
        self.inverters: list[Inverter] = []
        self.first: list[int] = []  # of their states
        for row in system.inverters:
            self._start_inverter(row)
        self.x0 = np.array(self.start)
        self.healthy = Network(self, HEALTHY)

    def _start_inverter(self, row: Any) -> None:
        """An inverter at rest with its controls."""
        system, voltage = self.system, self.flow.V[row.bus]
        controls = {c.model: c for c in system.inverter_controls if c.inverter == row.name and c.enabled}
        current = (self.flow.S[row.name] * system.base_power / row.rating / voltage).conjugate()
        voltages = np.array([self.flow.V[bus.name] for bus in system.buses])
        unit = Inverter(row, controls, self.sight(row, voltages, voltage, current, {}), self.omega_0)
        self.inverters.append(unit)
        self.first.append(len(self.start))
        self._add(row.name, unit.states, unit.start)

    def sight(self, row: Any, V: Complex, voltage: complex, current: complex, sets: Mapping[str, float]) -> Sight:
        """What an inverter sees: its voltage and current, and those of its plant control's bus and branch."""
        for c in self.system.inverter_controls:
            if c.inverter == row.name and c.bus is not None:
                line = next(line for line in self.system.lines if line.name == c.branch)
                series, shunt = pi_section(line, 1.0, self.system.line_model)
                buses = [bus.name for bus in self.system.buses]
                here, there = (complex(V[buses.index(end)]) for end in (line.from_bus, line.to_bus))
                here, there = (here, there) if line.from_bus == c.bus else (there, here)
                flowing = (series + shunt) * here - series * there
                branch = here * flowing.conjugate() * self.system.base_power / row.rating
                return Sight(voltage, current, here, branch, sets)
        return Sight(voltage, current, voltage, voltage * current.conjugate(), sets)

    def set_at(self, name: str, u: Mapping[str, float]) -> dict[str, float]:
        """Setpoints at an inverter by the signals that they are added to."""
        return {p.input: u[p.name] for p in self.system.devices if isinstance(p, InverterInput) and p.inverter == name}

    def _at_buses(self, p: Any, V: list[float]) -> Parallel:
        """A device at one or two buses, at rest at their voltages."""
        if isinstance(p, Hvdc):
            return Link(p, V, self.system.base_power)
        if isinstance(p, Statcom):
            return Shunt(p, V[0], self.omega_0)
        if isinstance(p, Bess):
            return Battery(p, V[0], self.system.base_power)
        return Modulated(p) if isinstance(p, LoadModulation) else Susceptance(p, V[0])

    def _add(self, owner: str, states: Sequence[str], start: Sequence[float]) -> None:
        self.names += [f"{owner}.{state}" for state in states]
        self.start += start

    def _start_machine(self, k: int) -> complex:
        """A machine at rest with its controls; its current Id + j Iq."""
        m, system = self.system.machines[k], self.system
        rotor, V = ROTORS[m.model](m), self.flow.V[m.bus]
        current = (self.flow.S[m.name] * system.base_power / m.rating / V).conjugate()
        delta, Efd, z = machine_start(rotor, V, current)
        Pm = (V * current.conjugate()).real + m.Ra * abs(current) ** 2
        exciter = exciter_of(next((e for e in system.exciters if e.machine == m.name), None), abs(V), Efd)
        damper = Damper(next((s for s in system.stabilisers if s.machine == m.name), None))
        turbine = Turbine(next((g for g in system.governors if g.machine == m.name), None), Pm)
        self.units.append(Unit(m.name, rotor, exciter, damper, turbine, Pm, len(self.start)))
        self._add(m.name, ("delta", "omega", *rotor.states), [delta, 0.0, *z])
        self._add(f"{m.name}.exciter", exciter.states, exciter.start)
        self._add(f"{m.name}.stabiliser", damper.states, [0.0] * len(damper.states))
        self._add(f"{m.name}.governor", turbine.states, turbine.start)
        return complex(current * np.exp(-1j * (delta - np.pi / 2.0)))

    def known(self, x: list[float], u: Mapping[str, float]) -> Known:
        """What states and references say to the network."""
        delta = np.array([x[unit.at] for unit in self.units])
        E = [complex(*unit.rotor.emf(unit.parts(x)[1], unit.exciter.Efd0)) for unit in self.units]
        devices = {p.name: list[float]() for p in self.system.devices}
        devices |= {name: x[at : at + len(block.states)] for name, (block, at) in self.converters.items()}
        lagging = {name: x[at] for name, (at, _) in self.lags.items()}
        asked = {**dict.fromkeys(devices, 0.0), **u, **lagging}
        inverters = [x[at : at + len(unit.states)] for unit, at in zip(self.inverters, self.first, strict=True)]
        return Known(np.exp(1j * (delta - np.pi / 2.0)), np.array(E), devices, asked, inverters)

    def drop(self, p: Sssc | Tcsc, current: complex, known: Known, blocked: frozenset[str]) -> complex:
        """Voltage over an SSSC at its current; one that is not installed is its resistance alone. Of a TCSC too."""
        if isinstance(p, Tcsc):
            capacitive = (known.devices[p.name] or [p.X])[0]
            return complex(p.rs, p.xs if p.name in blocked else -capacitive) * current
        if p.name not in self.converters:
            return p.rs * current
        size, total = abs(current), complex(p.rs, p.xs) * current
        block = self.converters[p.name][0]
        if p.name in blocked or size == 0.0 or not isinstance(block, Series):
            return total
        v_p, v_q, _ = block.drops(known.devices[p.name], known.u[p.name], size)
        return total + complex(v_p, v_q) * current / size

    def rates(self, x: Array, u: Mapping[str, float], network: Network) -> Array:
        """Time derivatives of all states; `u`: references of devices after their ramps."""
        values = x.tolist()
        known = self.known(values, u)
        s, blocked = network.solve(known)
        rates: list[float] = []
        for k, unit in enumerate(self.units):
            added = sum(known.u[p.name] for p in self.inputs if p.machine == unit.name)
            rates += self._machine_rates(k, unit, values, s.I[k], abs(s.V[network.at[k]]), network, added)
        for name, (block, _) in self.converters.items():
            z, ref = known.devices[name], known.u[name]
            if name in blocked:
                rates += [0.0] * len(z)
            elif isinstance(block, Capacitor | Input):
                rates += block.rates(z, ref)
            elif isinstance(block, Series):
                rates += block.drops(z, ref, float(abs(s.i[self.series.index(block.p)])))[2]
            else:
                rates += block.rates(z, ref, *(float(abs(s.V[network.grid.row[bus]])) for bus in block.p.buses))
            if name in self.lags:
                at, T = self.lags[name]
                rates.append((u.get(name, 0.0) - values[at]) / T)
        at_inverters = network.inverters_at, network.inverter_currents(s, known)
        for inverter, z, bus, current in zip(self.inverters, known.inverters, *at_inverters, strict=True):
            sets = self.set_at(inverter.row.name, known.u)
            rates += inverter.rates(z, self.sight(inverter.row, s.V, complex(s.V[bus]), complex(current), sets))
        return np.array(rates)

    def _machine_rates(
        self, k: int, unit: Unit, x: list[float], current: complex, V: float, network: Network, added: float
    ) -> list[float]:
        """Rates of a machine and its controls, with `added` at the regulator; one that has tripped stands still."""
        (_, omega), rotor, exciter, damper, turbine = unit.parts(x)
        if unit.name in network.stage.tripped:
            return [0.0] * (2 + len(rotor) + len(exciter) + len(damper) + len(turbine))
        m, Id, Iq = self.system.machines[k], float(current.real), float(current.imag)
        signal = unit.damper.output(damper, omega) + added
        Efd = unit.exciter.field(exciter, V, signal)
        Ed, Eq = unit.rotor.emf(rotor, Efd)
        # Vd Id + Vq Iq + Ra (Id^2 + Iq^2) by the stator's equations
        Pe = Ed * Id + Eq * Iq + (unit.rotor.Xq - unit.rotor.Xd) * Id * Iq
        reference = unit.Pm * network.stage.powers.get(unit.name, 1.0)
        Pm = unit.turbine.power(turbine, omega, reference)
        return [
            self.omega_0 * omega,
            (Pm - Pe - m.D * omega) / (2.0 * m.H),
            *unit.rotor.rates(rotor, Efd, Id, Iq),
            *unit.exciter.rates(exciter, V, signal),
            *unit.damper.rates(damper, omega),
            *unit.turbine.rates(turbine, omega, reference),
        ]

    def state_matrix(self, step: float = 1e-5) -> tuple[Array, Array]:
        """A and B (states, installed devices) at the start, by central differences."""
        ends = [[self.rates(self.x0, {name: d}, self.healthy) for d in (step, -step)] for name in self.installed]
        B = [(high - low) / (2.0 * step) for high, low in ends]
        return self._jacobian(self.x0, {}, self.healthy, step), np.array(B).reshape(-1, len(self.x0)).T

    def _jacobian(self, x: Array, u: Mapping[str, float], network: Network, step: float) -> Array:
        """Central differences of all rates by all states: far above what Newton's method leaves."""
        columns = [self.rates(x + d, u, network) - self.rates(x - d, u, network) for d in step * np.eye(len(x))]
        return np.asarray(np.stack(columns, axis=1) / (2.0 * step))

    def _slopes(self, x: Array, u: Mapping[str, float], network: Network, step: float = 1e-6) -> Array:
        """The same from one side, at half the price: it decides how soon an implicit method converges, not where to."""
        here = self.rates(x, u, network)
        columns = [self.rates(x + d, u, network) - here for d in step * np.eye(len(x))]
        return np.asarray(np.stack(columns, axis=1) / step)

    def eigenvalues(self) -> Complex:
        """Eigenvalues at the start, 1/s."""
        return np.asarray(np.linalg.eigvals(self.state_matrix()[0]), complex)

    def simulate(
        self,
        times: Array,
        events: Sequence[Event] = (),
        setpoints: Mapping[str, Targets] | None = None,
        *,
        method: str = "DOP853",
        rtol: float = 1e-10,
        atol: float = 1e-12,
    ) -> Run:
        """A course from the start at 0 s; events and corners of ramped setpoints are boundaries of integrations."""
        end, stages = float(times[-1]), timeline(events)
        targets = setpoints or {}
        ramps = {name: Ramp(p, targets.get(name, ()), end) for name, p in self._devices().items()}
        instants = np.concatenate([[0.0, end], [t for t, _ in stages], *(ramp.t for ramp in ramps.values())])
        bounds = np.unique(instants[(instants >= 0.0) & (instants <= end)])
        bounds = bounds[np.append(np.diff(bounds) > 1e-12, True)]
        x, network, rows, voltages = self.x0, self.healthy, [], []
        for a, b in pairwise([*bounds, np.inf]):
            stage = [stage for t, stage in stages if t <= a + 1e-12][-1]
            if stage != network.stage:
                network = Network(self, stage, network)

            def u(t: float) -> dict[str, float]:
                return {name: float(ramp.at(t)) for name, ramp in ramps.items()}

            def slope(t: float, x: Array, network: Network = network) -> Array:
                return self.rates(x, u(t), network)

            def jac(t: float, x: Array, network: Network = network) -> Array:
                return self._slopes(x, u(t), network)

            inside = times[(times >= a - 1e-12) & (times < b - 1e-12)].clip(a, b)
            states = np.array([x])
            if np.isfinite(b):
                jacobian = {} if method in EXPLICIT else {"jac": jac}
                done = solve_ivp(slope, (a, b), x, method, np.append(inside, b), rtol=rtol, atol=atol, **jacobian)
                if not done.success:
                    raise RuntimeError(f"integration stopped at {a} s: {done.message}")
                states, x = done.y.T[:-1], done.y[:, -1]
            for t, row in zip(inside, states, strict=False):
                s = network.solve(self.known(row.tolist(), u(t)))[0]
                rows.append(row)
                voltages.append(network.voltages(s))
        buses = {bus.name: np.array([V[bus.name] for V in voltages]) for bus in self.system.buses}
        machines = [unit.name for unit in self.units]
        references = {name: ramp.at(times) for name, ramp in ramps.items()}
        return Run(self.names, machines, times, np.array(rows), references, buses)

    def _devices(self) -> dict[str, Any]:
        return {p.name: p for p in self.system.devices if p.name in self.installed}
