"""PMU filters in the linearised plant: samples of a signal, and filter states from frame to frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.measurement.filters import Filter, taps
from facts_damping.numerics.matrices import product
from facts_damping.numerics.phasors import exponentials
from facts_damping.small_signal.zero_order_hold import held_for

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.compiling.structs import Complex1, Float2, Float3


class Filtered(NamedTuple):
    """Signals reported by PMUs with a filter: y(k) = sum_j g_j (C x + D u) at t_k - j / rate.

    C and D give the samples: for a frequency and its rate the voltage's angle, which `taps` differentiate.
    """

    C: Float2  # (signals, states)
    D: Float2  # (signals, devices)
    taps: Float2  # (signals, 1 + frames * per_frame)
    per_frame: int
    rate: float  # samples/s
    delay: float  # s, from the instant of a frame until the frame is available

    @property
    def frames(self) -> int:
        """The number of earlier frames with samples in the filter."""
        return int(self.taps.shape[1] - 1) // self.per_frame

    def gain(self, s: complex) -> Complex1:
        """Transfer functions sum_j g_j exp(-s j / rate) at a complex frequency (1/s), (signals,)."""
        return product(self.taps, exponentials(-s / self.rate * np.arange(self.taps.shape[1])))

    def of(self, signals: Sequence[int]) -> Filtered:
        """The filter of a selection of signals."""
        rows = list(signals)
        return self._replace(C=self.C[rows], D=self.D[rows], taps=self.taps[rows])


def filtered(pmu_filter: Filter, channels: Sequence[str], C: Float2, D: Float2, frame_rate: int) -> Filtered:
    """The measurement filter for signals of some channels; C and D give the samples."""
    rows = [taps(pmu_filter, channel, frame_rate) for channel in channels]
    frames = -(-(max(map(len, rows)) - 1) // pmu_filter.per_frame)
    padded = np.zeros((len(rows), 1 + frames * pmu_filter.per_frame))
    for row, row_taps in zip(padded, rows, strict=True):
        row[: len(row_taps)] = row_taps
    return Filtered(
        C, D, padded, pmu_filter.per_frame, float(pmu_filter.per_frame * frame_rate), pmu_filter.delay / frame_rate
    )


def samples(
    filters: Filtered, A: Float2, B: Float2, x: Float2, inputs: Sequence[tuple[list[int], Float2, Float2, float]]
) -> Float3:
    """Samples in a frame, at t_k + i / rate, (per_frame, signals, columns), as rows in terms of `x` and inputs.

    `inputs`: columns of B, the setpoints in force first, those that follow, and the time of the change (s). A sample at
    exactly this time uses the first.
    """
    sampled = []
    for i in range(filters.per_frame):
        at = i / filters.rate
        state, seen = product(held_for(A, B, at)[0], x), np.zeros((len(filters.C), x.shape[1]))
        for columns, old, new, switch in inputs:
            b = B[:, columns]
            if at <= switch:
                state = state + product(held_for(A, b, at)[1], old)
                seen = seen + product(filters.D[:, columns], old)
            else:
                onward, later = held_for(A, b, at - switch)
                state = state + product(onward, held_for(A, b, switch)[1], old) + product(later, new)
                seen = seen + product(filters.D[:, columns], new)
        sampled.append(product(filters.C, state) + seen)
    return np.array(sampled)


def remember(filters: Filtered, sampled: Float3, memory: Float2) -> Float2:
    """Filter memory for the next frames after a frame's samples: rows of `memory`, (frames * signals, columns).

    The transposed form: w_m(k+1) = w_(m+1)(k) + sum_i g_(m M - i) y(t_k + i / rate), y(k) = g_0 y(t_k) + w_1(k), with M
    samples per frame.
    """
    n, frames = len(filters.taps), filters.frames
    past = memory.reshape(frames, n, -1)
    following = np.concatenate([past[1:], np.zeros_like(past[:1])])
    for m in range(1, frames + 1):
        for i in range(filters.per_frame):
            following[m - 1] += filters.taps[:, m * filters.per_frame - i, None] * sampled[i]
    return following.reshape(frames * n, -1)
