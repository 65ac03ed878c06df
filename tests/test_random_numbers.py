"""Random numbers against NumPy's own: the same numbers up to last digits, and streams that go on at the same place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping import random_numbers

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Draw = Callable[[np.random.Generator], NDArray[np.float64]]

MANY = 200_000
PAIRS: dict[str, tuple[Draw, Draw]] = {
    "random": (lambda g: random_numbers.random(g, (MANY, 2)), lambda g: g.random((MANY, 2))),
    "uniform": (lambda g: random_numbers.uniform(g, 0.01, 0.07, MANY), lambda g: g.uniform(0.01, 0.07, MANY)),
    "standard_normal": (
        lambda g: random_numbers.standard_normal(g, (MANY, 3)),
        lambda g: g.standard_normal((MANY, 3)),
    ),
    "normal": (lambda g: random_numbers.normal(g, 0.02, 0.01, MANY), lambda g: g.normal(0.02, 0.01, MANY)),
    "lognormal": (lambda g: random_numbers.lognormal(g, 0.0, 0.5, MANY), lambda g: g.lognormal(0.0, 0.5, MANY)),
    "exponential": (lambda g: random_numbers.exponential(g, 0.03, MANY), lambda g: g.exponential(0.03, MANY)),
    **{
        f"gamma {k}": (
            lambda g, k=k: random_numbers.gamma(g, k, 0.01, MANY),  # type: ignore[misc]
            lambda g, k=k: g.gamma(k, 0.01, MANY),  # type: ignore[misc]
        )
        for k in (0.05, 0.7, 1.0, 1.1, 2.5, 40.0)
    },
    "none": (lambda g: random_numbers.normal(g, 0.0, 1.0, (0, 3)), lambda g: g.normal(0.0, 1.0, (0, 3))),
}


def place(generator: np.random.Generator) -> tuple[Any, ...]:
    """Where a generator's stream is, and the half of a number that is left, where one is."""
    state: Any = generator.bit_generator.state
    return state["state"]["state"], state["has_uint32"], state["uinteger"] * state["has_uint32"]


@pytest.mark.parametrize("seed", [0, 7])
@pytest.mark.parametrize("name", PAIRS)
def test_numbers_are_numpys(name: str, seed: int) -> None:
    generator, theirs = np.random.default_rng(seed), np.random.default_rng(seed)
    numbers, expected = PAIRS[name][0](generator), PAIRS[name][1](theirs)
    assert numbers.shape == expected.shape
    added = 0.1 if name == "normal" else 0.0  # a sum near zero has the round-off of what is added
    few = 200 if "0.05" in name else 4  # ulp; a power of 20 makes more of it
    assert (np.abs(numbers - expected) <= few * np.spacing(np.abs(expected) + added)).all()
    assert place(generator) == place(theirs)


@pytest.mark.parametrize("bound", [1, 2, 576, 3_000_000_000])
@pytest.mark.parametrize("many", [1, 2, 100_001])
def test_whole_numbers_are_numpys(bound: int, many: int) -> None:
    generator, theirs = np.random.default_rng(3), np.random.default_rng(3)
    np.testing.assert_array_equal(random_numbers.integers(generator, bound, many), theirs.integers(0, bound, many))
    if bound > 1:  # of one number NumPy draws none
        assert place(generator) == place(theirs)


def test_stream_keeps_the_half_that_whole_numbers_leave() -> None:
    generator, theirs = np.random.default_rng(3), np.random.default_rng(3)
    theirs.integers(0, 10, 3)
    generator.integers(0, 10, 3)
    np.testing.assert_allclose(random_numbers.standard_normal(generator, 10), theirs.standard_normal(10), rtol=1e-15)
    assert place(generator) == place(theirs)
