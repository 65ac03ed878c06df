"""Tuning of a structure for all scenarios: the loops of which demands are violated join those it is tuned for.

In some scenarios a device acts the other way round, as an SSSC does when the power in its line turns. No law with one
sign damps both. Where the law with that device inverted keeps the demands and the law itself does not, the scenario
counts with the device inverted, and is named: who uses the law must know the sign.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping_studies.robust.nonsmooth import minimum
from facts_damping_studies.robust.objective import Judged, judged, objective, violated

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping_studies.robust.objective import Problem
    from facts_damping_studies.robust.structures import Structure

    Array = NDArray[np.float64]

ROUNDS, JOIN = 3, 4  # rounds of tuning, and loops that join after each
FALLING, WEAKER = 0.7, 25  # of the gain of a start that is unstable somewhere, and how often at most
ROUND_OFF = 1e-4  # of a violation
SLOWLY, OFTEN = 0.95, 60  # the same of a law that violates demands
TURNED = 0.1  # violation from which on an inverted device is looked for


class Tuned(NamedTuple):
    """A structure's parameters, what they do in all loops, and whether all demands are kept."""

    structure: Structure
    parameters: Array
    judged: Judged
    violation: float  # largest; at most ROUND_OFF: all demands are kept
    value: float  # of the objective, in all loops
    inverted: dict[str, list[int]]  # by scenario: devices that act the other way round

    @property
    def kept(self) -> bool:
        """Whether all demands are kept."""
        return self.violation <= ROUND_OFF

    @property
    def K(self) -> Array:
        """The matrix of the law."""
        return self.structure.matrix(self.parameters)


def tuned(
    problem: Problem, structure: Structure, evaluations: int, seed: int, progress: Callable[[int, int], None]
) -> Tuned:
    """The parameters tuned with at most some `evaluations` in each round."""
    random = np.random.default_rng(seed)
    chosen, parameters, inverted = list(problem.first), structure.start, dict[str, list[int]]()
    for i in range(ROUNDS):
        parameters = stabilised(problem.of(chosen), structure, parameters)
        part = problem.of(chosen)

        def f(x: Array, part: Problem = part) -> tuple[float, Array]:
            return objective(part, structure, x)

        def done(n: int, i: int = i) -> None:
            progress(i * evaluations + min(n, evaluations), ROUNDS * evaluations)

        parameters = minimum(f, parameters, evaluations, random, done).at
        K = structure.matrix(parameters)
        turned = opposed(problem, K, structure.states)
        problem, inverted = problem.inverted(turned), inverted | turned
        far = violated(problem, judged(problem, K, structure.states))
        join = [int(k) for k in np.argsort(-far)[:JOIN] if far[k] > 0.0 and k not in chosen]
        if not join and not set(turned):
            break
        chosen += join
    progress(1, 1)
    return assessed(problem, structure, stabilised(problem, structure, parameters), inverted)


def stabilised(problem: Problem, structure: Structure, parameters: Array) -> Array:
    """The parameters with the largest gain, at most theirs, with which all loops are stable."""
    for _ in range(WEAKER):
        if np.isfinite(objective(problem, structure, parameters)[0]):
            break
        parameters = structure.weaker(parameters, FALLING)
    return parameters


def opposed(problem: Problem, K: Array, states: int) -> dict[str, list[int]]:
    """Scenarios whose demands are violated, and kept if some devices are inverted: these, by scenario."""
    far = violated(problem, judged(problem, K, states))
    turned: dict[str, list[int]] = {}
    devices = K.shape[0] - states
    for name in dict.fromkeys(problem.scenarios):
        at = [i for i, scenario in enumerate(problem.scenarios) if scenario == name]
        if name in problem.lost or not far[at].max() > TURNED:
            continue
        for signs in product((1.0, -1.0), repeat=devices):
            other = K.copy()
            other[states:] *= np.array(signs)[:, None]
            part = problem.of(at)
            if min(signs) < 0.0 and violated(part, judged(part, other, states)).max() < min(TURNED, far[at].max()):
                turned[name] = [d for d, sign in enumerate(signs) if sign < 0.0]
                break
    return turned


def assessed(problem: Problem, structure: Structure, parameters: Array, inverted: dict[str, list[int]]) -> Tuned:
    """What parameters do in all loops."""
    result = judged(problem, structure.matrix(parameters), structure.states)
    value, _ = objective(problem, structure, parameters)
    return Tuned(structure, parameters, result, float(violated(problem, result).max()), value, inverted)


def weakest_kept(problem: Problem, result: Tuned) -> Tuned:
    """The law with the largest gain, at most its own, with which all demands are kept."""
    structure, parameters = result.structure, result.parameters
    for _ in range(OFTEN):
        if result.kept:
            break
        parameters = structure.weaker(parameters, SLOWLY)
        result = assessed(problem, structure, parameters, result.inverted)
    return result


def best(results: Sequence[Tuned]) -> Tuned:
    """The law with the least index of those that keep all demands; of none that do, the one that is nearest."""
    keeping = [result for result in results if result.kept]
    if keeping:
        return min(keeping, key=lambda result: result.judged.log_ratio)
    return min(results, key=lambda result: result.violation)
