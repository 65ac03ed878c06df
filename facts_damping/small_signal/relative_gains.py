"""Interaction of two devices of a system: relative gain arrays of the linearised plant (Bristol 1966)."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.small_signal.residues import residues

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Complex2
    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built

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
    found = []
    for hertz in (plant.frequency_hz, *FREQUENCIES_HZ):
        gain = plant.model.response(2j * np.pi * hertz) * limits / np.abs(plant.mode_shape)[:, None]
        for a, b in combinations(range(len(plant.signals)), 2):
            own = gain[[a, b]]
            if np.linalg.cond(own) < ALIKE:
                pair = (plant.signals[a], plant.signals[b])
                found.append(Interaction(hertz, pair, own, own * np.linalg.inv(own).T))
    return found
