"""How the devices of a system interact: gains and relative gain arrays of the linearised plant."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.case.loading import load_system
from facts_damping.errors import InputError
from facts_damping.plant.build import build
from facts_damping.small_signal.residues import residues
from facts_damping.studies.architectures import ARCHITECTURES, SYSTEM
from facts_damping.terminal import table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

PAIRS = (("speed", "power"), ("power_rate", "voltage"))  # of the relative gain array
FREQUENCIES_HZ = (0.1, 0.3, 0.63, 1.0, 1.5, 3.0)


class Interaction(NamedTuple):
    """Gains from both devices to two signals at a frequency, and their relative gain array."""

    frequency_hz: float
    signals: tuple[str, ...]
    gain: NDArray[np.complex128]  # (signals, devices), normalised: signals as they swing, devices by their limits
    relative: NDArray[np.complex128]  # G x (G^-1)^T, element by element (Bristol 1966)


def interactions() -> list[Interaction]:
    """Relative gain arrays of the linearised plant with both devices; they do not depend on units."""
    system, devices = load_system(SYSTEM), ARCHITECTURES["centralised"][0]
    plant = residues(build(system, devices, []), system, devices, 1)
    if plant is None:
        raise InputError(f"SYSTEM: {SYSTEM} has no swing mode; allowed: a system whose machines swing")
    found = []
    limits = np.array([system.device(name).v_max for name in devices])
    for signals in PAIRS:
        rows = [plant.signals.index(name) for name in signals]
        swing = np.array([abs(plant.ratio(name, "speed")) for name in signals])
        for hertz in FREQUENCIES_HZ:
            gain = plant.model.response(2j * np.pi * hertz)[rows] * limits / swing[:, None]
            found.append(Interaction(hertz, signals, gain, gain * np.linalg.inv(gain).T))
    return found


def relative_gain_table(found: Sequence[Interaction]) -> list[str]:
    """A table in Markdown."""
    cells = []
    for one in found:
        value, ratio = one.relative[0, 0], np.linalg.cond(one.gain)
        shown = f"{value.real:.2f} {'+' if value.imag >= 0 else '-'} {abs(value.imag):.2f}j"
        cells.append([", ".join(one.signals), f"{one.frequency_hz:g}", shown, f"{ratio:.3g}"])
    return [*table(["signals", "Hz", "relative gain", "largest gain / smallest"], cells, markdown=True), ""]
