"""A law that uses all that it may: random numbers of its seed, the plant, data and a module beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from helper import gain_of  # type: ignore[import-not-found]  # beside this file


class Lawful:
    """A noisy gain."""

    once_a_tick = True

    def __init__(self, spec: Any) -> None:
        self.random = np.random.default_rng(spec.seed)
        self.weights = np.load(Path(__file__).with_name("weights.npz"))["weights"]
        self.scale = float(np.abs(spec.plant.B).max()) + float(spec.plant.x_0.sum())
        self.gain = gain_of(spec.parameters)

    def reset(self) -> None:
        self.calls = 0

    def step(self, t_s: float, y: Any, age_s: Any, fresh: Any) -> Any:
        self.calls += 1
        assert y.flags.writeable
        y *= self.weights[0] * self.gain
        return (y[:1] + 1e-4 * self.random.normal() + 1e-9 * self.scale * self.calls) * (1.0 + age_s[0]) * fresh.all()
