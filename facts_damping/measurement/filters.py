"""The reference filters of IEEE/IEC 60255-118-1 (before: IEEE C37.118.1), annex D, as sample weights.

A filter acts on the positive sequence, demodulated at the nominal frequency. This is the complex phasor of a
simulation, because the image at twice that frequency cancels in three balanced phases. The weights are the annex's
functions of time, evaluated at the available samples.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.elementary import cos, sin
from facts_damping.errors import InputError

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.measurement import Measurement

MIN_RATE = 480  # samples/s: eight per cycle, one per integrator step
ANNEX_SAMPLES = 16  # samples per cycle in the annex

# M class: (nominal frequency, Hz; frames/s) to (reference frequency, Hz; order at 16 samples per cycle), table D.1.
M_CLASS = {
    50: {10: (1.779, 806), 25: (4.355, 338), 50: (7.75, 142), 100: (14.1, 66)},
    60: {
        10: (1.78, 968),
        12: (2.125, 816),
        15: (2.64, 662),
        20: (3.5, 502),
        30: (5.02, 306),
        60: (8.19, 164),
        120: (16.25, 70),
    },
}


class Filter(NamedTuple):
    """A symmetric filter: a measurement uses samples before and after its instant."""

    weights: Float1  # (samples to one side + 1,), from the middle outwards; sum over both sides: 1
    per_frame: int  # samples per frame
    delay: int  # frames from the instant until all samples are available, also for frequency

    @property
    def side(self) -> int:
        """Number of samples to each side of the middle."""
        return len(self.weights) - 1


def reference_filter(measurement: Measurement, nominal: float, frame_rate: int) -> Filter:
    """The filter of a measurement at a nominal frequency (Hz) and a frame rate; the ideal one is the sample itself.

    P class (D.6): W(t) = 1 - f_0 |t|, two cycles long. M class (D.7): W(t) = sin(4 pi F_fr t) / (4 pi F_fr t) h(t), h
    Hamming's window. Raises `InputError` for a rate without an M class filter in the annex.
    """
    if measurement.filter == "ideal":
        return Filter(np.ones(1), 1, 0)
    per_frame = math.ceil(MIN_RATE / frame_rate)
    step = 1.0 / (per_frame * frame_rate)
    if measurement.filter == "p_class":
        t = step * np.arange(math.ceil(1.0 / (nominal * step)))
        weights = 1.0 - nominal * t
        weights = weights[weights > 1e-9]  # weights at the ends are zero
    else:
        reference, length = _m_class(nominal, frame_rate)
        t = step * np.arange(math.floor(length / 2.0 / step + 1e-9) + 1)
        window = [0.54 + 0.46 * cos(2.0 * math.pi * at / length) for at in t.tolist()]
        turned = [math.pi * (4.0 * reference * at) for at in t.tolist()]
        weights = np.array([sin(x) / x if x != 0.0 else 1.0 for x in turned]) * np.array(window)
    weights = weights / (weights[0] + 2.0 * weights[1:].sum())
    return Filter(np.asarray(weights, np.float64), per_frame, -(-len(weights) // per_frame))


def _m_class(nominal: float, frame_rate: int) -> tuple[float, float]:
    """Reference frequency (Hz) and length (s) of the M class filter."""
    rows = M_CLASS.get(round(nominal), {}) if nominal == round(nominal) else {}
    if frame_rate not in rows:
        those = "; ".join(f"{', '.join(map(str, rates))} at {f} Hz" for f, rates in M_CLASS.items())
        raise InputError(
            f"frame_rate: {frame_rate} given at a nominal frequency of {nominal:g} Hz; "
            f"allowed with measurement m_class: {those}"
        )
    reference, order = rows[frame_rate]
    return reference, order / (ANNEX_SAMPLES * nominal)


def _spread(weights: Float1, over: list[float]) -> Float1:
    """Convolution of sample weights with `over`."""
    spread = np.zeros(len(weights) + len(over) - 1)
    for i, fraction in enumerate(over):
        spread[i : i + len(weights)] += fraction * weights
    return spread


def taps(pmu_filter: Filter, channel: str, frame_rate: int) -> Float1:
    """Weights of a channel's phasor samples, from the newest sample at the report's tick backwards.

    For frequency and ROCOF (Hz, Hz/s): weights of its angle (rad), from first and second differences, as in D.4.
    """
    step = 1.0 / (pmu_filter.per_frame * frame_rate)
    whole = np.concatenate([pmu_filter.weights[:0:-1], pmu_filter.weights])
    beside: dict[str, list[float]] = {"frequency": [1.0, 0.0, -1.0], "rocof": [1.0, -2.0, 1.0]}
    if channel == "frequency":
        whole = _spread(whole, beside[channel]) / (4.0 * np.pi * step)
    elif channel == "rocof":
        whole = _spread(whole, beside[channel]) / (2.0 * np.pi * step * step)
    first = (
        pmu_filter.delay * pmu_filter.per_frame - (len(whole) - 1) // 2
    )  # samples between the tick's newest and the first used
    return np.concatenate([np.zeros(first), whole])
