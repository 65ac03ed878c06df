"""Thins long traces for display by their envelope."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

BEFORE, AFTER = 2.0, 58.0  # s before and after the first event shown in detail
POINTS = 6000  # of a trace, at most: three per pixel of a wide screen


def envelope(
    x: NDArray[np.float64], y: NDArray[np.float64], maximum: int = POINTS
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A trace of at most `maximum` points that looks the same: smallest and largest value of each block of samples.

    `x`, `y`: (n,); short traces are returned unchanged. Otherwise each block gives two points, in order of occurrence,
    at the block's first and middle x, so that traces over the same x share it. NaN is ignored beside numbers.
    """
    if len(x) <= maximum:
        return x, y
    size = -(-2 * len(x) // maximum)
    starts = np.arange(0, len(x), size)
    low, high = np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts)
    padded = np.append(y, np.full(-len(y) % size, np.nan)).reshape(-1, size)
    falls = np.argmax(padded == high[:, np.newaxis], axis=1) < np.argmax(padded == low[:, np.newaxis], axis=1)
    values = np.column_stack([np.where(falls, high, low), np.where(falls, low, high)])
    ends = np.minimum(starts + size, len(x)) - 1
    return x[np.column_stack([starts, (starts + ends + 1) // 2]).ravel()], values.ravel()


def detailed(
    time_s: NDArray[np.float64], y: NDArray[np.float64], since: float, maximum: int = POINTS
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Envelope of a long trace, with a separate envelope for the minute after `since` (s; the first event).

    Zooming into a long run then shows the oscillation. At most `3 most` points.
    """
    if len(time_s) <= maximum:
        return time_s, y
    edges = np.searchsorted(time_s, [since - BEFORE, since + AFTER])
    parts = [
        envelope(x, part, maximum)
        for x, part in zip(np.split(time_s, edges), np.split(y, edges), strict=True)
        if len(x)
    ]
    return np.concatenate([x for x, _ in parts]), np.concatenate([part for _, part in parts])


def steps(
    x: NDArray[np.float64], y: NDArray[np.float64], maximum: int = POINTS
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A staircase of at most `maximum` points: each y holds until the next x.

    `x`, `y`: (n,), n > 0, x non-decreasing. For equal x the last y counts; if there are too many steps, every k-th is
    kept, and always the last.
    """
    ends = np.flatnonzero(np.append(x[1:] != x[:-1], True))
    kept = ends[np.unique(np.linspace(0, len(ends) - 1, min(len(ends), maximum // 2)).astype(int))]
    return np.repeat(x[kept], 2), np.append(y[0], np.repeat(y[kept], 2)[:-1])
