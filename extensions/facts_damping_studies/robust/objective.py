"""What a controller is tuned for: the mean index in all scenarios, and demands that hold in each of them.

    f(K) = mean_l ln(sqrt(J_l / J_l without control)) + sum of penalties of what is violated most

Demands: in each scenario, at each delay, the index is not larger than without control, and the least damping ratio in
the band no lower (LOST; above ENOUGH it may fall); the largest singular value of the sensitivity at the devices is at
most SENSITIVITY, which is a gain margin of M/(M - 1) and a phase margin of 2 asin(1/(2 M)) (S. Skogestad, I.
Postlethwaite, Multivariable Feedback Control, 2nd ed. 2005, 2.4); the gain of the loop is at most FADED at FAST_HZ; the
noise of the PMUs moves no setpoint by more than NOISE of its limit, rms; the controller itself is stable.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.linalg import eig

from facts_damping_studies.robust.loops import damping, value

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping_studies.robust.loops import Loop, Value
    from facts_damping_studies.robust.structures import Structure

    Array = NDArray[np.float64]
    Complex = NDArray[np.complex128]

SENSITIVITY = 2.0
NOISE = 0.1  # of a limit
ENOUGH, LOST = 0.10, 0.002  # damping ratio above which it may fall; what round-off and truncation may take
STABLE = 0.02  # 1/s, decay of the controller's own modes
HARM, DAMPING, PEAK, FAST, EFFORT, OWN = 10.0, 50.0, 1.0, 5.0, 20.0, 10.0  # penalties
SENSED_HZ = np.geomspace(0.05, 6.0, 60)  # at which the sensitivity is evaluated
FAST_HZ = (6.0, 9.0, 14.0, 20.0, 28.0)  # at which the loop's gain is at most FADED: frames cannot follow
FADED = 0.2


class Problem(NamedTuple):
    """Loops for which a controller is tuned, their transfer functions, and the noise of its signals."""

    scenarios: list[str]  # of each loop
    loops: list[Loop]
    responses: Complex  # (loops, frequencies SENSED_HZ and FAST_HZ, signals, devices), with delays
    noise: Array  # (signals,), rms, relative to their size
    frame_rate: float
    first: list[int]  # loops that count from the start of a tuning
    lost: frozenset[str]  # scenarios of the intact grid without a signal or a device

    def of(self, chosen: Sequence[int]) -> Problem:
        """The problem with some of the loops."""
        scenarios, loops = [self.scenarios[i] for i in chosen], [self.loops[i] for i in chosen]
        return self._replace(scenarios=scenarios, loops=loops, responses=self.responses[list(chosen)])

    def with_effort(self, effort: float) -> Problem:
        """The problem with another weight of setpoints at their limits, p.u.^2."""
        return self._replace(loops=[each._replace(effort=effort) for each in self.loops])

    def inverted(self, devices: Mapping[str, Sequence[int]]) -> Problem:
        """The problem with some devices inverted in some scenarios."""
        loops, responses = list(self.loops), self.responses.copy()
        for i, name in enumerate(self.scenarios):
            signs = np.ones(responses.shape[-1])
            signs[list(devices.get(name, ()))] = -1.0
            loops[i], responses[i] = loops[i]._replace(B=loops[i].B * signs), responses[i] * signs
        return self._replace(loops=loops, responses=responses)


class Judged(NamedTuple):
    """What a controller does in all loops."""

    values: list[Value]
    sensitivity: Array  # (loops,), largest
    fast: float  # largest gain of a loop at FAST_HZ
    effort: float  # largest rms of a setpoint for the noise, of its limit

    @property
    def log_ratio(self) -> float:
        """Mean of ln of the root of the index over that without control."""
        return float(np.mean([v.log_ratio for v in self.values]))


def objective(problem: Problem, structure: Structure, parameters: Array) -> tuple[float, Array]:
    """The objective and its gradient by the parameters; infinite if a loop is unstable."""
    K = structure.matrix(parameters)
    total, of_K = of_matrix(problem, K, structure.states)
    if not np.isfinite(total):
        return np.inf, np.zeros_like(parameters)
    return total, structure.gradient(parameters, of_K)


def of_matrix(problem: Problem, K: Array, states: int) -> tuple[float, Array]:
    """The objective and its gradient by K."""
    values = []
    for each in problem.loops:
        values.append(value(each, K, states))
        if not np.isfinite(values[-1].log_ratio):
            return np.inf, np.zeros_like(K)
    total = float(np.mean([v.log_ratio for v in values]))
    gradient = np.mean([v.of_index for v in values], axis=0)
    harm = max(values, key=lambda v: v.log_ratio)
    lacks = [lacking(each, v) for each, v in zip(problem.loops, values, strict=True)]
    worst = int(np.argmax(lacks))
    of_damping = damping(problem.loops[worst], K, states)[1] if lacks[worst] > 0.0 else np.zeros_like(K)
    peak, of_peak, _ = sensitivity(problem, K, states)
    fast, of_fast = fast_gain(problem, K, states)
    effort, of_effort = noise(problem, K, states)
    grows, of_growth = growth(K, states)
    for weight, excess, of_excess in (
        (HARM, harm.log_ratio, harm.of_index),
        (DAMPING, lacks[worst], -of_damping),
        (PEAK, peak - SENSITIVITY, of_peak),
        (FAST, fast - FADED, of_fast),
        (EFFORT, effort - NOISE, of_effort),
        (OWN, grows + STABLE, of_growth),
    ):
        if excess > 0.0:
            total, gradient = total + weight * excess, gradient + weight * of_excess
    return total, gradient


def lacking(loop: Loop, at: Value) -> float:
    """By how much the least damping ratio is below what a loop must have; negative: it is above."""
    return float(min(loop.damping, ENOUGH) - LOST - (loop.damping + at.damping))


def judged(problem: Problem, K: Array, states: int) -> Judged:
    """What a controller does in all loops of a problem."""
    values = [value(each, K, states, gradient=False) for each in problem.loops]
    fast = fast_gain(problem, K, states)[0]
    return Judged(values, sensitivity(problem, K, states)[2], fast, noise(problem, K, states)[0])


def violated(problem: Problem, result: Judged) -> Array:
    """How far each loop is from its demands, (loops,); at most 0: all are kept."""
    rows = zip(problem.loops, result.values, result.sensitivity, strict=True)
    return np.array(
        [
            np.inf if not np.isfinite(v.log_ratio) else max(v.log_ratio, 10.0 * lacking(x, v), m - SENSITIVITY)
            for x, v, m in rows
        ]
    )


def _responses(K: Array, states: int, hertz: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """K(s), and L and R with dK(s) = L dK R, at frequencies."""
    s = 2j * np.pi * hertz
    A, B, C, D = K[:states, :states], K[:states, states:], K[states:, :states], K[states:, states:]
    resolvent = np.linalg.inv(s[:, None, None] * np.eye(states) - A)
    left = np.concatenate([C @ resolvent, np.broadcast_to(np.eye(len(C)), (len(s), len(C), len(C)))], axis=2)
    right = np.concatenate(
        [resolvent @ B, np.broadcast_to(np.eye(B.shape[1]), (len(s), B.shape[1], B.shape[1]))], axis=1
    )
    return C @ resolvent @ B + D, left, right


def sensitivity(problem: Problem, K: Array, states: int) -> tuple[float, Array, Array]:
    """Largest singular value of (1 - K G)^-1 at the devices, its gradient by K, and the largest of each loop."""
    control, left, right = _responses(K, states, SENSED_HZ)
    responses = problem.responses[:, : len(SENSED_HZ)]
    S = np.linalg.inv(np.eye(control.shape[1]) - control @ responses)
    u, sizes, v = np.linalg.svd(S)
    first = sizes[..., 0]
    at, f = np.unravel_index(int(np.argmax(first)), first.shape)
    a = S[at, f].conj().T @ u[at, f, :, 0]
    b = responses[at, f] @ S[at, f] @ v[at, f, 0].conj()
    gradient = np.outer(left[f].T @ a.conj(), right[f] @ b).real
    return float(first[at, f]), gradient, first.max(axis=1)


def fast_gain(problem: Problem, K: Array, states: int) -> tuple[float, Array]:
    """Largest singular value of K G at FAST_HZ, and its gradient by K."""
    control, left, right = _responses(K, states, np.array(FAST_HZ))
    responses = problem.responses[:, len(SENSED_HZ) :]
    u, sizes, v = np.linalg.svd(control @ responses)
    at, f = np.unravel_index(int(np.argmax(sizes[..., 0])), sizes.shape[:2])
    b = responses[at, f] @ v[at, f, 0].conj()
    gradient = np.outer(left[f].T @ u[at, f, :, 0].conj(), right[f] @ b).real
    return float(sizes[at, f, 0]), gradient


def noise(problem: Problem, K: Array, states: int) -> tuple[float, Array]:
    """Largest rms of a setpoint for white noise of the signals, of its limit, without the loop; and its gradient."""
    hertz = (np.arange(64) + 0.5) / 128.0 * problem.frame_rate
    control, left, right = _responses(K, states, hertz)
    power = np.einsum("fds,s->d", np.abs(control) ** 2, problem.noise**2) / len(hertz)
    d = int(np.argmax(power))
    rms = float(np.sqrt(power[d]))
    row = control[:, d].conj() * problem.noise**2 / len(hertz)
    gradient = np.einsum("fi,fs,fjs->ij", left[:, d], row, right).real / max(rms, 1e-12)
    return rms, gradient


def growth(K: Array, states: int) -> tuple[float, Array]:
    """Largest real part of the controller's own eigenvalues, 1/s, and its gradient."""
    gradient = np.zeros_like(K)
    if not states:
        return -np.inf, gradient
    values, left, right = eig(K[:states, :states], left=True, right=True)
    i = int(np.argmax(values.real))
    w, v = left[:, i].conj(), right[:, i]
    gradient[:states, :states] = (np.outer(w, v) / (w @ v)).real if abs(w @ v) > 0.0 else 0.0
    return float(values[i].real), gradient
