"""Integrators for the plant: error of the speeds against cost, by method and step.

    python benchmarks/integrators.py [--out DIR]

Each case runs without wide-area control, with the devices named, to 1 s before synchronism is lost at most.
The error is the largest difference of a speed (p.u.) at 60 instants a second from the same plant with a step of
1/15360 s. Cost: evaluations of the derivatives, and time beside that of the shipped method at the shipped step in
the same run. Methods with a tableau are explicit; the implicit ones solve their equations by Newton's method with a
Jacobian by differences that is kept while it serves.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numba import njit

from facts_damping.case.loading import load_case
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.model import begin_interval, copy, workspace
from facts_damping.signals import to_ns
from facts_damping.simulation import assembly, loop

if TYPE_CHECKING:
    from numpy.typing import NDArray

CASES = {  # name: system, scenario, devices, end in s (1 s before synchronism is lost where it is)
    "small": ("two_area", "small", "[sssc]", 20.0),
    "large": ("two_area", "large", "[sssc]", 20.0),
    "small, STATCOM": ("two_area", "small", "[sssc, statcom]", 20.0),
    "large, STATCOM": ("two_area", "large", "[sssc, statcom]", 20.0),
    "multiple, STATCOM": ("two_area", "multiple", "[sssc, statcom]", 20.0),
    "smib nominal": ("smib", "nominal", "[sssc]", 20.0),
    "smib heavy": ("smib", "heavy", "[sssc]", 40.0),
    "smib multiple": ("smib", "multiple", "[sssc]", 20.0),
}
STEPS = (120, 240, 360, 480, 960, 1920)  # 1/s
FRAMES = 60  # 1/s
FINE = 15360  # 1/s, of the reference
SHIPPED = ("RK4", 480)


class Tableau(NamedTuple):
    """A Runge-Kutta method: lower triangle, with diagonal if it is diagonally implicit; weights."""

    A: NDArray[np.float64]
    b: NDArray[np.float64]


class Motion(NamedTuple):
    """A plant in an interval between events, with its state and work space."""

    plant: Any
    state: Any
    interval: int
    work: Any


def tableau(rows: list[list[float]], weights: list[float]) -> Tableau:
    """A tableau that checks its consistency."""
    A = np.zeros((len(weights), len(weights)))
    for i, row in enumerate(rows):
        A[i + 1, : len(row)] = row
    if abs(sum(weights) - 1) > 1e-14:
        raise ValueError(f"weights sum to {sum(weights)}; allowed: 1")
    return Tableau(A, np.array(weights))


EXPLICIT = {
    "Heun": tableau([[1.0]], [0.5, 0.5]),
    "RK3": tableau([[0.5], [-1.0, 2.0]], [1 / 6, 2 / 3, 1 / 6]),
    "RK4": tableau([[0.5], [0.0, 0.5], [0.0, 0.0, 1.0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6]),
    "DOPRI5": tableau(
        [
            [1 / 5],
            [3 / 40, 9 / 40],
            [44 / 45, -56 / 15, 32 / 9],
            [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
            [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
        ],
        [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ),
}
GAMMA = 1 - 0.5**0.5
IMPLICIT = {
    "trapezoidal": Tableau(np.array([[0.0, 0.0], [0.5, 0.5]]), np.array([0.5, 0.5])),
    "SDIRK2": Tableau(np.array([[GAMMA, 0.0], [1 - GAMMA, GAMMA]]), np.array([1 - GAMMA, GAMMA])),
}


@njit(error_model="numpy")
def explicit(motion: Motion, method: Tableau, h: float, steps: int, k: Any, trial: Any) -> int:
    """Explicit steps; the number of evaluations."""
    plant, state, interval, work = motion
    x, A, b = state.x, method.A, method.b
    for _ in range(steps):
        for i in range(b.size):
            trial[:] = x
            for j in range(i):
                if A[i, j] != 0.0:
                    trial += h * A[i, j] * k[j]
            derivatives(plant, trial, state.reference, state.source, interval, k[i], work)
        for i in range(b.size):
            x += h * b[i] * k[i]
    return int(steps * b.size)


@njit(error_model="numpy")
def jacobian(motion: Motion, f0: Any, f1: Any, out: Any) -> int:
    """Jacobian of the derivatives by forward differences; the number of evaluations."""
    plant, state, interval, work = motion
    derivatives(plant, state.x, state.reference, state.source, interval, f0, work)
    for i in range(state.x.size):
        before, step = state.x[i], 1e-7 * max(1.0, abs(state.x[i]))
        state.x[i] += step
        derivatives(plant, state.x, state.reference, state.source, interval, f1, work)
        state.x[i] = before
        out[:, i] = (f1 - f0) / step
    return int(state.x.size + 1)


@njit(error_model="numpy")
def implicit(motion: Motion, method: Tableau, h: float, k: Any, trial: Any, inverse: Any, last: bool) -> int:
    """One diagonally implicit step with a given inverse of I - h a J; evaluations, negative where it does not converge.

    With `last` what eight iterations give is taken: where an integrator is frozen at its limit the derivatives
    jump, and there may be nothing to converge to.
    """
    plant, state, interval, work = motion
    done, A, b = 0, method.A, method.b
    for i in range(b.size):
        start = state.x.copy()
        for j in range(i):
            start += h * A[i, j] * k[j]
        trial[:] = start
        if A[i, i] > 0.0:
            solved = False
            for _ in range(8):
                derivatives(plant, trial, state.reference, state.source, interval, k[i], work)
                done += 1
                change = inverse @ (trial - start - h * A[i, i] * k[i])
                trial -= change
                if np.abs(change).max() < 1e-10:
                    solved = True
                    break
            if not (solved or last):
                return -done - 1
        derivatives(plant, trial, state.reference, state.source, interval, k[i], work)
        done += 1
    x = state.x
    for i in range(b.size):
        x += h * b[i] * k[i]
    return done


def follow(case: Any, method: str, rate: int, end: float) -> tuple[NDArray[np.float64], int, float]:
    """Speeds (instants, machines), evaluations and seconds of a run by a method with steps of 1/rate at most."""
    built = assembly.build_plant(case)
    plant, state = built.plant, copy(built.state)
    work, n = workspace(plant, state), len(state.x)
    speed_states = plant.machines["offset"] + 1
    weights = (EXPLICIT | IMPLICIT)[method]
    k, trial, matrix, f0, f1 = np.zeros((len(weights.b), n)), np.zeros(n), np.zeros((n, n)), np.zeros(n), np.zeros(n)
    instants = {to_ns(i / FRAMES) for i in range(round(end * FRAMES) + 1)}
    borders = sorted(instants | {int(t) for t in plant.interval_start_ns if t < to_ns(end)})
    speeds, evaluations, factored_for, inverse = [], 0, None, np.zeros((n, n))
    began = time.perf_counter()
    for now, then in zip(borders, [*borders[1:], None], strict=True):
        motion = Motion(plant, state, begin_interval(plant, state, now), work)
        if now in instants:
            speeds.append(state.x[speed_states].copy())
        if then is None:
            break
        steps = -(-(then - now) * rate // 1_000_000_000)
        h = (then - now) * 1e-9 / steps
        if method in EXPLICIT:
            evaluations += explicit(motion, weights, h, steps, k, trial)
            continue
        for _ in range(steps):
            for attempt in range(2):
                if factored_for != (motion.interval, h) or attempt:
                    evaluations += jacobian(motion, f0, f1, matrix)
                    inverse = np.linalg.inv(np.eye(n) - h * weights.A[-1, -1] * matrix)
                    factored_for = (motion.interval, h)
                done = implicit(motion, weights, h, k, trial, inverse, attempt == 1)
                evaluations += abs(done)
                if done > 0:
                    break
    return np.array(speeds), evaluations, time.perf_counter() - began


def study(name: str, folder: Path | None) -> None:
    """One case: a row a method and step."""
    system, scenario, devices, end = CASES[name]
    case = load_case(None, [f"system={system}", f"scenario={scenario}", f"devices={devices}", "controllers=[]"])
    ticks = loop.run(case)
    if not ticks.in_synchronism[-1]:
        end = min(end, float(ticks.time_s[-1]) - 1.0)
    reference, _, _ = follow(case, "RK4", FINE, end)
    _, _, beside = follow(case, *SHIPPED, end)
    print(f"\n{name}: {system} {scenario}, devices {devices}, to {end:.2f} s; peak {np.abs(reference).max():.2e} p.u.")
    print("method        step      error p.u.   evaluations   time beside RK4 1/480")
    curves: dict[str, list[tuple[int, float]]] = {}
    for method in (*EXPLICIT, *IMPLICIT):
        for rate in STEPS:
            speeds, evaluations, took = follow(case, method, rate, end)
            error = float(np.abs(speeds - reference).max())
            shown = f"{error:.1e}" if np.isfinite(error) else "unstable"
            print(f"{method:<12} 1/{rate:<6} {shown:>10} {evaluations:13d} {took / beside:12.2f}")
            if np.isfinite(error):
                curves.setdefault(method, []).append((evaluations, error))
    if folder is not None:
        plot(name, curves, folder)


def plot(name: str, curves: dict[str, list[tuple[int, float]]], folder: Path) -> None:
    """Error over evaluations, log-log."""
    figure = Figure(figsize=(6.5, 4.5), layout="constrained")
    axes = figure.add_subplot()
    for method, points in curves.items():
        axes.loglog(*zip(*points, strict=True), "o-", label=method, markersize=4)
    axes.set(xlabel="evaluations of the derivatives", ylabel="largest error of a speed [p.u.]", title=name)
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(folder / f"integrators_{name.replace(', ', '_').replace(' ', '_')}.png", dpi=150)


def main() -> None:
    """All cases."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for pictures")
    parser.add_argument("--case", choices=[*CASES], action="append", help="only these; repeatable")
    arguments = parser.parse_args()
    if arguments.out is not None:
        arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.case or CASES:
        study(name, arguments.out)


if __name__ == "__main__":
    main()
