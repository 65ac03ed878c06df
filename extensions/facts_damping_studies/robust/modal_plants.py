"""The linear plant of a grid in its modes: what a controller moves and what the performance index sees.

With right and left eigenvectors v, w, w v = 1, and for each mode with a non-negative imaginary part

    dz/dt = lambda z + (w B) u,   y = 2 Re(sum (C v) z) + D u,   speed differences = 2 Re(sum (Z v) z)

(a real mode counts once), u the devices' setpoints. A step of the torque on a rotor leaves the swings at a distance
w G / lambda from the new equilibrium. Modes are left out that neither a device moves as the signals or the speed
differences see it, nor a torque as the speed differences do; D takes their part over (P. Kundur, Power System Stability
and Control, 1994, 12.3; modal truncation: G. Rogers, Power System Oscillations, 2000, 7).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.small_signal import descriptor
from facts_damping.small_signal.descriptor import Descriptor
from facts_damping.small_signal.eigenmodes import eigenvectors, mode
from facts_damping.small_signal.linearisation import LinearModel, linear_model
from facts_damping_studies.score.reference import speed_differences

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.plant.build import Built
    from facts_damping.small_signal.sampled_output import Filtered

    Array = NDArray[np.float64]
    Complex = NDArray[np.complex128]

BAND_HZ = (0.1, 2.5)  # in which modes are judged
FITTED_HZ = (0.15, 0.4, 0.8, 1.4, 2.2)  # at which D takes over what is left out
MOVED, SHOWN = 0.005, 0.02  # effect of a mode that stays, relative to the largest: of devices, of torques
FASTEST = 40.0  # 1/s, magnitude of the eigenvalues of modes that stay


class ModalPlant(NamedTuple):
    """A plant in its modes; signals are before washouts and filters, p.u."""

    values: Complex  # (modes,), 1/s
    swings: NDArray[np.bool_]  # (modes,), electromechanical
    B: Complex  # (modes, devices)
    C: Complex  # (signals, modes)
    D: Array  # (signals, devices)
    R: Complex  # (modes, machines), of swings after a step of each torque, p.u. of the rating
    Z: Complex  # (differences, modes)
    still: Complex  # eigenvalues of modes in the band that are left out, as no device moves them
    filters: Filtered | None  # of PMUs, with the modes' columns of what they sample; None: exact signals
    dead_time: Array  # (devices,), s
    error: float  # largest error of the transfer functions in the band, relative to the largest of each

    def real(self) -> tuple[Array, Array, Array, Array, Array]:
        """A, B, C, R, Z in real states: of each complex mode sqrt(2) times its real and imaginary part."""
        turning = self.values.imag > 0.0
        size = len(self.values) + int(turning.sum())
        A = np.zeros((size, size))
        first, second = self._places()
        A[first, first] = self.values.real
        A[second, second] = self.values.real[turning]
        A[first[turning], second] = -self.values.imag[turning]
        A[second, first[turning]] = self.values.imag[turning]
        return A, self._into(self.B), self.rows(self.C), self._into(self.R), self.rows(self.Z)

    def _places(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Real states of the real parts of all modes, and of the imaginary parts of complex ones."""
        turning = self.values.imag > 0.0
        first = np.cumsum(np.r_[0, 1 + turning])[:-1]
        return first, first[turning] + 1

    def _into(self, rows: Complex) -> Array:
        """Inputs of the real states."""
        turning, (first, second) = self.values.imag > 0.0, self._places()
        whole = np.zeros((len(self.values) + len(second), rows.shape[1]))
        whole[first] = np.where(turning, np.sqrt(2.0), 1.0)[:, None] * rows.real
        whole[second] = np.sqrt(2.0) * rows.imag[turning]
        return whole

    def rows(self, columns: Complex) -> Array:
        """Outputs of the real states, from those of the modes."""
        turning, (first, second) = self.values.imag > 0.0, self._places()
        whole = np.zeros((len(columns), len(self.values) + len(second)))
        whole[:, first] = np.where(turning, np.sqrt(2.0), 1.0) * columns.real
        whole[:, second] = -np.sqrt(2.0) * columns.imag[:, turning]
        return whole

    def of_signals(self, rows: list[int]) -> ModalPlant:
        """The plant with some of its signals."""
        filters = None if self.filters is None else self.filters.of(rows)
        return self._replace(C=self.C[rows], D=self.D[rows], filters=filters)

    def response(self, s: complex) -> Complex:
        """Transfer functions from setpoints to signals at a complex frequency (1/s), (signals, devices)."""
        turning = self.values.imag > 0.0
        ahead = (self.C / (s - self.values)) @ self.B
        behind = (self.C[:, turning].conj() / (s - self.values[turning].conj())) @ self.B[turning].conj()
        whole: Complex = ahead + behind + self.D
        return whole


