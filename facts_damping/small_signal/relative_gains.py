"""How two devices of a system interact: relative gain arrays of the linearised plant (Bristol 1966)."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.small_signal.residues import residues

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built

ALIKE = 1e9  # largest over smallest gain of signals that say the same: they have no array
FREQUENCIES_HZ = (0.1, 0.3, 1.0, 1.5, 3.0)  # and that of the mode


class Interaction(NamedTuple):
    """Gains from both devices to two signals at a frequency, and their relative gain array."""

    frequency_hz: float
    signals: tuple[str, str]
    gain: NDArray[np.complex128]  # (signals, devices), normalised: signals as they swing, devices by their limits
    relative: NDArray[np.complex128]  # G x (G^-1)^T, element by element; does not depend on units

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of the gain."""
        return float(np.linalg.cond(self.gain))


def interactions(built: Built, system: System, devices: Sequence[str]) -> list[Interaction]:
    """Of each two signals, at the least damped mode's frequency first; none but of two devices that see a mode."""
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
