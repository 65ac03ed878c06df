"""The linear plant of a grid in its modes: what a controller moves and what the performance index sees.

With right and left eigenvectors v, w, w v = 1, and for each mode with a non-negative imaginary part

    dz/dt = lambda z + (w B) u,   y = 2 Re(sum (C v) z) + D u,   speed differences = 2 Re(sum (Z v) z)

(a real mode counts once), u the devices' setpoints. A step of the torque on a rotor leaves the swings at a distance
w G / lambda from the new equilibrium. Modes are left out that neither a device moves as the signals or the speed
differences see it, nor a torque as the speed differences do; a few real poles and D take their part over (P. Kundur,
Power System Stability and Control, 1994, 12.3; modal truncation: G. Rogers, Power System Oscillations, 2000, 7).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.plant.grid.sparse import solve_network
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
FITTED_HZ = (0.12, 0.25, 0.4, 0.6, 0.85, 1.2, 1.7, 2.3)  # at which what is left out is fitted
POLES = -1.0, -6.0, -60.0  # 1/s, by which it is
MOVED, SHOWN = 0.002, 0.02  # effect of a mode that stays, relative to the largest: of devices, of torques
FASTEST = 200.0  # 1/s, magnitude of the eigenvalues of modes that stay
STILL = 0.1  # 1/s, decay below which a mode counts as one with this decay


def in_band(values: Complex) -> NDArray[np.bool_]:
    """Which eigenvalues (1/s) are modes in the band."""
    hertz = values.imag / (2.0 * np.pi)
    inside: NDArray[np.bool_] = (hertz > BAND_HZ[0]) & (hertz < BAND_HZ[1])
    return inside


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


class Vectors(NamedTuple):
    """Eigenvalues, 1/s, and left and right eigenvectors in columns, w v = 1."""

    values: Complex
    left: Complex
    right: Complex


def vectors(matrix: Array | Descriptor) -> Vectors:
    """Those of a state matrix."""
    values, left, right = eigenvectors(matrix)
    return Vectors(values, left / np.einsum("im,im->m", left, right), right)


def modal_plant(case: Case, built: Built, signals: Sequence[str]) -> ModalPlant:
    """The modes of a plant as it is built, with signals of a case and all its devices."""
    system = case.system
    chosen_signals = {name: system.signals[name] for name in signals}
    model = linear_model(built, chosen_signals, [pmu.name for pmu in system.pmus], case.filter, case.run.frame_rate)
    values, left, right = vectors(model.matrix)
    chosen = (values.imag >= 0.0) & (np.abs(values) < FASTEST)
    values, left, right = values[chosen], left[:, chosen], right[:, chosen]
    B, C, Z = left.T @ model.B, model.C @ right, speed_differences(case, built) @ right
    G = left.T @ torques(case, built)
    apart = np.maximum(np.abs(values.real), STILL)
    moved = _relative(B, np.vstack([_scaled(C), _scaled(Z)]), apart)
    shown = _relative(G, _scaled(Z), apart)
    stays = (moved > MOVED) | (shown > SHOWN)
    swings = np.array([_swings(values[i], right[:, i], left[:, i], case, built) for i in np.flatnonzero(stays)], bool)
    R = np.where(swings[:, None], G[stays] / values[stays, None], 0.0)
    still = values[~stays & in_band(values)]
    filters = model.filtered
    if filters is not None:
        seen: Any = filters.C @ right[:, stays]  # complex here, real in `linear_model_of`
        filters = filters._replace(C=seen)
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
    """The plant with what its modes lack of a whole model, fitted at FITTED_HZ, and the error that is left.

    What is lacking is D + sum_k C_k / (s - p_k) with the real POLES of each device, by least squares.
    """
    at = 2j * np.pi * np.array(FITTED_HZ)
    devices = plant.B.shape[1]
    basis = np.column_stack([np.ones(len(at)), *(-p / (at - p) for p in POLES)])
    plain = model._replace(washout=np.zeros(len(model.C)), filtered=None, dead_time=0.0)
    D, more, error = _lacking(np.array([plain.response(s) - plant.response(s) for s in at]), basis, plain, at)
    filters = plant.filters
    if filters is not None and model.filtered is not None:
        seen = plain._replace(C=model.filtered.C, D=model.filtered.D)
        ours = plant._replace(C=np.asarray(filters.C, complex), D=np.zeros_like(D))
        of_samples, further, _ = _lacking(np.array([seen.response(s) - ours.response(s) for s in at]), basis, seen, at)
        filters = filters._replace(C=np.hstack([filters.C, further]), D=of_samples)
    values = np.repeat(np.array(POLES, complex), devices)
    none = np.zeros((len(values), plant.R.shape[1]), complex)
    return plant._replace(
        values=np.concatenate([plant.values, values]),
        swings=np.concatenate([plant.swings, np.zeros(len(values), bool)]),
        B=np.vstack([plant.B, np.tile(np.eye(devices), (len(POLES), 1)) * -values.real[:, None]]),
        C=np.hstack([plant.C, more]),
        D=D,
        R=np.vstack([plant.R, none]),
        Z=np.hstack([plant.Z, np.zeros((len(plant.Z), len(values)))]),
        filters=filters,
        error=error,
    )


def _lacking(lacks: Complex, basis: Complex, whole: LinearModel, at: Complex) -> tuple[Array, Complex, float]:
    """D and C of the basis that are nearest to what is lacking, (frequencies, signals, devices), and the error left."""
    size = np.maximum(np.abs(np.array([whole.response(s) for s in at])).max(axis=0), 1e-300)
    flat = lacks.reshape(len(at), -1)
    rows, targets = np.vstack([basis.real, basis.imag]), np.vstack([flat.real, flat.imag])
    solution = np.linalg.lstsq(rows, targets, rcond=1e-6)[0]
    error = np.abs(lacks - (basis @ solution).reshape(lacks.shape)).max(axis=0) / size
    parts = solution.reshape(len(solution), *lacks.shape[1:])
    return parts[0], np.concatenate(list(parts[1:]), axis=1).astype(complex), float(error.max(initial=0.0))


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
        z = solve_network(matrix.matrix[n:, n:].tocsc(), matrix.matrix[n:, :n] @ right)
        moved = matrix.matrix[:n, :n] @ right - matrix.matrix[:n, n:] @ z
    else:
        moved = matrix @ right
    values: Complex = np.einsum("im,im->m", left, moved)
    return values