def modal_plant(case: Case, built: Built, signals: Sequence[str]) -> ModalPlant:
    """The modes of a plant as it is built, with signals of a case and all its devices."""
    system = case.system
    chosen_signals = {name: system.signals[name] for name in signals}
    model = linear_model(built, chosen_signals, [pmu.name for pmu in system.pmus], case.filter, case.run.frame_rate)
    values, left, right = eigenvectors(model.matrix)
    chosen = (values.imag >= 0.0) & (np.abs(values) < FASTEST)
    values, left, right = values[chosen], left[:, chosen], right[:, chosen]
    left = left / np.einsum("im,im->m", left, right)
    B, C, Z = left.T @ model.B, model.C @ right, speed_differences(case, built) @ right
    G = left.T @ torques(case, built)
    apart = np.maximum(np.abs(values.real), 1e-3)
    moved = _relative(B, np.vstack([_scaled(C), _scaled(Z)]), apart)
    shown = _relative(G, _scaled(Z), apart)
    stays = (moved > MOVED) | (shown > SHOWN)
    low, high = BAND_HZ
    hertz = values.imag / (2.0 * np.pi)
    swings = np.array([_swings(values[i], right[:, i], left[:, i], case, built) for i in np.flatnonzero(stays)], bool)
    R = np.where(swings[:, None], G[stays] / values[stays, None], 0.0)
    still = values[~stays & (hertz > low) & (hertz < high)]
    filters = model.filtered
    if filters is not None:
        filters = filters._replace(C=filters.C @ right[:, stays])
    dead = np.broadcast_to(np.asarray(model.dead_time, float), (model.B.shape[1],))
    parts = values[stays], swings, B[stays], C[:, stays], np.zeros_like(model.D), R, Z[:, stays], still
    return fitted(ModalPlant(*parts, filters, dead, 0.0), model)


def _swings(value: complex, right: Complex, left: Complex, case: Case, built: Built) -> bool:
    return value.imag > 0.0 and mode(value, right, left, built.state_names, case.system).swings


def _scaled(rows: Complex) -> Complex:
    """Rows relative to their largest entry."""
    largest = np.abs(rows).max(axis=1, keepdims=True, initial=0.0)
    scaled: Complex = rows / np.where(largest > 0.0, largest, 1.0)
    return scaled


def _relative(into: Complex, of: Complex, apart: Array) -> Array:
    """Effect of each mode, relative to the largest."""
    columns = np.abs(into) / np.maximum(np.abs(into).max(axis=0, initial=0.0), 1e-300)
    effect = columns.max(axis=1, initial=0.0) * np.abs(of).max(axis=0, initial=0.0) / apart
    relative: Array = effect / effect.max(initial=1e-300)
    return relative


def fitted(plant: ModalPlant, model: LinearModel) -> ModalPlant:
    """The plant with D fitted at FITTED_HZ to a whole model, and the error that is left."""
    at = 2j * np.pi * np.array(FITTED_HZ)
    plain = model._replace(washout=np.zeros(len(model.C)), filtered=None, dead_time=0.0)
    whole = np.array([plain.response(s) for s in at])
    ours = np.array([plant.response(s) for s in at])
    D = (whole - ours).real.mean(axis=0)
    size = np.abs(whole).max(axis=0)
    error = np.abs(whole - ours - D).max(axis=0) / np.where(size > 0.0, size, 1.0)
    return plant._replace(D=D, error=float(error.max(initial=0.0)))


def torques(case: Case, built: Built) -> Array:
    """Effect of a torque on each rotor, p.u. of its rating, on the states, (states, machines)."""
    G = np.zeros((len(built.state_names), len(case.system.machines)))
    for i, machine in enumerate(case.system.machines):
        G[built.state_names.index(f"{machine.name}.omega"), i] = 1.0 / (2.0 * machine.H)
    return G


def linear_model_of(plant: ModalPlant) -> LinearModel:
    """The linear model of a plant in its modes, in real states, with the filters of its PMUs."""
    A, B, C, *_ = plant.real()
    filters = plant.filters
    if filters is not None:
        filters = filters._replace(C=plant.rows(np.asarray(filters.C, complex)))
    return LinearModel(A, B, C, plant.D, np.zeros(len(C)), filters, plant.dead_time)


def shifted(matrix: Array | Descriptor, right: Complex, left: Complex) -> Complex:
    """First-order eigenvalues of a changed plant: w A v for each pair of vectors of the plant as it was, w v = 1."""
    if isinstance(matrix, Descriptor):
        n = matrix.states
        z = descriptor.solve_network(matrix.matrix[n:, n:].tocsc(), matrix.matrix[n:, :n] @ right)
        moved = matrix.matrix[:n, :n] @ right - matrix.matrix[:n, n:] @ z
    else:
        moved = matrix @ right
    values: Complex = np.einsum("im,im->m", left, moved)
    return values
