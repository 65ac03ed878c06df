"""Structures of controllers: how a few numbers make the matrix K = [A B; C D] of a continuous law u = K(s) y.

- Lead-lag: u_d = sum_s k s Tw/(1 + s Tw) ((1 + s T1)/(1 + s T2))^2 y_s, a channel for each pair of device and signal;
  decentralised with a signal for each device.
- Free: all entries of K but D, of any order.

Signals are relative to their size, setpoints to their limits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import block_diag

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

LEAD_LAG = "lead-lag"
WASHOUT = 10.0  # s
FASTEST, SLOWEST = 0.02, 2.0  # s, of the time constants of a lead-lag
STEP = 1e-6  # of the differences of K


class Structure(NamedTuple):
    """A structure and a start: `matrix` makes K of its parameters, `gains` are those that scale all setpoints."""

    name: str
    start: Array
    matrix: Callable[[Array], Array]
    states: int
    gains: NDArray[np.bool_]  # (parameters,)
    used: NDArray[np.bool_] | None = None  # entries of K that are the parameters; None: K is made of them otherwise

    def weaker(self, parameters: Array, factor: float) -> Array:
        """The parameters with all setpoints times a factor."""
        return np.where(self.gains, factor * parameters, parameters)

    def gradient(self, parameters: Array, of_K: Array) -> Array:
        """The gradient by the parameters of what has a gradient by K; slopes of K by central differences."""
        if self.used is not None:
            used: Array = of_K[self.used]
            return used
        steps = STEP * np.eye(len(parameters))
        slopes = [(self.matrix(parameters + s) - self.matrix(parameters - s)) / (2.0 * STEP) for s in steps]
        return np.asarray(np.einsum("pij,ij->p", np.array(slopes), of_K))


class Channel(NamedTuple):
    """A lead-lag from a signal to a device: k (p.u. of the limit per size of the signal), T1 and T2 (s)."""

    device: int
    signal: int
    gain: float
    T1: float
    T2: float


def lead_lags(channels: Sequence[Channel], devices: int, signals: int) -> Structure:
    """Lead-lags with free gains and time constants."""
    pairs = [(channel.device, channel.signal) for channel in channels]
    start = np.array([[c.gain, _unbounded(c.T1), _unbounded(c.T2)] for c in channels]).ravel()

    def matrix(parameters: Array) -> Array:
        rows = parameters.reshape(-1, 3)
        parts = [_section(gain, time_constant(a), time_constant(b)) for gain, a, b in rows]
        into, out = np.zeros((len(pairs), signals)), np.zeros((devices, len(pairs)))
        for i, (device, signal) in enumerate(pairs):
            into[i, signal], out[device, i] = 1.0, 1.0
        A, B, C, D = (block_diag(*[part[i] for part in parts]) for i in range(4))
        return np.block([[A, B @ into], [out @ C, out @ D @ into]])

    return Structure(LEAD_LAG, start, matrix, 3 * len(pairs), np.arange(len(start)) % 3 == 0)


def channels_of(parameters: Array, like: Sequence[Channel]) -> list[Channel]:
    """The channels that parameters of `lead_lags` mean."""
    rows = parameters.reshape(-1, 3)
    return [
        channel._replace(gain=float(gain), T1=time_constant(a), T2=time_constant(b))
        for channel, (gain, a, b) in zip(like, rows, strict=True)
    ]


def time_constant(parameter: float) -> float:
    """A time constant (s) between FASTEST and SLOWEST, by a logistic function of the parameter."""
    return float(FASTEST * (SLOWEST / FASTEST) ** (1.0 / (1.0 + np.exp(-parameter))))


def _unbounded(seconds: float) -> float:
    share = np.log(np.clip(seconds, 1.02 * FASTEST, 0.98 * SLOWEST) / FASTEST) / np.log(SLOWEST / FASTEST)
    return float(np.log(share / (1.0 - share)))


def _section(gain: float, T1: float, T2: float) -> tuple[Array, Array, Array, Array]:
    """A washout and two equal lead-lags in series."""
    ratio = T1 / T2
    A = np.array(
        [
            [-1.0 / WASHOUT, 0.0, 0.0],
            [-1.0 / T2, -1.0 / T2, 0.0],
            [-ratio / T2, (1.0 - ratio) / T2, -1.0 / T2],
        ]
    )
    B = np.array([[1.0 / WASHOUT], [1.0 / T2], [ratio / T2]])
    C = gain * np.array([[-ratio * ratio, ratio * (1.0 - ratio), 1.0 - ratio]])
    return A, B, C, np.array([[gain * ratio * ratio]])


def free(name: str, K: Array, states: int) -> Structure:
    """All entries of a matrix but D, which is zero: the law's gain falls with the frequency; those of A are in 1/s."""
    used = np.ones(K.shape, bool)
    used[states:, states:] = False
    gains = np.broadcast_to(np.arange(len(K))[:, None] >= states, K.shape)[used]

    def matrix(parameters: Array) -> Array:
        whole = np.zeros(K.shape)
        whole[used] = parameters
        return whole

    return Structure(name, K[used], matrix, states, gains, used)
