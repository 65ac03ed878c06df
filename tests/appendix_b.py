"""The lead-lag of the thesis's appendix B, as its transfer function is printed."""

from __future__ import annotations


def lead_lag(s: complex, gain: float = 10.0) -> complex:
    """kG s Tw / (1 + s Tw) (1 + s T1) / (1 + s T2) (1 + s T3) / (1 + s T4)."""
    return gain * 10 * s / (1 + 10 * s) * (1 + 0.0761 * s) / (1 + 0.3 * s) * (1 + 0.4272 * s) / (1 + 0.3 * s)
