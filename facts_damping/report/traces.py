"""Traces thinned for display: what is long is drawn as its envelope."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

POINTS = 6000  # of a trace at most: three for each pixel of a wide screen


def envelope(
    x: NDArray[np.float64], y: NDArray[np.float64], most: int = POINTS
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A trace of at most `most` points that looks the same: smallest and largest value of each block of samples.

    `x`, `y`: (n,); returned as they are if they are short enough. Otherwise two points a block, in the order in which
    they come, at the block's first x and in its middle, so that traces over the same x share it. NaN does not count
    beside numbers.
    """
    if len(x) <= most:
        return x, y
    size = -(-2 * len(x) // most)
    starts = np.arange(0, len(x), size)
    low, high = np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts)
    padded = np.append(y, np.full(-len(y) % size, np.nan)).reshape(-1, size)
    falls = np.argmax(padded == high[:, np.newaxis], axis=1) < np.argmax(padded == low[:, np.newaxis], axis=1)
    values = np.column_stack([np.where(falls, high, low), np.where(falls, low, high)])
    ends = np.minimum(starts + size, len(x)) - 1
    return x[np.column_stack([starts, (starts + ends + 1) // 2]).ravel()], values.ravel()


def steps(
    x: NDArray[np.float64], y: NDArray[np.float64], most: int = POINTS
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Stairs of at most `most` points: each y holds until the next x.

    `x`, `y`: (n,), n > 0, x never falling. Of equal x the last y counts; of too many steps every so-manieth stays, and
    the last always.
    """
    ends = np.flatnonzero(np.append(x[1:] != x[:-1], True))
    kept = ends[np.unique(np.linspace(0, len(ends) - 1, min(len(ends), most // 2)).astype(int))]
    return np.repeat(x[kept], 2), np.append(y[0], np.repeat(y[kept], 2)[:-1])
