"""The environment's observations for a deployed class that was trained in it, built from the arguments of `step`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.errors import InputError
from facts_damping_gym.many import append_to_window

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.simulation.programs.spec import Spec


def each_scale(scale: float | list[float], signals: int) -> NDArray[np.float64]:
    """A scale for each signal, (signals,), p.u. Raises `InputError` for a wrong number of them, or one not above 0."""
    scales = np.atleast_1d(np.array(scale, np.float64))
    if scales.shape not in ((1,), (signals,)):
        raise InputError(f"scale: {scales.size} numbers given; allowed: one, or {signals}, one a signal")
    if not (scales > 0.0).all():
        raise InputError(f"scale: {scales.min():g} given; allowed: more than 0")
    return np.array(np.broadcast_to(scales, (signals,)))


class Window:
    """The observations of `WideAreaDamping`, (window, signals, 3), from the arrivals at a class.

    They equal the environment's bit for bit in a class with `once_a_tick = True`, which acts as the environment does.
    Ticks without arrivals between two calls are filled in.
    """

    def __init__(self, spec: Spec, window: int = 8, scale: float | list[float] = 0.01) -> None:
        """An empty window; `window` and `scale` as in the environment."""
        n = len(spec.signals)
        self._rate, self._scale = spec.frame_rate, each_scale(scale, n)
        self._seen: NDArray[np.float32] = np.zeros((window, n, 3), np.float32)
        self._y, self._newest_ns, self._none = np.full(n, np.nan), np.zeros(n, np.int64), np.zeros(n, np.bool_)
        self.reset()

    def reset(self) -> None:
        """Return to the start of a run."""
        self._seen[:], self._tick, self._y[:] = 0.0, -1, np.nan
        self._seen[:, :, 2] = 1.0

    def push(
        self, t_s: float, y: NDArray[np.float64], age_s: NDArray[np.float64], fresh: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """The observation at an arrival, including its new values."""
        now_ns = round(t_s * 1e9)
        tick = (now_ns + 1) * self._rate // 1_000_000_000  # times of ticks are rounded down
        for missed in range(self._tick + 1, tick):
            age = (((missed + 1) * 1_000_000_000 // self._rate) - self._newest_ns) * 1e-9
            append_to_window(self._seen, self._y, age if self._tick >= 0 else 0.0 * age, self._none, self._scale)
        append_to_window(self._seen, y, age_s, fresh, self._scale)
        self._tick, self._y = tick, y
        self._newest_ns = now_ns - np.round(age_s * 1e9).astype(np.int64)
        return np.array(self._seen)
