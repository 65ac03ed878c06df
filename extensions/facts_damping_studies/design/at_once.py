"""Effect of new devices at all places at once, from the eigenvectors of the grid without them.

With right and left eigenvectors v, w of the grid as a descriptor system (`small_signal.descriptor`), w v = 1, the
response of a port is c v and the effect of its source w b, for all buses and lines at once. A device s = G r + g u at
its port moves the mode and drives it by

    lambda' = lambda + w b H G c v,   controllability = w b H g / (1 - d lambda'/ds),   H = (I - G Z)^-1

at s = lambda', Z the response of the port to its own source by all other modes. Setpoints at machines and inverters
act as they are: w B. What is left out: that a device changes the power flow, and Z between lambda and lambda'.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from facts_damping.devices.base import AtUnit, Parallel, Series
from facts_damping.parameters.plant.placement import place
from facts_damping.parameters.plant.pmus import Pmu
from facts_damping.plant.build import Built, build
from facts_damping.plant.grid.network import line_section
from facts_damping.small_signal.descriptor import eigenvalue_near
from facts_damping.small_signal.eigenmodes import speeds
from facts_damping.small_signal.linearisation import LinearModel, linear_model
from facts_damping_studies.design import devices_alone
from facts_damping_studies.design.places import free_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Complex1, Complex2, Complex3, Int2
    from facts_damping.parameters.plant.system import Device, System
    from facts_damping.small_signal.descriptor import Descriptor
    from facts_damping.small_signal.eigenmodes import Eigenmode
    from facts_damping_studies.design.devices_alone import Alone, AtRest

BESIDE = 0.01  # of an eigenvalue: distance from it at which Z is found
COLUMNS = 64  # of buses, solved for at once
STEPS = 5  # of Newton's method


class Grid(NamedTuple):
    """The linear grid without devices that have ports, with setpoints at its units."""

    system: System  # placed
    built: Built
    model: LinearModel
    matrix: Descriptor
    bus: dict[str, int]  # index of each bus of unknown voltage
    first: int  # row and column of the first bus's real part, behind the states
    buses: int


class Ports(NamedTuple):
    """Places of ports: at one bus, or in a line between two.

    The response is read_a V_a + read_b V_b + direct s, the source s feeds the currents feed_a s and feed_b s into the
    buses; index -1: none, or one of fixed voltage.
    """

    ends: Int2  # (ports, 2)
    read: Complex2  # (ports, 2)
    feed: Complex2  # (ports, 2)
    direct: Complex1  # (ports,)
    rest: Complex1  # (ports,), response at rest, p.u.


class Mode(NamedTuple):
    """A mode of the grid, the speed of the fastest unit one, with the buses' voltages and what their currents do."""

    value: complex
    left: Complex1  # (states,), w v = 1
    right: Complex1
    voltage: Complex2  # (2, buses + 1), real and imaginary parts; the last is zero
    moved_by: Complex2  # (2, buses + 1), w b of a current into a bus


class Around(NamedTuple):
    """What a mode does at ports and their sources do to it, c v and w b, (ports, 2), and Z, (ports, 2, 2)."""

    seen: Complex2
    moved: Complex2
    others: Complex3

    def of(self, rows: Sequence[int]) -> Around:
        """Of some of the ports."""
        some = list(rows)
        return Around(self.seen[some], self.moved[some], self.others[some])


class Effect(NamedTuple):
    """Effect of devices, each at its place: the mode's eigenvalue with it, and controllability; (modes, devices)."""

    values: Complex2  # 1/s
    controllability: Complex2  # 1/s per p.u.
    why_not: list[str]  # (devices,), reason if one is impossible; then its figures are NaN


