"""Small-signal analysis: linearisation of the compiled plant functions, modes, mode shapes, residues."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.control.inputs import pmu_weights
from facts_damping.matrices import product
from facts_damping.phasors import exponentials, over, times
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import copy, workspace
from facts_damping.signals import CHANNELS, DEVICE_TRUTH, MACHINE_TRUTH, NANOSECONDS
from facts_damping.small_signal import descriptor
from facts_damping.small_signal.descriptor import Descriptor
from facts_damping.small_signal.sampled_output import Filtered, filtered

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Complex1, Complex2, Float1, Float2
    from facts_damping.measurement.filters import Filter
    from facts_damping.parameters.plant.pmus import Signal
    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built

STEP = 1e-6  # of the central differences, p.u., rad
NEGLIGIBLE = 0.02  # participation of a state in a mode below which it is not listed
ANGLE = "voltage_angle"
TURNING = {"frequency": 1, "rocof": 2}  # channels that are derivatives of the voltage's angle, and their order
SWING_FRACTION = 0.5  # least participation of rotor angles and speeds in an electromechanical mode
COMMON_FRACTION = 0.2  # the same for a mode with all machines in phase, in which governors participate


class LinearModel(NamedTuple):
    """dx = A x + B u, y = C x + D u, deviations from the start: u the devices' references, y the signals, p.u.

    y is before the signals' washouts and the PMUs' filters (`filtered`). A frequency is the derivative of the voltage's
    angle along the plant's trajectory, without the impulse of a setpoint's jump.
    """

    matrix: Float2 | Descriptor  # A, (states, states), 1/s; of a large grid sparse
    B: Float2  # (states, devices)
    C: Float2  # (signals, states)
    D: Float2  # (signals, devices)
    washout: Float1  # (signals,), time constants, s; 0: none
    filtered: Filtered | None = None
    dead_time: NDArray[np.float64] | float = 0.0  # (devices,), s, from a setpoint to its reference

    def response(self, s: complex) -> Complex2:
        """Transfer functions from setpoints, F (C (s I - A)^-1 B + D) exp(-s Td), s in 1/s, (signals, devices)."""
        A, B = self.matrix, self.B
        states = descriptor.solved(A, s, B) if isinstance(A, Descriptor) else np.linalg.solve(s * np.eye(len(A)) - A, B)
        C, D = self.seen
        return np.asarray(self.gain(s)[:, None] * (C @ states + D) * self.late(s))

    def late(self, s: complex) -> Complex1:
        """Dead times exp(-s Td) of all devices at a complex frequency (1/s); 1 without dead time."""
        return exponentials(-s * np.asarray(self.dead_time))

    @property
    def A(self) -> Float2:
        """The state matrix; of a large grid it is made here. Raises `InputError` if it is too large."""
        return descriptor.dense(self.matrix) if isinstance(self.matrix, Descriptor) else self.matrix

    @property
    def seen(self) -> tuple[Float2, Float2]:
        """Matrices C and D of the filters' inputs: of the samples for PMUs with a filter, else of the signals."""
        return (self.C, self.D) if self.filtered is None else (self.filtered.C, self.filtered.D)

    def gain(self, s: complex) -> Complex1:
        """F of all signals at a complex frequency (1/s): washouts s T / (1 + s T), and filters with their delay."""
        washed = np.where(self.washout > 0.0, over(s * self.washout, 1.0 + s * self.washout), 1.0 + 0j)
        return washed if self.filtered is None else times(washed, self.filtered.gain(s))


class Residue(NamedTuple):
    """Residue (1/s) of a mode from a device's input to a signal, and the phase needed from a controller u = K y.

    A gain K of the given sign and with a phase lead (deg) at the mode's frequency shifts the eigenvalue by R K to
    the left.
    """

    device: str
    signal: str
    magnitude: float
    angle_deg: float
    sign: int
    lead_deg: float


class Eigenmode(NamedTuple):
    """A mode: eigenvalue (1/s), frequency (Hz), damping ratio, participation of each state, mode shape.

    `label` is interarea, local, electromechanical (no areas are given), common (all together) or control; `shape` is
    the speed of each machine relative to the fastest, complex.
    """

    eigenvalue: complex
    frequency_hz: float
    damping_ratio: float
    participation: dict[str, float]
    label: str
    shape: dict[str, complex]
    residues: list[Residue]

    @property
    def swings(self) -> bool:
        """Whether machines swing against each other in this mode."""
        return self.label not in ("common", "control")


