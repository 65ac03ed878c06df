"""Signals of two modes that noise alone excites, the same everywhere."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

MODES = np.array([(0.6, 0.04), (1.15, 0.09)])  # Hz, damping ratio
RATE = 10  # samples/s, as the fit brings its signals to
SHAPES = np.array([[1.0, 0.4], [-0.7, 1.0]])  # (signals, modes)


def poles() -> NDArray[np.complex128]:
    """z = exp(s / RATE) of both modes."""
    frequency, ratio = 2 * np.pi * MODES.T
    ratio = MODES[:, 1]
    return np.asarray(np.exp(frequency * (1j - ratio / np.sqrt(1 - ratio**2)) / RATE))


def ambient(noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two signals, (samples, 2), of white noise (samples, 6): x(k+1) = z x(k) + n(k), n complex, and more noise.

    The covariances of Re x are those of a free oscillation with the pole z, exactly.
    """
    x = np.zeros((len(noise), 2), np.complex128)
    z, n = poles(), noise[:, :2] + 1j * noise[:, 2:4]
    for k in range(1, len(noise)):
        x[k] = z * x[k - 1] + n[k]
    return np.asarray(x.real @ SHAPES.T + 0.3 * noise[:, 4:])


def same_noise(samples: int = 6000) -> NDArray[np.float64]:
    """Nearly normal noise that every version of Python makes the same: sums of twelve uniform numbers."""
    draw = random.Random(5)
    return np.array([[sum(draw.random() for _ in range(12)) - 6.0 for _ in range(6)] for _ in range(samples)])