def effects(system: System, devices: Sequence[Device], modes: Sequence[Eigenmode]) -> Effect:
    """Effect of new devices on modes of a system."""
    at_units = [i for i, device in enumerate(devices) if isinstance(device, AtUnit)]
    at_ports = [i for i, device in enumerate(devices) if not isinstance(device, AtUnit)]
    grid = _grid(system, [devices[i] for i in at_units])
    shapes = _modes(grid, modes)
    values = np.array([[mode.value] * len(devices) for mode in shapes])
    control, why_not = np.full(values.shape, np.nan + 0j), [""] * len(devices)
    for k, mode in enumerate(shapes):
        control[k, at_units] = (mode.left @ grid.model.B) * grid.model.late(mode.value)
    if not at_ports:
        return Effect(values, control, why_not)
    ports, plant = _ports(grid, [devices[i] for i in at_ports]), grid.built.plant
    around = [Around(*_seen_and_moved(mode, ports), _others(grid, mode, ports)) for mode in shapes]
    kinds: dict[str, list[int]] = {}
    rest: dict[int, AtRest] = {}
    for row, (i, response) in enumerate(zip(at_ports, ports.rest.tolist(), strict=True)):
        rest[row] = devices_alone.at_rest(devices[i], response, plant.omega_0, system.base_power)
        why_not[i] = rest[row].why_not
        if not why_not[i]:
            kinds.setdefault(devices[i].kind, []).append(row)
    for rows in kinds.values():
        places = [at_ports[row] for row in rows]
        of_kind = [devices[i] for i in places], [rest[row] for row in rows], ports.rest[rows]
        alone = devices_alone.linear(plant, *of_kind)
        for k, mode in enumerate(shapes):
            values[k, places], control[k, places] = _closed(alone, mode.value, around[k].of(rows))
    return Effect(values, control, why_not)


def _grid(system: System, at_units: Sequence[Device]) -> Grid:
    renamed = [device.model_copy(update={"name": f"{device.name}_{i}"}) for i, device in enumerate(at_units)]
    placed = place(system.model_copy(update={"devices": [*system.devices, *renamed]}))
    names = {pmu.name for pmu in placed.pmus}
    probes = [Pmu(name=free_name(bus.name, names), bus=bus.name) for bus in placed.buses]
    placed = placed.model_copy(update={"pmus": probes, "signals": {}})
    built = build(placed, [device.name for device in renamed], [], sparse=True)
    model = linear_model(built, {}, [pmu.name for pmu in probes])
    plant = built.plant
    net, machines, ports = plant.sparse_networks[0], len(plant.machines), len(plant.ports)
    inputs, fed = machines + len(plant.infinite) + ports, machines + ports
    at = net.outputs.row[net.outputs.begin[fed : fed + len(probes)]] - inputs
    bus = {bus.name: int(i) for bus, i in zip(placed.buses, at, strict=True) if i >= 0}
    return Grid(placed, built, model, cast("Descriptor", model.matrix), bus, 2 * fed, len(net.lower.begin) - 1)


def _modes(grid: Grid, modes: Sequence[Eigenmode]) -> list[Mode]:
    from scipy.sparse.linalg import splu  # noqa: PLC0415 (runs do without it)

    n, M = grid.matrix.states, grid.matrix.matrix.tocsc()
    lu = splu(M[n:, n:].tocsc())
    shapes = []
    for wanted in modes:
        value, right, left = eigenvalue_near(grid.matrix, wanted.eigenvalue)
        right = right / max(speeds(value, right, grid.built.state_names, grid.system).values(), key=abs)
        left = left / (left @ right)
        wide = [
            -(lu.solve(np.ascontiguousarray(b.real), way) + 1j * lu.solve(np.ascontiguousarray(b.imag), way))
            for b, way in ((M[n:, :n] @ right, "N"), (M[:n, n:].T @ left, "T"))
        ]
        voltage, moved_by = (
            np.pad(z[grid.first : grid.first + 2 * grid.buses].reshape(2, -1), ((0, 0), (0, 1))) for z in wide
        )
        shapes.append(Mode(value, left, right, voltage, moved_by))
    return shapes