def _central(f: Callable[[Float1], Float1], at: Float1) -> Float2:
    """Jacobian of f by central differences, one column per argument."""
    columns = []
    for i in range(len(at)):
        step = STEP * max(1.0, abs(at[i]))
        up, down = at.copy(), at.copy()
        up[i] += step
        down[i] -= step
        columns.append((f(up) - f(down)) / (up[i] - down[i]))
    return np.array(columns).T if columns else np.zeros((len(f(at)), 0))


def linearise(built: Built) -> tuple[Float2, Float2]:
    """State matrix A (states, states) and input matrix B (states, devices) at the start, 1/s.

    dx = A dx + B du with u the devices' references, p.u.; central differences of `derivatives`.
    """
    A, B = state_matrix(built)
    return descriptor.dense(A) if isinstance(A, Descriptor) else A, B


def state_matrix(built: Built) -> tuple[Float2 | Descriptor, Float2]:
    """As `linearise`; A of a large grid is sparse."""
    plant, state = built.plant, built.state
    if len(plant.sparse_networks) > 0:
        large = descriptor.linearised(plant, state, np.zeros((0, len(plant.pmu_machine) * len(CHANNELS))))
        return large.A, large.B
    work = workspace(plant, state)

    def slope(x: Float1, reference: Float1) -> Float1:
        dx = np.zeros_like(x)
        derivatives(plant, x, reference, copy(state).source, 0, dx, work)
        return dx

    return _central(lambda x: slope(x, state.reference), state.x), _central(
        lambda reference: slope(state.x, reference), state.reference
    )


def linear_model(
    built: Built,
    signals: Mapping[str, Signal],
    pmus: Sequence[str],
    measured: Filter | None = None,
    frame_rate: int = 1,
) -> LinearModel:
    """The linear plant at its start, from the devices' references to the PMUs' signals.

    `measured`: the filter of its PMUs at a frame rate; None: exact signals.
    """
    plant, state = built.plant, built.state
    work = workspace(plant, state)
    machines, devices = np.zeros(len(plant.machines), MACHINE_TRUTH), np.zeros(len(plant.devices), DEVICE_TRUTH)
    nominal = plant.omega_0 / (2.0 * np.pi)
    weights = np.zeros((len(signals), len(pmus), len(CHANNELS)))
    for i, signal in enumerate(signals.values()):
        weights[i] = weights_of(signal, pmus, nominal, ANGLE if signal.channel in TURNING else signal.channel)

    def seen(x: Float1, reference: Float1) -> Float1:
        frame = np.zeros((len(pmus), len(CHANNELS)))
        measure(plant, copy(state)._replace(x=x, reference=reference), 0, frame, machines, devices, work)
        return product(weights.reshape(len(signals), frame.size), np.nan_to_num(frame.ravel()))

    A: Float2 | Descriptor
    if len(plant.sparse_networks) > 0:
        A, B, C, D = descriptor.linearised(plant, state, weights.reshape(len(signals), len(pmus) * len(CHANNELS)))
    else:
        A, B = state_matrix(built)
        C = _central(lambda x: seen(x, state.reference), state.x)
        D = _central(lambda reference: seen(state.x, reference), state.reference)
    sampled_C, sampled_D = C.copy(), D.copy()
    # Frequency: the angle's derivative is exact here; nested difference quotients would not be.
    for i, signal in enumerate(signals.values()):
        for _ in range(TURNING.get(signal.channel, 0)):
            D[i] = product(C[i], B)
            C[i] = descriptor.row_times(A, C[i]) if isinstance(A, Descriptor) else product(C[i], A)
        if signal.channel in TURNING:
            C[i], D[i] = C[i] / (2.0 * np.pi), D[i] / (2.0 * np.pi)
    own = None
    if measured is not None and measured.delay > 0:
        own = filtered(measured, [one.channel for one in signals.values()], sampled_C, sampled_D, frame_rate)
    washout = np.array([signal.washout for signal in signals.values()])
    return LinearModel(A, B, C, D, washout, own, plant.devices["dead_ns"] / NANOSECONDS)


def weights_of(signal: Signal, pmus: Sequence[str], nominal: float, channel: str | None = None) -> Float2:
    """Weights of a signal over all PMUs' channels, (PMUs, channels).

    `nominal`: frequency, Hz; `channel`: the weighted channel, by default the signal's.
    """
    made = np.zeros((len(pmus), len(CHANNELS)))
    made[:, list(CHANNELS).index(channel or signal.channel)] = pmu_weights(signal, pmus, nominal)
    return made


