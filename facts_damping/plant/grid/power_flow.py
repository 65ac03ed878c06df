"""Power flow: bus voltages from scheduled powers and voltages, by Newton's method in polar form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.devices.base import Parallel, Transmission
from facts_damping.errors import InputError
from facts_damping.numerics.phasors import magnitudes, over, polar, times
from facts_damping.plant.converters.dispatch import consumed_power, losses_of
from facts_damping.plant.grid import load as loads
from facts_damping.plant.grid import network
from facts_damping.plant.grid.sparse import DENSE, filled, joined, solve_network

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Complex1, Complex2, Float1, Int1
    from facts_damping.parameters.plant.inverters import Inverter
    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.grid.sparse import Triplets

TOLERANCE = 1e-9  # p.u., largest power mismatch
LOSS_TOLERANCE = 1e-13  # p.u., of the resistance equivalent to a device's losses
MAX_ITERATIONS = 30
MANY = 100  # buses, from which on Newton's method ends where round-off does
FARTHEST = 10.0  # p.u., voltage at which an iteration has diverged
STRAY = 1e-9  # p.u., admittance of fictitious branches for the starting angles


@dataclass(frozen=True)
class PowerFlow:
    """Solved power flow, p.u.

    Bus voltages, and generation minus loads and devices at them (buses,); generation by machine or infinite bus,
    current magnitude by series device; the largest remaining power mismatch.
    """

    names: list[str]
    voltage: NDArray[np.complex128]
    injection: NDArray[np.complex128]
    generation: dict[str, complex]
    currents: dict[str, float]
    residual: float

    @property
    def by_bus(self) -> dict[str, complex]:
        """Voltage of each bus, p.u."""
        return dict(zip(self.names, self.voltage.tolist(), strict=True))

    def magnitudes(self, buses: Sequence[str]) -> list[float]:
        """Voltage magnitudes of some buses, p.u."""
        voltage = self.by_bus
        return [float(magnitudes(voltage[bus])) for bus in buses]

    def buses(self, base_power: float) -> list[dict[str, Any]]:
        """A row per bus: name, voltage (p.u., deg), generation minus loads and devices (MW, Mvar)."""
        return [
            {
                "name": name,
                "v_pu": float(abs(v)),
                "angle_deg": float(np.rad2deg(np.angle(v))),
                "p_mw": float(s.real * base_power),
                "q_mvar": float(s.imag * base_power),
            }
            for name, v, s in zip(self.names, self.voltage, self.injection, strict=True)
        ]


def solve(system: System, installed: Sequence[str] = ()) -> PowerFlow:
    """Solve for all bus voltages before the first event.

    An installed series device with losses is a series resistance; a parallel device draws its power at rest, a
    permanent one whether installed or not. Since the first two depend on |I| and |V|, the power flow is
    repeated until they converge.
    """
    series = network.series_devices(system)
    present = [d for d in system.devices if d.permanent or d.name in installed]
    parallel = [d for d in present if isinstance(d, Parallel | Transmission)]
    losses = {device.name: 0.0 for device in series}
    draws = {d.name: consumed_power(d, [1.0] * len(d.buses), system.base_power) for d in parallel}
    scheduled, change = [i for i in system.inverters if i.V is None], 0.0
    for _ in range(MAX_ITERATIONS):
        drawn_by_devices = [pair for d in parallel for pair in zip(d.buses, draws[d.name], strict=True)]
        flow = _solve(system, losses, [*drawn_by_devices, *((i.bus, -_power(system, i)) for i in scheduled)])
        lost = {d.name: losses_of(d, flow.currents[d.name]) for d in series if d.name in installed}
        drawn = {d.name: consumed_power(d, flow.magnitudes(d.buses), system.base_power) for d in parallel}
        changes = [abs(lost[name] - losses[name]) for name in lost]
        changes += [abs(a - b) for name in drawn for a, b in zip(drawn[name], draws[name], strict=True)]
        change = max(changes, default=0.0)
        if change <= LOSS_TOLERANCE:
            flow.generation.update({i.name: _power(system, i) for i in scheduled})
            return flow
        losses |= lost
        draws |= drawn
    raise InputError(
        f"system {system.name}: power flow does not converge: losses of the devices change by {change:.3g} p.u. "
        f"after {MAX_ITERATIONS} iterations; allowed: {LOSS_TOLERANCE:g}"
    )


def _power(system: System, inverter: Inverter) -> complex:
    """Scheduled power of an inverter that holds no voltage, p.u."""
    return complex(inverter.P or 0.0, inverter.Q) / system.base_power


def demand(system: System, names: list[str], magnitude: Float1) -> Complex2:
    """Power that the loads draw at voltage magnitudes, and its derivative by them; shape (2, buses), p.u."""
    index = {name: i for i, name in enumerate(names)}
    drawn = np.zeros((2, len(names)), np.complex128)
    for load in system.loads:
        i, power = index[load.bus], complex(load.P, load.Q) / system.base_power
        if load.at == "solved":
            drawn[0, i] += power
            continue
        r = float(magnitude[i])
        for fraction, part in ((load.P_fractions, power.real), (load.Q_fractions, 1j * power.imag)):
            beyond, slope = loads.excess(r, fraction.current, fraction.power, load.V_min, low=False)
            drawn[:, i] += part * np.array([r * r + beyond, 2 * r + slope])
    return drawn


def _solve(system: System, losses: dict[str, float], draws: Sequence[tuple[str, complex]]) -> PowerFlow:
    """Newton's method on the power balance of all buses, `losses` in series with the devices (p.u.).

    `draws`: power of parallel devices from buses, p.u.; that of inverters without a voltage is below 0.

    Unknowns are the angles of all buses except the slack's and the infinite ones, and the magnitudes at the buses
    without a machine; equations P_i + j Q_i = V_i conj(sum_j Y_ij V_j) (Kundur 1994, 6.4). A series FACTS device is
    the resistance of its transformer, with its reactance at rest. Raises `InputError` if Newton's method does not
    converge.
    """
    names = network.bus_names(system, network.Topology())
    index = {name: i for i, name in enumerate(names)}
    series = {d.name: network.at_rest(d, losses[d.name]) for d in network.series_devices(system)}
    present = network.branches(system, network.Topology())
    present += [network.device_section(d, series[d.name]) for d in network.series_devices(system)]
    shunts = ((shunt.bus, complex(shunt.P, shunt.Q) / system.base_power) for shunt in system.shunts)
    matrix = network.admittance(index, present, shunts)
    scheduled = np.zeros(len(names), np.complex128)
    magnitude, angle = np.ones(len(names)), np.zeros(len(names))
    holding = [unit for unit in system.units if unit.V is not None]
    for machine in holding:
        scheduled[index[machine.bus]] += (machine.P or 0.0) / system.base_power
    of_devices = np.zeros(len(names), np.complex128)
    for bus, power in draws:
        of_devices[index[bus]] += power
    scheduled -= of_devices
    fixed: list[Any] = [*system.infinite_buses, *(m for m in holding if m.slack)]
    held: list[Any] = [*system.infinite_buses, *holding]
    for source in fixed:
        angle[index[source.bus]] = np.deg2rad(source.angle)
    for source in held:
        magnitude[index[source.bus]] = source.V
    turned = {index[source.bus] for source in fixed}
    held_buses = {index[source.bus] for source in held}
    free = tuple(np.array([i for i in range(len(names)) if i not in known], int) for known in (turned, held_buses))
    voltage, residual = _converged(system, names, matrix, scheduled, (magnitude, angle), free)
    drawn = demand(system, names, magnitudes(voltage))[0] + of_devices
    net = times(voltage, np.conj(_currents(matrix, voltage))) + drawn
    here: dict[int, list[Any]] = {}
    for source in held:
        here.setdefault(index[source.bus], []).append(source)
    generation = {
        name: fraction for i in held_buses for name, fraction in _shared(here[i], complex(net[i]), system.base_power)
    }
    injection = -drawn
    for i in held_buses:
        injection[i] += net[i]
    currents = {}
    for d in network.series_devices(system):
        first, second = d.ends
        currents[d.name] = float(magnitudes(voltage[index[first]] - voltage[index[second]])) / abs(series[d.name])
    return PowerFlow(names, voltage, injection, generation, currents, residual)


def _converged(
    system: System,
    names: list[str],
    matrix: Triplets,
    scheduled: Complex1,
    start: tuple[Float1, Float1],
    free: tuple[Int1, ...],
) -> tuple[Complex1, float]:
    """Voltages of all buses, p.u., and the largest mismatch, p.u.

    `start`: magnitudes and angles where they are held, and to begin with; `free`: buses whose angle is sought, and
    those whose magnitude is. If Newton's method does not converge from angles without a flow, it begins with those of a
    linear power flow. Raises `InputError` if it does not converge then.
    """
    magnitude, angle = start
    turned = _turned(system, names)
    with np.errstate(all="ignore"):  # the mismatch shows divergence
        for flow in (0.0, 1.0):
            active = flow * _balanced((scheduled - demand(system, names, magnitude)[0]).real)
            begin = magnitude.copy(), _initial_angles(matrix, angle, free[0], active + turned)
            voltage, residual = _newton(matrix, scheduled, lambda m: demand(system, names, m), begin, *free)
            if residual < TOLERANCE:
                return voltage, residual
    raise InputError(
        f"system {system.name}: power flow does not converge: mismatch {residual:.3g} p.u. after "
        f"{MAX_ITERATIONS} iterations; allowed: {TOLERANCE:g}"
    )


def _currents(matrix: Triplets, voltage: Complex1) -> Complex1:
    """Currents into all buses, p.u.: the admittance matrix times the voltages, row by row."""
    total = np.zeros_like(voltage)
    np.add.at(total, matrix.row, times(matrix.value, voltage[matrix.column]))
    return total


def _shared(here: Sequence[Any], net: complex, base_power: float) -> list[tuple[str, complex]]:
    """Powers of the sources at a bus: their own, the rest by ratings, but that of P of those without (the slack)."""
    if len(here) == 1:
        return [(here[0].name, net)]
    rating = sum(m.rating for m in here)
    rest = net - sum(complex(m.P or 0.0, m.Q) for m in here) / base_power
    balancing = sum(m.rating for m in here if m.P is None)
    active = [
        rest.real * (m.rating / balancing)
        if m.P is None
        else m.P / base_power + (0.0 if balancing else rest.real * m.rating / rating)
        for m in here
    ]
    reactive = [m.Q / base_power + rest.imag * m.rating / rating for m in here]
    return [(m.name, complex(P, Q)) for m, P, Q in zip(here, active, reactive, strict=True)]


def _balanced(active: Float1) -> Float1:
    """Power into each bus with what generation exceeds the load by drawn where power is generated, in proportion.

    Without it the losses of a large grid would all flow to the slack.
    """
    generated = np.maximum(active, 0.0)
    excess: float = active.sum() / max(float(generated.sum()), STRAY)
    return active - generated * excess


def _turned(system: System, names: list[str]) -> Float1:
    """Power into each bus, p.u., of a linear power flow with the turns of phase shifters instead of these."""
    into, index = np.zeros(len(names)), {name: i for i, name in enumerate(names)}
    for t in system.transformers:
        power = float(magnitudes(network.transformer_section(t, system.base_power)[0, 1])) * np.deg2rad(t.phase_shift)
        into[index[t.from_bus]] += power
        into[index[t.to_bus]] -= power
    return into


def _initial_angles(matrix: Triplets, angle: Float1, free: Int1, active: Float1) -> Float1:
    """Angles, rad, of a linear power flow: `active` p.u. into each bus, at branches with the magnitudes of `matrix`.

    Without it they are interpolated between the given angles. A fictitious branch to angle zero at each bus covers
    those without a connection to a given angle.
    """
    n, beside = len(angle), matrix.row != matrix.column
    i, j, value = (part[beside] for part in matrix)
    size = magnitudes(value)
    weight = filled(n, (i, j), size)
    laplacian = filled(n, (np.arange(n),) * 2, weight.sum(axis=1) + STRAY) - weight
    drawn, fixed = np.zeros(n), np.isin(j, free, invert=True)
    np.add.at(drawn, i[fixed], size[fixed] * angle[j[fixed]])
    solved: Float1 = angle.copy()
    solved[free] = solve_network(laplacian[free][:, free], (drawn + active)[free])
    return solved


def _newton(
    matrix: Triplets,
    scheduled: Complex1,
    demand_at: Callable[[Float1], Complex2],
    start: tuple[Float1, Float1],
    free_angle: Int1,
    free_magnitude: Int1,
) -> tuple[Complex1, float]:
    """Newton iterations in polar form from (magnitudes, angles); returns voltages and the largest final mismatch."""
    magnitude, angle = start
    voltage = polar(magnitude, angle)
    residual = before = float("inf")
    enough = TOLERANCE / (1000 if len(angle) <= DENSE else 10)  # round-off grows with the number of buses
    for _ in range(MAX_ITERATIONS):
        current = _currents(matrix, voltage)
        drawn, drawn_by_magnitude = demand_at(magnitude)
        mismatch = times(voltage, np.conj(current)) + drawn - scheduled
        equations = np.concatenate([mismatch.real[free_angle], mismatch.imag[free_magnitude]])
        residual = float(np.max(np.abs(equations), initial=0.0))
        round_off = len(angle) > MANY and before / 2 < residual < TOLERANCE
        lost = not np.isfinite(residual) or np.abs(magnitude).max(initial=0.0) > FARTHEST
        if residual < enough or round_off or lost:
            break
        before = residual
        jacobian = _jacobian(matrix, voltage, current, drawn_by_magnitude, free_angle, free_magnitude)
        try:
            change = solve_network(jacobian, -equations)
        except np.linalg.LinAlgError:
            return voltage, float("inf")
        angle[free_angle] += change[: len(free_angle)]
        magnitude[free_magnitude] += change[len(free_angle) :]
        voltage = polar(magnitude, angle)
    return voltage, residual


def _jacobian(
    matrix: Triplets,
    voltage: Complex1,
    current: Complex1,
    drawn_by_magnitude: Complex1,
    free_angle: Int1,
    free_magnitude: Int1,
) -> Any:
    """Derivatives of the power balances by the free angles and magnitudes; sparse for a large network."""
    unit = over(voltage, magnitudes(voltage))
    diagonal = times(np.conj(current), unit) + drawn_by_magnitude
    n, at = len(voltage), (np.arange(len(voltage)),) * 2
    i, j, there = matrix
    apart = 1j * voltage
    by_angle = filled(n, (i, j), times(apart[i], np.conj(-times(there, voltage[j]))))
    by_angle = by_angle + filled(n, at, times(apart, np.conj(current)))
    by_magnitude = filled(n, (i, j), times(voltage[i], np.conj(times(there, unit[j])))) + filled(n, at, diagonal)
    parts = [
        [by_angle.real[np.ix_(free_angle, free_angle)], by_magnitude.real[np.ix_(free_angle, free_magnitude)]],
        [by_angle.imag[np.ix_(free_magnitude, free_angle)], by_magnitude.imag[np.ix_(free_magnitude, free_magnitude)]],
    ]
    return joined(parts)
