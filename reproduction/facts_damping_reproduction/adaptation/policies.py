"""Adaptive controllers that are not neuro-fuzzy: a gain that follows the oscillation, an LQG on identified data."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import solve_discrete_are

if TYPE_CHECKING:
    from numpy.typing import NDArray


class AdaptiveGain:
    """A washout and two lead-lags whose gain k follows the oscillation slowly, with leakage (sigma modification).

        dk/dt = rate (|y| / size)^2 - leak (k - 1),  u = gain k L(s) y,  1 <= k <= 4

    P. A. Ioannou, J. Sun, Robust Adaptive Control, 1996, 8.4. Parameters: gain, T1 to T4, rate (1/s), leak (1/s).
    """

    def __init__(self, spec: Any) -> None:
        """Sections with their bilinear coefficients."""
        p = spec.parameters
        self.dt, self.gain, self.rate, self.leak = 1.0 / spec.frame_rate, p["gain"], p["rate"], p["leak"]
        self.sections = [_section(10.0, 0.0, 10.0, self.dt), *(_section(p[a], 1.0, p[b], self.dt) for a, b in PAIRS)]
        self.states = [np.zeros(2) for _ in self.sections]
        self.k = 1.0

    def step(self, t_s: float, y: NDArray[np.float64], age_s: Any, fresh: Any) -> float:  # noqa: ARG002 (given)
        """One frame."""
        x = float(y[0])
        for (b0, b1, a1), state in zip(self.sections, self.states, strict=True):
            out = b0 * x + b1 * state[0] - a1 * state[1]
            state[:] = x, out
            x = out
        self.k += self.dt * (self.rate * (x / SIZE) ** 2 - self.leak * (self.k - 1.0))
        self.k = min(max(self.k, 1.0), 4.0)
        return float(self.gain * self.k * x)


PAIRS = (("T1", "T2"), ("T3", "T4"))
SIZE = 1e-3  # p.u., an oscillation that is large


def _section(lead: float, gain: float, lag: float, dt: float) -> tuple[float, float, float]:
    """Bilinear coefficients of (gain + lead s) / (1 + lag s)."""
    c = 2.0 / dt
    scale = 1.0 + lag * c
    return (gain + lead * c) / scale, (gain - lead * c) / scale, (1.0 - lag * c) / scale


class IdentifiedLQG:
    """Identifies an ARX model in the first minute, with a small test signal, and is linear-quadratic for it then.

        y(k) = sum_i a_i y(k-i) + sum_i b_i u(k-i) + e(k),  i = 1..ORDER, by least squares (L. Ljung, System
        Identification, 1999, 4.2); the state is what the model has of the past, so the optimal state feedback for
        sum y^2 / SIZE^2 + weight u^2 / limit^2 is optimal for the noise e, too.

    Parameters: weight.
    """

    def __init__(self, spec: Any) -> None:
        """Nothing is known yet."""
        self.limit, self.weight = float(spec.limits[0]), spec.parameters["weight"]
        self.every = round(spec.frame_rate * PERIOD)
        self.random = np.random.default_rng(spec.seed)
        self.frames, self.sum, self.u, self.washed = 0, 0.0, 0.0, 0.0
        self.ys, self.us = deque[float](), deque[float]()
        self.gain: NDArray[np.float64] | None = None

    def step(self, t_s: float, y: NDArray[np.float64], age_s: Any, fresh: Any) -> float:  # noqa: ARG002 (given)
        """Means over PERIOD, the test signal, then the feedback."""
        self.frames += 1
        self.sum += float(y[0])
        if self.frames % self.every:
            return self.u
        mean, self.sum = self.sum / self.every, 0.0
        self.washed += PERIOD / WASHOUT * (mean - self.washed)
        self.ys.append((mean - self.washed) / SIZE)
        if self.gain is None:
            if t_s >= LEARNT:
                self.gain = self._design()
            elif self.frames % (self.every * HELD) == 0:
                self.u = TEST * self.limit * (1.0 if self.random.random() < 0.5 else -1.0)
        if self.gain is not None:
            past = [*list(self.ys)[: -ORDER - 1 : -1], *list(self.us)[:-ORDER:-1]]
            self.u = float(np.clip(-self.gain @ np.array(past), -1.0, 1.0)) * self.limit
        self.us.append(self.u / self.limit)
        return self.u

    def _design(self) -> NDArray[np.float64]:
        """State feedback on the last values of y and u."""
        y, u = np.array(self.ys), np.array([*self.us, 0.0])
        rows = [[*y[k - 1 :: -1][:ORDER], *u[k - 1 :: -1][:ORDER]] for k in range(ORDER, len(y))]
        theta = np.linalg.lstsq(np.array(rows), y[ORDER:], rcond=None)[0]
        n = 2 * ORDER - 1  # y(k) .. y(k-ORDER+1), u(k-1) .. u(k-ORDER+1)
        A, B = np.zeros((n, n)), np.zeros((n, 1))
        A[0] = [*theta[:ORDER], *theta[ORDER + 1 :]]
        A[1:ORDER, : ORDER - 1] = np.eye(ORDER - 1)
        A[ORDER + 1 :, ORDER:-1] = np.eye(ORDER - 2)
        B[0], B[ORDER] = theta[ORDER], 1.0
        Q = np.zeros((n, n))
        Q[0, 0] = 1.0
        R = np.array([[self.weight]])
        try:
            P = solve_discrete_are(A, B, Q + 1e-9 * np.eye(n), R)
        except (np.linalg.LinAlgError, ValueError):  # no stabilising feedback: it stays at rest
            return np.zeros(n)
        gain: NDArray[np.float64] = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)[0]
        return gain


PERIOD, WASHOUT, LEARNT = 0.1, 10.0, 60.0  # s: of the model, of the washout, of the identification
ORDER, HELD, TEST = 10, 5, 0.1  # of the model; periods of the test signal, and its part of the limit
