"""The linear plant of a large grid as a sparse descriptor system: dx = f_x x + f_z z, 0 = g_x x + g_z z.

z: inputs of the network, voltages of its buses, and its outputs, real and imaginary parts. Machines, loads, devices and
PMUs are coupled by the network alone, so with given outputs one difference quotient finds a column of each of them (A.
R. Curtis, M. J. D. Powell, J. K. Reid, On the Estimation of Sparse Jacobian Matrices, IMA J. Applied Mathematics 13(1),
1974). Modes near a shift s are those with the largest eigenvalues of (A - s)^-1 (J. Rommes, N. Martins, Efficient
Computation of Transfer Function Dominant Poles Using Subspace Acceleration, IEEE Trans. Power Systems 21(3), 2006).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling.structs import Table
from facts_damping.errors import InputError
from facts_damping.numerics.matrices import STEPS, product, shift_near
from facts_damping.numerics.phasors import magnitudes, over
from facts_damping.plant.converters.site import INVERTER, LOAD, SALIENT
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.grid.sparse import ComplexEntries, factors, solve_network, substitute
from facts_damping.plant.grid.sparse_network import SparseNetwork
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import Plant, PlantState, copy, workspace
from facts_damping.signals import CHANNELS, DEVICE_TRUTH, MACHINE_TRUTH

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Complex1, Complex2, Float1, Float2, Int1

STEP = 1e-6  # of the central differences, p.u., rad
DENSE_STATES = 3000  # largest number of states of a dense state matrix
ALL_MODES = 1000  # largest number of states of which all modes are found
SHIFTS_HZ = np.arange(1, 26, 2) / 10.0  # on the imaginary axis
NEAREST = 20  # modes found at each shift
TOLERANCE = 1e-9  # of eigenvalues, relative to their distance from the shift
SPEED = list(CHANNELS).index("speed_deviation")


class Descriptor(NamedTuple):
    """[f_x f_z; g_x g_z], sparse, and the number of states."""

    matrix: Any
    states: int


def is_partial(matrix: Any) -> bool:
    """Whether only the modes of `eigenvectors` are found, not all."""
    return isinstance(matrix, Descriptor) and matrix.states > ALL_MODES


def solved(A: Descriptor, s: complex, b: NDArray[Any]) -> NDArray[Any]:
    """Solution x of (s - A) x = b."""
    wide = np.zeros((A.matrix.shape[0], *b.shape[1:]), np.complex128)
    wide[: A.states] = -b
    return solve_network(_shifted(A, s), wide)[: A.states]


def row_times(A: Descriptor, row: Float1) -> Float1:
    """A row times the state matrix."""
    n = A.states
    whole = A.matrix.T @ np.concatenate([row, np.zeros(A.matrix.shape[0] - n)])
    reduced: Float1 = whole[:n] - A.matrix[n:, :n].T @ solve_network(A.matrix[n:, n:].T.tocsc(), whole[n:])
    return reduced


def dense(A: Descriptor) -> Float2:
    """The state matrix f_x - f_z g_z^-1 g_x. Raises `InputError` if it has more than DENSE_STATES states."""
    n = A.states
    if n > DENSE_STATES:
        raise InputError(f"system: a plant of {n} states given; allowed: at most {DENSE_STATES}, or a smaller `model`")
    f_x, to, of, z = (A.matrix[rows][:, at] for rows in (slice(n), slice(n, None)) for at in (slice(n), slice(n, None)))
    matrix: Float2 = f_x.toarray() - to @ solve_network(z.tocsc(), of.toarray())
    return matrix


def _shifted(A: Descriptor, s: complex) -> Any:
    from scipy.sparse import csc_array  # noqa: PLC0415 (of large systems alone)

    at = np.arange(A.states)
    return csc_array(A.matrix - csc_array((np.full(A.states, s), (at, at)), A.matrix.shape))


def eigenvectors(A: Descriptor) -> tuple[Complex1, Complex2, Complex2]:
    """The eigenvalues nearest SHIFTS_HZ on the imaginary axis, left eigenvectors, and right ones, in columns.

    An eigenvalue counts at the shift to which it is nearest. The left invariant subspace W at a shift gives the left
    vectors, those with W^T V = 1.
    """
    near_shifts = [_near(A, 2j * np.pi * hertz) for hertz in SHIFTS_HZ]
    values, left, right = (np.concatenate([near[i] for near in near_shifts], axis=-1) for i in range(3))
    apart = np.abs(values[:, None] - 2j * np.pi * SHIFTS_HZ)
    nearest = np.repeat(np.arange(len(near_shifts)), [len(near[0]) for near in near_shifts]) == apart.argmin(axis=1)
    return values[nearest], left[:, nearest], right[:, nearest]


def _near(A: Descriptor, s: complex) -> tuple[Complex1, Complex2, Complex2]:
    from scipy.sparse.linalg import LinearOperator, eigs, splu  # noqa: PLC0415 (runs do without it)

    n, lu = A.states, splu(_shifted(A, s))
    spaces = []
    for way in ("N", "T"):

        def inverse(b: Complex1, way: str = way) -> Complex1:
            wide = np.concatenate([b.ravel(), np.zeros(A.matrix.shape[0] - n)])
            return np.asarray(lu.solve(wide, way)[:n])

        operator = LinearOperator((n, n), matvec=inverse, dtype=np.complex128)
        start = np.array(1.0 / np.arange(1.0, n + 1), np.complex128)
        values, vectors = eigs(operator, NEAREST, which="LM", v0=start, ncv=min(n, 3 * NEAREST), tol=TOLERANCE)
        spaces.append((s + 1.0 / values, vectors))
    (values, right), (_, left) = spaces
    return values, left @ np.linalg.inv(right.T @ left), right


def eigenvalue_near(A: Descriptor, guess: complex) -> tuple[complex, Complex1, Complex1]:
    """As `matrices.eigenvalue_near`: the eigenvalue (1/s) nearest a guess, and its right and left vectors."""
    shift, n = shift_near(guess), A.states
    pencil = _shifted(A, shift)
    ways = [factors(matrix, complex) for matrix in (pencil, pencil.T)]
    start = np.array(1.0 / np.arange(1.0, n + 1), np.complex128)
    vectors, before = [start, start], [start, start]
    for _ in range(STEPS):
        before = [over(v, v[np.argmax(magnitudes(v))]) for v in vectors]
        wide = [np.concatenate([v, np.zeros(pencil.shape[0] - n)]) for v in before]
        vectors = [substitute(*pair)[:n] for pair in zip(ways, wide, strict=True)]
    (old, _), (right, left) = before, vectors
    value = shift + complex(over(product(left, old), product(left, right)))
    return value, over(right, right[np.argmax(magnitudes(right))]), over(left, left[np.argmax(magnitudes(left))])


class Linear(NamedTuple):
    """The linear plant: its state matrix, and dense B (states, devices), C (outputs, states), D (outputs, devices)."""

    A: Descriptor
    B: Float2
    C: Float2
    D: Float2


def linearised(plant: Plant, state: PlantState, weights: Float2) -> Linear:
    """The linear plant at its start with weighted channels of the frames as outputs; `weights`: (outputs, frame)."""
    from scipy.sparse import block_array, csc_array  # noqa: PLC0415 (of large systems alone)

    n, machines, infinite = len(state.x), len(plant.machines), len(plant.infinite)
    work = workspace(plant, state)
    derivatives(plant, state.x, state.reference, copy(state).source, 0, np.zeros(n), work)
    net = plant.sparse_networks[0]
    many, buses = len(work.inputs), len(work.voltage)
    count = len(net.outputs.begin) - 1

    def whole(complex_entries: ComplexEntries, rows: int) -> Any:
        return csc_array(
            (complex_entries.value, complex_entries.row, complex_entries.begin), (rows, len(complex_entries.begin) - 1)
        )

    outputs = whole(net.outputs, many + buses).T.tocsc()
    network_outputs = outputs @ np.concatenate([work.inputs, work.voltage])
    upper = net.upper.value.copy()
    upper[net.upper.begin[1:] - 1] = 1.0 / upper[net.upper.begin[1:] - 1]
    admittance = whole(net.lower, buses) @ csc_array((upper, net.upper.row, net.upper.begin), (buses, buses))
    fed = np.r_[:machines, machines + infinite : many]  # infinite buses stay as they are
    local, frames = local_parts(plant, state, network_outputs)
    states_part = local[:, : n + 2 * count].tocsc()
    x_x, i_x, x_y, i_y = states_part[:n, :n], states_part[n:, :n], states_part[:n, n:], states_part[n:, n:]
    one_i, one_y = (csc_array((np.ones(m), (range(m), range(m))), (m, m)) for m in (2 * len(fed), 2 * count))
    into = _real(whole(net.inputs, buses)[:, fed])
    parts = [
        [x_x, None, None, x_y],
        [i_x, -one_i, None, i_y],
        [None, into, -_real(admittance), None],
        [None, _real(outputs[:, fed]), _real(outputs[:, many:]), -one_y],
    ]
    matrix = block_array(parts, format="csc")
    A, size = Descriptor(matrix, n), matrix.shape[0]
    from_inputs = np.zeros((size, len(state.reference)))
    from_inputs[: n + 2 * len(fed)] = local[:, n + 2 * count :].toarray()
    seen = np.zeros((len(weights), size))
    seen[:, :n], seen[:, size - 2 * count :] = (weights @ part for part in (frames[:, :n], frames[:, n:]))
    inner = matrix[n:, n:].tocsc()
    answer = solve_network(inner, from_inputs[n:])
    rows = solve_network(inner.T.tocsc(), seen[:, n:].T).T
    B = from_inputs[:n] - matrix[:n, n:] @ answer
    return Linear(A, B, seen[:, :n] - rows @ matrix[n:, :n], -seen[:, n:] @ answer)


def _real(a: Any) -> Any:
    """A complex sparse matrix for real parts over imaginary ones."""
    from scipy.sparse import block_array  # noqa: PLC0415 (of large systems alone)

    return block_array([[a.real, -a.imag], [a.imag, a.real]], format="csc")


def local_parts(plant: Plant, state: PlantState, network_outputs: Complex1) -> tuple[Any, Any]:
    """Derivatives by states, network outputs and references: of slopes and network inputs, and of frames.

    The second has no columns of references.
    """
    n, count = len(state.x), len(network_outputs)
    apart = _with_outputs_given(plant, count)
    work, pmus = workspace(apart, state), len(plant.pmu_machine)
    machines, devices = np.zeros(len(plant.machines), MACHINE_TRUTH), np.zeros(len(plant.devices), DEVICE_TRUTH)
    fed = np.r_[: len(machines), len(machines) + count : len(work.inputs)]

    def answer(values: Float1) -> Float1:
        x, y, u = np.split(values, [n, n + 2 * count])
        driven = apart._replace(infinite=y[:count] + 1j * y[count:])
        slope, frame = np.zeros(n), np.zeros((pmus, len(CHANNELS)))
        moved = copy(state)._replace(x=x, reference=u)
        derivatives(driven, x, u, moved.source, 0, slope, work)
        inputs = work.inputs[fed]
        measure(driven, moved, 0, frame, machines, devices, work)
        return np.concatenate([slope, inputs.real, inputs.imag, np.nan_to_num(frame.ravel())])

    of_states, of_inputs, of_outputs, of_references = _groups(plant, n)
    columns = np.concatenate([of_states, of_outputs, of_outputs, of_references])
    of_pmus = of_outputs[len(machines) + len(plant.ports) :][:pmus]
    of_frames = np.repeat(of_pmus, len(CHANNELS))
    rows = np.concatenate([of_states, of_inputs, of_inputs, of_frames])
    at = np.concatenate([state.x, network_outputs.real, network_outputs.imag, state.reference])
    jacobian = _differences(answer, at, rows, columns)
    frames = jacobian[n + 2 * len(fed) :, : n + 2 * count].tolil()
    for s, g in enumerate(plant.pmu_machine):
        if g >= 0:
            frames[s * len(CHANNELS) + SPEED] = 0.0
            frames[s * len(CHANNELS) + SPEED, plant.machines["offset"][g] + 1] = 1.0
    return jacobian[: n + 2 * len(fed)], frames.tocsr()


def _differences(f: Callable[[Float1], Float1], at: Float1, rows: Int1, columns: Int1) -> Any:
    """Jacobian of f, whose rows depend on the columns of the same group alone, by central differences; sparse."""
    from scipy.sparse import csr_array  # noqa: PLC0415 (of large systems alone)

    order = np.argsort(columns, kind="stable")
    place = np.arange(len(order)) - np.searchsorted(columns[order], columns[order])
    entries = []
    for k in range(int(place.max(initial=-1)) + 1):
        moved = order[place == k]
        step = np.zeros(len(at))
        step[moved] = STEP * np.maximum(1.0, np.abs(at[moved]))
        up, down = at + step, at - step
        change = f(up) - f(down)
        column_of = np.full(max(rows.max(), columns.max()) + 1, -1)
        column_of[columns[moved]] = moved
        column = column_of[rows]
        changed = (column >= 0) & (change != 0.0)
        entries.append((change[changed] / (up - down)[column[changed]], np.flatnonzero(changed), column[changed]))
    value, row, column = (np.concatenate(part) for part in zip(*entries, strict=True))
    return csr_array((value, (row, column)), (len(rows), len(at)))


def _groups(plant: Plant, states: int) -> tuple[Int1, Int1, Int1, Int1]:
    """Group of each state, network input, output and reference: a machine, load, device or PMU."""
    machines, loads, devices = len(plant.machines), len(plant.loads), len(plant.placed)
    of_devices, inverters = machines + loads + np.arange(devices), machines + loads + devices
    at_controls = plant.placed["machine"], inverters + plant.placed["inverter"]
    of_devices = np.where(plant.placed["port"] < 0, np.where(plant.placed["inverter"] < 0, *at_controls), of_devices)
    stateful = (plant.placed["states"] > 0) | (plant.placed["response_time"] > 0.0)
    many, rows = len(plant.inverters), plant.blocks["state"]
    least = [min((s for s in rows[v["first"] : v["end"]] if s >= 0), default=-1) for v in plant.inverters]
    begin = np.concatenate([plant.machines["offset"], plant.loads["offset"], plant.placed["offset"][stateful], least])
    group = np.concatenate([np.arange(machines + loads), of_devices[stateful], inverters + np.arange(many)])
    group, begin = group[begin >= 0], begin[begin >= 0]
    order = np.argsort(begin)
    of_states = group[order][np.searchsorted(begin[order], np.arange(states), side="right") - 1]
    kind, row = plant.ports["kind"], plant.ports["row"]
    before = {SALIENT: 0, LOAD: machines, INVERTER: inverters}
    of_ports = np.array(
        [before[k] + r if k in before else of_devices[r] for k, r in zip(kind, row, strict=True)], np.int64
    )
    inputs = np.concatenate([np.arange(machines), of_ports])
    pmus = inverters + many + np.arange(len(plant.pmu_machine))
    metered = inverters + np.flatnonzero(plant.inverters["bus"] >= 0)
    outputs = np.concatenate([inputs, pmus, pmus, metered, metered])
    return of_states, inputs, outputs, of_devices[: len(plant.devices)]


def _with_outputs_given(plant: Plant, count: int) -> Plant:
    """The plant with a network that gives each output from a source of its own, in place of the infinite buses."""
    machines, ports = plant.machines.copy(), len(plant.ports)
    first, more = len(machines), count - len(plant.infinite)
    machines["column"] += np.where(machines["column"] >= first, more, 0)
    none = ComplexEntries(np.zeros(1, np.int64), np.zeros(0, np.int64), np.zeros(0, np.complex128))
    outputs = ComplexEntries(np.arange(count + 1), first + np.arange(count), np.ones(count, np.complex128))
    net = SparseNetwork(
        lower=none,
        upper=none,
        inputs=none._replace(begin=np.zeros(first + count + ports + 1, np.int64)),
        outputs=outputs,
        own=np.zeros(ports, np.complex128),
    )
    return plant._replace(
        machines=machines,
        infinite=np.zeros(count, np.complex128),
        island=np.zeros((len(plant.interval_start_ns), first + count + len(plant.inverters)), np.int64),
        sparse_networks=Table([net] * len(plant.interval_start_ns)),
    )
