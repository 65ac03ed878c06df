"""How a signal answers a device's setpoint, as the linearised plant has it: the sign that adaptation needs."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import expm

from facts_damping.plant import linear

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.parameters.system import System
    from facts_damping.plant.build import Built

CLEAR_DEG = 60.0  # so near 0 or 180 degrees a residue has a sign


class Sensitivity(NamedTuple):
    """Residue of a device and a signal at the least damped swing mode, and the response within one frame."""

    angle_deg: float  # of the residue
    frequency_hz: float  # of the mode
    frame: float  # p.u. of the signal per p.u. of a setpoint held for one frame

    @property
    def sign(self) -> float:
        """Sign of dy/du at the mode: +1 for a residue near 0 degrees, -1 near 180, 0 between."""
        if abs(self.angle_deg) <= CLEAR_DEG:
            return 1.0
        return -1.0 if abs(self.angle_deg) >= 180.0 - CLEAR_DEG else 0.0


def sensitivities(
    built: Built, system: System, devices: Sequence[str], frame_rate: int
) -> dict[tuple[str, str], Sensitivity]:
    """The sensitivity of each signal to each installed device, by (signal, device).

    The residue is (C v)(w B) (Kundur 1994, 12.3.4); the response within a frame T is C int_0^T exp(A t) dt B + D.
    """
    model = linear.linear_model(built, system.signals, [s.name for s in system.stations])
    swings = [
        mode
        for mode in linear.modes(model.A, built.state_names, system, model, devices)
        if mode.label not in ("common", "control")
    ]
    if not swings:
        return {}
    least = min(swings, key=lambda mode: mode.damping_ratio)
    n, inputs = model.B.shape
    held = expm(np.block([[model.A, model.B], [np.zeros((inputs, n + inputs))]]) / frame_rate)
    frame = model.C @ held[:n, n:] + model.D
    order = list(system.signals)
    return {
        (r.signal, r.device): Sensitivity(
            r.angle_deg, least.frequency_hz, float(frame[order.index(r.signal), devices.index(r.device)])
        )
        for r in least.residues
    }