def _ports(grid: Grid, devices: Sequence[Device]) -> Ports:
    """Places of devices at buses or next to the first end of lines."""
    voltage, lines = grid.built.flow.by_bus, {line.name: line for line in grid.system.lines}
    rows: list[tuple[tuple[str, str], Sequence[complex], Sequence[complex], complex]] = []
    for device in devices:
        if isinstance(device, Parallel):
            rows.append(((device.bus, device.bus), (1.0, 0.0), (1.0, 0.0), 0.0))
        elif isinstance(device, Series):
            line = lines[device.line or ""]
            y = line_section(line, grid.system.line_model)
            rows.append(((line.from_bus, line.to_bus), y[0].tolist(), y[:, 0].tolist(), -complex(y[0, 0])))
    ends = np.array([[grid.bus.get(bus, -1) for bus in buses] for buses, *_ in rows])
    read, feed = (np.array([row[i] for row in rows], complex) for i in (1, 2))
    at_ends = np.array([[voltage[bus] for bus in buses] for buses, *_ in rows])
    return Ports(ends, read, feed, np.array([row[3] for row in rows]), (read * at_ends).sum(axis=1))


def _turned(y: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Complex factors as matrices of real and imaginary parts."""
    return np.stack([np.stack([y.real, -y.imag], axis=-1), np.stack([y.imag, y.real], axis=-1)], axis=-2)


def _seen_and_moved(mode: Mode, ports: Ports) -> tuple[Complex2, Complex2]:
    """C v and w b of ports, (ports, 2)."""
    seen = np.einsum("peij,ipe->pj", _turned(ports.read).swapaxes(-1, -2), mode.voltage[:, ports.ends])
    moved = np.einsum("ipe,peij->pj", mode.moved_by[:, ports.ends], _turned(ports.feed))
    return seen, moved


def _others(grid: Grid, mode: Mode, ports: Ports) -> Complex3:
    """Z: responses of ports to their own sources without the mode, (ports, 2, 2)."""
    from scipy.sparse import csc_array  # noqa: PLC0415 (runs do without it)
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    n, M = grid.matrix.states, grid.matrix.matrix
    s = (1.0 + BESIDE) * mode.value
    diagonal = np.arange(n)
    lu = splu(csc_array(M - csc_array((np.full(n, s), (diagonal, diagonal)), M.shape)))
    ends = ports.ends
    Z = np.zeros((len(ends), 2, 2, 2, 2), complex)  # by read and fed bus, then by parts
    fed, begin = np.unique(ends[ends >= 0]), n + grid.first
    for i in range(0, len(fed), COLUMNS):
        some = fed[i : i + COLUMNS]
        unit = np.zeros((M.shape[0], 2 * len(some)), complex)
        for part in range(2):
            unit[begin + part * grid.buses + some, part * len(some) + np.arange(len(some))] = -1.0
        voltage = lu.solve(unit)[begin : begin + 2 * grid.buses].reshape(2, grid.buses, 2, len(some))
        for b in range(2):
            here = np.flatnonzero(np.isin(ends[:, b], some))
            column = np.searchsorted(some, ends[here, b])
            for a in range(2):
                there = (ends[here, a] >= 0)[:, None, None]
                Z[here, a, b] = voltage[:, ends[here, a], :, column] * there
    response = np.einsum("paij,pabjk,pbkl->pil", _turned(ports.read), Z, _turned(ports.feed)) + _turned(ports.direct)
    seen, moved = _seen_and_moved(mode, ports)
    others: Complex3 = response - seen[:, :, None] * moved[:, None, :] / (s - mode.value)
    return others


def _closed(alone: Alone, value: complex, around: Around) -> tuple[Complex1, Complex1]:
    """Eigenvalue and controllability with each device at its port, from the eigenvalue without."""
    seen, moved, Z = around

    def at(s: Complex1) -> tuple[Complex1, Complex1]:
        G, g = alone.at(s)
        right = np.concatenate([G @ seen[:, :, None], g], axis=2)
        answer = np.einsum("pi,pij->pj", moved, np.linalg.solve(np.eye(2) - G @ Z, right))
        return answer[:, 0], answer[:, 1]

    s: Complex1 = np.full(len(seen), value, np.complex128)
    step = 1e-4 * abs(value)
    for _ in range(STEPS):
        slope = (at(s + step)[0] - at(s - step)[0]) / (2.0 * step)
        s = s - (s - value - at(s)[0]) / (1.0 - slope)
    slope = (at(s + step)[0] - at(s - step)[0]) / (2.0 * step)
    return s, at(s)[1] / (1.0 - slope)
