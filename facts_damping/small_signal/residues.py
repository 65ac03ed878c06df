"""Response of the signals to the devices' setpoints in the linearised plant: initial values for adaptation.

Two devices interact as their relative gain arrays tell (Bristol 1966).
"""

from __future__ import annotations

import math
from hashlib import sha256
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.caching import shared
from facts_damping.numerics.matrices import eigenvalue_near, product
from facts_damping.numerics.phasors import angles, over, times
from facts_damping.small_signal import descriptor, eigenmodes, linearisation
from facts_damping.small_signal.descriptor import Descriptor
from facts_damping.small_signal.zero_order_hold import held_for

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Complex1, Complex2, Float2
    from facts_damping.measurement.filters import Filter
    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built

CLEAR_DEG = 60.0  # largest distance from 0 or 180 degrees for a residue with a sign
_held: dict[tuple[bytes, float], Float2] = {}  # effect of held inputs, by a digest of the model and the time


class Residues(NamedTuple):
    """Residues at an electromechanical mode, usually the least damped, the swing of the signals in it, and responses.

    Signals and devices are those of the system and of the run, in their order; signals are after their washouts.
    """

    signals: list[str]
    devices: list[str]
    eigenvalue: complex  # 1/s, of the mode
    residue: Complex2  # (signals, devices), 1/s
    mode_shape: Complex1  # (signals,), swing of each signal in the mode's right eigenvector
    frame_rate: int
    model: linearisation.LinearModel
    names: list[str]  # of the plant's states
    shape: Complex1  # (states,), the mode's right eigenvector

    @property
    def frequency_hz(self) -> float:
        """Frequency of the mode."""
        return float(self.eigenvalue.imag / (2.0 * np.pi))

    def angle_deg(self, signal: str, device: str) -> float:
        """Angle of a residue."""
        return math.degrees(angles(self.residue[self.signals.index(signal), self.devices.index(device)]))

    def sign(self, signal: str, device: str) -> float:
        """Sign of dy/du at the mode: +1 for a residue near 0 degrees, -1 near 180, 0 between."""
        angle = self.angle_deg(signal, device)
        if abs(angle) <= CLEAR_DEG:
            return 1.0
        return -1.0 if abs(angle) >= 180.0 - CLEAR_DEG else 0.0

    def response(self, signals: Sequence[str], devices: Sequence[str], frames: int = 1) -> Float2:
        """Signals after a setpoint of one is held for a number of frames, p.u./p.u., (signals, devices).

        C int_0^T exp(A t) dt B + D, with the washouts' states in A; time counts from the end of dead times.
        """
        rows, columns = [self.signals.index(s) for s in signals], [self.devices.index(d) for d in devices]
        A, B, C, D = with_washouts(self.model, rows)
        key = sha256(A.tobytes() + B.tobytes()).digest(), frames / self.frame_rate
        held = shared(_held, key, lambda: held_for(A, B, frames / self.frame_rate)[1])
        return (product(C, held) + D)[:, columns]

    def jacobian(self, signals: Sequence[str], devices: Sequence[str], frames: int = 1) -> Float2:
        """The responses with the signs at the mode, if these are defined, (signals, devices), p.u./p.u."""
        responses = self.response(signals, devices, frames)
        sign = np.array([[self.sign(s, d) for d in devices] for s in signals]).reshape(responses.shape)
        return np.where(sign != 0.0, sign * np.abs(responses), responses)

    def ratio(self, signal: str, to: str) -> complex:
        """Swing of a signal in the mode relative to another one, p.u./p.u."""
        if signal == to:
            return 1.0 + 0j  # exact
        return complex(over(self.mode_shape[self.signals.index(signal)], self.mode_shape[self.signals.index(to)]))


def residues(
    built: Built,
    system: System,
    devices: Sequence[str],
    frame_rate: int,
    measured: Filter | None = None,
    mode_hz: float | None = None,
) -> Residues | None:
    """The residues from the installed devices to a system's signals; None without an electromechanical mode.

    `mode_hz`: the mode next to this frequency; None: the least damped.

    Residues are F (C v)(w B) exp(-lambda Td), the swing F (C v) (Kundur 1994, 12.3.4); F washouts and the PMUs' filter
    `measured`, Td dead times.
    """
    pmus = [s.name for s in system.pmus]
    model = linearisation.linear_model(built, system.signals, pmus, measured, frame_rate)
    swings = [mode for mode in eigenmodes.modes(model.matrix, built.state_names, system) if mode.swings]
    if not swings:
        return None
    minimum = min(swings, key=lambda m: m.damping_ratio if mode_hz is None else abs(m.frequency_hz - mode_hz))
    near = descriptor.eigenvalue_near if isinstance(model.matrix, Descriptor) else eigenvalue_near
    eigenvalue, v, w = near(model.matrix, minimum.eigenvalue)  # type: ignore[arg-type]
    swing = times(model.gain(eigenvalue), product(model.seen[0], v))
    from_inputs = times(over(product(w, model.B), product(w, v)), model.late(eigenvalue))
    residue = times(swing[:, None], from_inputs)
    known = list(system.signals), list(devices), eigenvalue, residue, swing
    return Residues(*known, frame_rate, model, list(built.state_names), v)


def with_washouts(model: linearisation.LinearModel, signals: Sequence[int]) -> tuple[Float2, Float2, Float2, Float2]:
    """A, B, C, D to some signals, with a state for each washout: T dx_w/dt = y - x_w, and y - x_w instead of y."""
    A, B, C, D = model.A, model.B, model.C[signals], model.D[signals]
    rows = np.flatnonzero(model.washout[signals] > 0.0)
    if not len(rows):
        return A, B, C, D
    rate = 1.0 / model.washout[signals][rows, None]
    pick = np.zeros((len(signals), len(rows)))
    pick[rows, np.arange(len(rows))] = 1.0
    wide = np.block([[A, np.zeros((len(A), len(rows)))], [rate * C[rows], -rate * np.eye(len(rows))]])
    return wide, np.vstack([B, rate * D[rows]]), np.hstack([C, -pick]), D


ALIKE = 1e9  # largest condition of the gains; signals that are nearly proportional have no array
FREQUENCIES_HZ = (0.1, 0.3, 1.0, 1.5, 3.0)  # in addition to the frequency of the mode


class Interaction(NamedTuple):
    """Gains from both devices to two signals at a frequency, and their relative gain array."""

    frequency_hz: float
    signals: tuple[str, str]
    gain: Complex2  # (signals, devices), normalised: signals by their swing, devices by their limits
    relative: NDArray[np.complex128]  # G x (G^-1)^T, element by element; independent of units

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of the gain."""
        return float(np.linalg.cond(self.gain))


def interactions(built: Built, system: System, devices: Sequence[str]) -> list[Interaction]:
    """Interactions for each pair of signals, first at the least damped mode; empty unless two devices see a mode."""
    plant = residues(built, system, devices, 1) if len(devices) == 2 else None
    if plant is None:
        return []
    limits = np.array([system.device(name).setpoint_max for name in devices])
    pair_interactions = []
    for hertz in (plant.frequency_hz, *FREQUENCIES_HZ):
        gain = plant.model.response(2j * np.pi * hertz) * limits / np.abs(plant.mode_shape)[:, None]
        for a, b in combinations(range(len(plant.signals)), 2):
            pair_gain = gain[[a, b]]
            if np.linalg.cond(pair_gain) < ALIKE:
                pair = (plant.signals[a], plant.signals[b])
                pair_interactions.append(Interaction(hertz, pair, pair_gain, pair_gain * np.linalg.inv(pair_gain).T))
    return pair_interactions
