"""Population-based minimisation in the unit cube, by published methods from libraries."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.optimize
from cmaes import CMA

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Objective = Callable[[NDArray[np.float64]], float]

WIDEST = 0.15  # largest standard deviation of the first generation of CMA-ES around its mean


class Found(NamedTuple):
    """The best point of a search, and its population, from which another search may continue."""

    best: NDArray[np.float64]  # (coordinates,)
    value: float  # objective at the best point
    population: NDArray[np.float64]  # (points, coordinates); includes the best


def differential_evolution(
    objective: Objective, population: NDArray[np.float64], generations: int, random: np.random.Generator
) -> Found:
    """Storn and Price, Journal of Global Optimization 11, 1997; strategy best/1/bin with dither, as in SciPy."""
    optimum = scipy.optimize.differential_evolution(
        objective,
        [(0.0, 1.0)] * population.shape[1],
        init=population,
        maxiter=generations - 1,
        rng=random,
        tol=0.0,
        polish=False,
    )
    return Found(optimum.x, float(optimum.fun), optimum.population)


def cma_es(
    objective: Objective, population: NDArray[np.float64], generations: int, random: np.random.Generator
) -> Found:
    """Hansen, The CMA Evolution Strategy: A Tutorial, arXiv:1604.00772, started at the best of the population.

    The first standard deviation equals that of the population around the best, at most `WIDEST`.
    """
    count, size = population.shape
    values = np.array([objective(at) for at in population])
    search = CMA(
        mean=population[values.argmin()],
        sigma=min(WIDEST, float(population.std(axis=0).mean()) or WIDEST),
        bounds=np.array([[0.0, 1.0]] * size),
        seed=int(random.integers(2**32)),
        population_size=count,
    )
    best, minimum = population[values.argmin()], values.min()
    for _ in range(generations - 1):
        population = np.array([search.ask() for _ in range(count)])
        values = np.array([objective(at) for at in population])
        search.tell(list(zip(population, values, strict=True)))
        if values.min() < minimum:
            best, minimum = population[values.argmin()], values.min()
    population[values.argmax()] = best
    return Found(best, float(minimum), population)


METHODS = {"differential-evolution": differential_evolution, "cma-es": cma_es}
