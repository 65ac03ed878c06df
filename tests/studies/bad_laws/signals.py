"""Laws that do openly what should gain nothing: none of them damps what it does not look at."""

from __future__ import annotations

import math
from typing import Any

GAIN = 25.0  # p.u. of the difference of frequencies: about what damps


class Steady:
    """A gain, as one would begin."""

    def __init__(self, spec: Any) -> None:
        self.limit = float(spec.limits[0])

    def step(self, t_s: float, y: Any, age_s: Any, fresh: Any) -> Any:
        return GAIN * y


class Sine(Steady):
    """An open-loop signal of the frequency of the swing."""

    def step(self, t_s: float, y: Any, age_s: Any, fresh: Any) -> Any:
        return 0.0 * y + 0.3 * self.limit * math.sin(2.0 * math.pi * 0.55 * t_s)


class Bang(Steady):
    """Always at a limit."""

    def step(self, t_s: float, y: Any, age_s: Any, fresh: Any) -> Any:
        return 0.0 * y + (self.limit if y[0] > 0.0 else -self.limit)


class Calm(Steady):
    """Acts in calm only."""

    def step(self, t_s: float, y: Any, age_s: Any, fresh: Any) -> Any:
        return GAIN * y if abs(y[0]) < 2e-4 else 0.0 * y


class Briefly(Steady):
    """Acts in the second in which the event was in the sets before."""

    def step(self, t_s: float, y: Any, age_s: Any, fresh: Any) -> Any:
        return GAIN * y if 2.0 <= t_s < 3.0 else 0.0 * y


class Turns(Steady):
    """Turns its sign where it believes that this pays: by seed, as cases could once be told apart."""

    def __init__(self, spec: Any) -> None:
        super().__init__(spec)
        self.sign = -1.0 if spec.seed % 2 else 1.0

    def step(self, t_s: float, y: Any, age_s: Any, fresh: Any) -> Any:
        return self.sign * GAIN * y