def eigenvectors(matrix: Float2 | Descriptor) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Eigenvalues of a matrix, left eigenvectors, as in w A = lambda w, and right ones, in columns.

    With more than `descriptor.ALL_MODES` states of a large grid only those of `descriptor.eigenvectors`.
    """
    from scipy.linalg import eig  # noqa: PLC0415 (runs do without it)

    if isinstance(matrix, Descriptor):
        if descriptor.is_partial(matrix):
            return descriptor.eigenvectors(matrix)
        matrix = descriptor.dense(matrix)
    values, left, right = eig(matrix, left=True, right=True)  # no inverse: drifts have no full set of eigenvectors
    return values, left.conj(), right


def modes(
    matrix: Float2 | Descriptor,
    names: Sequence[str],
    system: System | None = None,
    model: LinearModel | None = None,
    devices: Sequence[str] = (),
) -> list[Eigenmode]:
    """Modes of a state matrix, one per conjugate pair, sorted by falling real part.

    Frequency |Im| / (2 pi), damping ratio -Re / |lambda|; participation |w_k v_k| of state k, left times right
    eigenvector, scaled to sum one (Kundur 1994, 12.2). With a linear model of the system's signals, the
    electromechanical modes have residues F (C v)(w B) exp(-lambda Td), w scaled to w v = 1 (12.3.4), F the signals'
    washouts, Td the devices' dead times.
    """
    values, left, right = eigenvectors(matrix)
    found = []
    for i in np.argsort(-values.real):
        if values[i].imag < 0:
            continue
        v, w = right[:, i], left[:, i]
        one = mode(complex(values[i]), v, w, names, system)
        if model is not None and system is not None and one.swings:
            seen = model.gain(values[i]) * (model.seen[0] @ v)
            matrix_of_residues = np.outer(seen, w @ model.B) / (w @ v) * model.late(values[i])
            one = one._replace(residues=_residues(matrix_of_residues, list(system.signals), devices))
        found.append(one)
    return found


def mode(
    eigenvalue: complex, right: NDArray[Any], left: NDArray[Any], names: Sequence[str], system: System | None = None
) -> Eigenmode:
    """A mode, without residues, from its eigenvalue (1/s) and eigenvectors; `names`: of the states.

    `left` as in w A = lambda w. The speeds of the system's machines are among the states.
    """
    fraction = np.abs(left * right)
    fraction /= fraction.sum()
    listed = {names[k]: float(fraction[k]) for k in np.argsort(-fraction)[: int((fraction >= NEGLIGIBLE).sum())]}
    size = abs(eigenvalue)
    ratio = float(-eigenvalue.real / size) if size > 0 else 0.0
    angles, turning = _rotors(tuple(names))
    speeds = {name: complex(right[k]) for name, k in turning.items()}
    maximum = max(speeds.values(), key=abs, default=0j)
    shape = {name: value / maximum if maximum else value for name, value in speeds.items()}  # the largest is one
    label = _label(float(fraction[[*angles.values(), *turning.values()]].sum()), shape, system)
    return Eigenmode(eigenvalue, float(eigenvalue.imag / (2 * np.pi)), ratio, listed, label, shape, [])


@cache
def _rotors(names: tuple[str, ...]) -> tuple[dict[str, int], dict[str, int]]:
    """Places of rotor angles and speeds among the states, by machine."""
    ends = (".delta", ".omega")
    angles, speeds = ({name.removesuffix(end): k for k, name in enumerate(names) if name.endswith(end)} for end in ends)
    return angles, speeds


def unlike(some: Sequence[Eigenmode], others: Sequence[Eigenmode]) -> Float2:
    """Differences of modes, (some, others): relative change of eigenvalue plus 1 - MAC of the shapes, at most 1."""
    a, b = (np.array([list(mode.shape.values()) for mode in modes], complex) for modes in (some, others))
    if not (len(a) and len(b)):
        return np.ones((len(a), len(b)))
    own, other = (np.array([mode.eigenvalue for mode in modes]) for modes in (some, others))
    sizes = np.multiply.outer(*((np.abs(one) ** 2).sum(axis=1) for one in (a, b)))
    alike = np.abs(a.conj() @ b.T) ** 2 / np.where(sizes > 0.0, sizes, np.inf)
    return np.asarray(np.minimum(1.0, np.abs(own[:, None] - other) / np.abs(own)[:, None] + 1.0 - alike))


def _label(swing: float, shape: dict[str, complex], system: System | None) -> str:
    """The kind of a mode, by the kinetic energy of the common motion, of the areas' motion, and of the rest.

    sum_A (sum H S) |mean_A|^2 against sum H S |v|^2, means weighted by H S: interarea if the areas' means have more
    than half.
    """
    if system is None or swing < COMMON_FRACTION:
        return "control"
    inertia = {m.name: m.H * m.rating for m in system.machines}
    areas: dict[str, list[str]] = {}
    for m in system.machines:
        areas.setdefault(m.area or "", []).append(m.name)

    def moving(group: Sequence[str]) -> float:
        weight = sum(inertia[name] for name in group)
        return float(abs(sum(inertia[name] * shape[name] for name in group)) ** 2 / weight)

    total = sum(inertia[name] * abs(shape[name]) ** 2 for name in inertia)
    together = moving(list(inertia))
    if not system.infinite_buses and together > 0.5 * total:
        return "common"
    if swing < SWING_FRACTION:
        return "control"
    if "" in areas:
        return "electromechanical"
    by_area = sum(moving(group) for group in areas.values())
    return "interarea" if by_area > 0.5 * total and len(areas) > 1 else "local"


def _residues(matrix: NDArray[Any], signals: Sequence[str], devices: Sequence[str]) -> list[Residue]:
    """Residues from each device to each signal, with the sign and the lead that turn R K to -180 degrees."""
    found = []
    for d, device in enumerate(devices):
        for s, signal in enumerate(signals):
            angle = float(np.rad2deg(np.angle(matrix[s, d])))
            found.append(Residue(device, signal, float(abs(matrix[s, d])), angle, *sign_and_lead(angle)))
    return found


def sign_and_lead(angle_deg: float) -> tuple[int, float]:
    """Sign of a gain, and its phase lead (deg, at most 90 to either side), that turn an angle to -180 degrees."""
    lead = (180.0 - angle_deg + 180.0) % 360.0 - 180.0
    sign = 1 if abs(lead) <= 90.0 else -1
    return sign, lead if sign == 1 else (lead + 360.0) % 360.0 - 180.0


class TransferFunction(NamedTuple):
    """Transfer function from a device's input to a signal: gain prod(s - z) / prod(s - p), zeros in 1/s.

    A dead time multiplies it by exp(-s Td). `feedthrough` is its value at s = inf.
    """

    device: str
    signal: str
    gain: float
    zeros: list[complex]
    poles: list[complex]
    feedthrough: float
    dead_time_s: float


def transfer_functions(model: LinearModel, signals: Sequence[str], devices: Sequence[str]) -> list[TransferFunction]:
    """Zeros and gains from each device to each signal: zeros where [A - s I, B; C, D] is singular; poles are A's.

    A washout adds a zero at 0 and a pole at -1 / T. None with more than `descriptor.ALL_MODES` states of a large grid.
    """
    if descriptor.is_partial(model.matrix):
        return []
    from scipy.linalg import eig  # noqa: PLC0415 (it takes longer than a run, and few need it)

    poles = np.linalg.eigvals(model.A)
    n = len(model.A)
    right = np.diag([1.0] * n + [0.0])
    probe = 1j * 2 * np.pi + 1.0  # 1/s, where the gain is evaluated
    found = []
    for d, device in enumerate(devices):
        for s, signal in enumerate(signals):
            D = model.D[s, d] if abs(model.D[s, d]) > 1e-7 else 0.0  # smaller values are round-off of the differences
            pencil = np.block([[model.A, model.B[:, [d]]], [model.C[[s]], np.array([[D]])]])
            values = eig(pencil, right, right=False)
            zeros, own = values[np.isfinite(values) & (np.abs(values) < 1e6)], poles
            if model.washout[s] > 0.0:
                zeros, own = np.append(zeros, 0.0), np.append(poles, -1.0 / model.washout[s])
            value = (model.response(probe) / model.late(probe))[s, d]
            gain = value * np.exp(np.log(probe - own).sum() - np.log(probe - zeros).sum())  # products overflow
            zeros_and_poles = float(gain.real), zeros.tolist(), own.tolist()
            dead_time = float(np.broadcast_to(model.dead_time, len(devices))[d])
            found.append(TransferFunction(device, signal, *zeros_and_poles, float(D), dead_time))
    return found
