"""Searches in the unit cube: what they find, what they ask, what they hand on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping_studies.search.optimisers import METHODS, Found

if TYPE_CHECKING:
    from numpy.typing import NDArray

every_method = pytest.mark.parametrize("method", METHODS)
SIZE, POINTS = 5, 16


class Bowl:
    """An ellipsoid on end, with axes from 1 to 10, and its least at a point of the cube; knows what it was asked."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        self.minimum = random.uniform(0.2, 0.8, SIZE)
        axes, _ = np.linalg.qr(random.normal(size=(SIZE, SIZE)))
        self.turn = axes * np.geomspace(1.0, 10.0, SIZE)
        self.asked: list[tuple[float, ...]] = []
        self.told: list[float] = []

    def __call__(self, at: NDArray[np.float64]) -> float:
        self.asked.append(tuple(at))
        self.told.append(float(np.linalg.norm((at - self.minimum) @ self.turn)))
        return self.told[-1]


def start(seed: int) -> NDArray[np.float64]:
    return np.random.default_rng(seed).random((POINTS, SIZE))


def search(method: str, seed: int, generations: int) -> tuple[Bowl, Found]:
    bowl = Bowl(seed)
    return bowl, METHODS[method](bowl, start(seed), generations, np.random.default_rng(seed))


@every_method
@pytest.mark.parametrize("seed", range(3))
def test_least_is_found(method: str, seed: int) -> None:
    bowl, optimum = search(method, seed, 120)
    np.testing.assert_allclose(optimum.best, bowl.minimum, atol=1e-3)


@every_method
@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**31), generations=st.integers(1, 8))
def test_optimiser_spends_its_budget_in_the_cube_and_hands_on_its_best(
    method: str, seed: int, generations: int
) -> None:
    bowl, optimum = search(method, seed, generations)
    assert len(bowl.asked) == generations * POINTS
    assert 0.0 <= np.min(bowl.asked) <= np.max(bowl.asked) <= 1.0
    assert bowl.asked[:POINTS] == [tuple(at) for at in start(seed)]
    assert tuple(optimum.best) == bowl.asked[int(np.argmin(bowl.told))]
    assert optimum.value == min(bowl.told)
    assert optimum.population.shape == (POINTS, SIZE)
    assert {tuple(optimum.best)} <= {tuple(at) for at in optimum.population} <= set(bowl.asked)


@every_method
def test_search_is_one_of_its_seed_whatever_was_drawn_before(method: str) -> None:
    first, _ = search(method, 1, 5)
    np.random.standard_normal(7)  # noqa: NPY002 (the global generator, which a library might draw from)
    again, _ = search(method, 1, 5)
    other = Bowl(1)
    METHODS[method](other, start(1), 5, np.random.default_rng(2))
    assert first.asked == again.asked != other.asked


@every_method
def test_optimiser_goes_on_from_identical_start_points(method: str) -> None:
    bowl = Bowl(3)
    optimum = METHODS[method](bowl, np.full((POINTS, SIZE), 0.5), 3, np.random.default_rng(3))
    assert bowl(optimum.best) <= bowl(np.full(SIZE, 0.5))
