"""The lead-lag of the thesis's appendix B, as its transfer function is printed."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.signal import cont2discrete, tf2ss

# The same with gain 10 as one fraction, the highest power first.
NUM = (10.0 * np.polymul(np.polymul([10.0, 0.0], [0.0761, 1.0]), [0.4272, 1.0])).tolist()
DEN = np.polymul(np.polymul([10.0, 1.0], [0.3, 1.0]), [0.3, 1.0]).tolist()


def lead_lag(s: complex, gain: float = 10.0) -> complex:
    """kG s Tw / (1 + s Tw) (1 + s T1) / (1 + s T2) (1 + s T3) / (1 + s T4)."""
    return gain * 10 * s / (1 + 10 * s) * (1 + 0.0761 * s) / (1 + 0.3 * s) * (1 + 0.4272 * s) / (1 + 0.3 * s)


def bilinear(frame_rate: int = 60) -> dict[str, Any]:
    """It from frame to frame by the bilinear transform, as the field `linear` has it."""
    A, B, C, D, dt = cont2discrete(tf2ss(NUM, DEN), 1.0 / frame_rate, method="bilinear")
    return {**{name: part.tolist() for name, part in zip("ABCD", (A, B, C, D), strict=True)}, "dt": dt}
