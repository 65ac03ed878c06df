"""Linear model of the plant, by differences of the compiled functions, and its transfer functions."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.control.inputs import pmu_weights
from facts_damping.numerics.matrices import product
from facts_damping.numerics.phasors import exponentials, over, times
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
    from facts_damping.plant.build import Built

STEP = 1e-6  # of the central differences, p.u., rad
ANGLE = "voltage_angle"
TURNING = {"frequency": 1, "rocof": 2}  # channels that are derivatives of the voltage's angle, and their order


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
    filters = None
    if measured is not None and measured.delay > 0:
        filters = filtered(measured, [part.channel for part in signals.values()], sampled_C, sampled_D, frame_rate)
    washout = np.array([signal.washout for signal in signals.values()])
    return LinearModel(A, B, C, D, washout, filters, plant.devices["dead_ns"] / NANOSECONDS)


def weights_of(signal: Signal, pmus: Sequence[str], nominal: float, channel: str | None = None) -> Float2:
    """Weights of a signal over all PMUs' channels, (PMUs, channels).

    `nominal`: frequency, Hz; `channel`: the weighted channel, by default the signal's.
    """
    weights = np.zeros((len(pmus), len(CHANNELS)))
    weights[:, list(CHANNELS).index(channel or signal.channel)] = pmu_weights(signal, pmus, nominal)
    return weights


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
    functions = []
    for d, device in enumerate(devices):
        for s, signal in enumerate(signals):
            D = model.D[s, d] if abs(model.D[s, d]) > 1e-7 else 0.0  # smaller values are round-off of the differences
            pencil = np.block([[model.A, model.B[:, [d]]], [model.C[[s]], np.array([[D]])]])
            values = eig(pencil, right, right=False)
            zeros, all_poles = values[np.isfinite(values) & (np.abs(values) < 1e6)], poles
            if model.washout[s] > 0.0:
                zeros, all_poles = np.append(zeros, 0.0), np.append(poles, -1.0 / model.washout[s])
            value = (model.response(probe) / model.late(probe))[s, d]
            gain = value * np.exp(np.log(probe - all_poles).sum() - np.log(probe - zeros).sum())  # products overflow
            zeros_and_poles = float(gain.real), zeros.tolist(), all_poles.tolist()
            dead_time = float(np.broadcast_to(model.dead_time, len(devices))[d])
            functions.append(TransferFunction(device, signal, *zeros_and_poles, float(D), dead_time))
    return functions
