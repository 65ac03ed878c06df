"""Linear algebra that does not go through BLAS, against the libraries that do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import scipy.linalg

from facts_damping.numerics.matrices import (
    eigenvalue_near,
    exponential,
    least_squares,
    lyapunov,
    product,
    riccati,
    sign,
    singular,
    solve,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

SIZES = [1, 2, 7, 40]


def drawn(*shape: int) -> NDArray[np.float64]:
    """Numbers without any pattern, the same at each call."""
    return np.random.default_rng(shape).normal(size=shape)


@pytest.mark.parametrize("n", SIZES)
def test_product_of_matrices_and_vectors(n: int) -> None:
    a, b, v = drawn(n, 3), drawn(3, n), drawn(n)
    np.testing.assert_allclose(product(a, b), a @ b, atol=1e-13)
    np.testing.assert_allclose(product(a.T, a, b[:, ::-1]), a.T @ a @ b[:, ::-1], atol=1e-12)
    np.testing.assert_allclose(product(b, 1j * v), b @ (1j * v), atol=1e-13)
    np.testing.assert_allclose(product(v, a), v @ a, atol=1e-13)
    np.testing.assert_allclose(product(v, v), v @ v, atol=1e-13)
    assert product(a, np.zeros((3, 0))).shape == (n, 0)


@pytest.mark.parametrize("n", SIZES)
def test_solution_of_real_and_complex_equations(n: int) -> None:
    a, b = drawn(n, n), drawn(n, 3)
    copies = a.copy(), b.copy()
    np.testing.assert_allclose(a @ solve(a, b), b, atol=1e-11)
    np.testing.assert_allclose(solve(a, b[:, 0]), solve(a, b)[:, 0], rtol=0)
    np.testing.assert_allclose((a + 1j * a.T) @ solve(a + 1j * a.T, b), b, atol=1e-11)
    assert np.array_equal(a, copies[0])  # what is given stays as it is
    assert np.array_equal(b, copies[1])


def test_rows_are_exchanged_where_a_pivot_is_small_and_singular_matrices_refused() -> None:
    tiny = np.array([[1e-20, 1.0], [1.0, 1.0]])
    np.testing.assert_allclose(solve(tiny, np.array([1.0, 2.0])), [1.0, 1.0], rtol=1e-15)
    with pytest.raises(np.linalg.LinAlgError):
        solve(np.array([[1.0, 2.0], [2.0, 4.0]]), np.ones(2))


@pytest.mark.parametrize("size", [0.0, 1e-9, 0.3, 40.0])
@pytest.mark.parametrize("n", SIZES)
def test_exponential(n: int, size: float) -> None:
    a = size * drawn(n, n) / n
    expected = scipy.linalg.expm(a)
    np.testing.assert_allclose(exponential(a), expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize(("rows", "columns", "rank"), [(5, 5, 5), (9, 4, 4), (4, 9, 4), (8, 6, 3)])
def test_least_squares(rows: int, columns: int, rank: int) -> None:
    """Also where many solutions are as good: the smallest one."""
    a, b = drawn(rows, rank) @ drawn(rank, columns), drawn(rows)
    np.testing.assert_allclose(least_squares(a, b), np.linalg.lstsq(a, b, rcond=None)[0], atol=1e-12)


@pytest.mark.parametrize("n", SIZES)
def test_sign_has_the_same_eigenvectors(n: int) -> None:
    a = drawn(n, n)
    s = sign(a)
    np.testing.assert_allclose(s @ s, np.eye(n), atol=1e-9)
    np.testing.assert_allclose(s @ a, a @ s, atol=1e-9)
    assert round(np.trace(s)) == np.sum(np.sign(np.linalg.eigvals(a).real))
    with pytest.raises(np.linalg.LinAlgError):
        sign(np.array([[0.0, 1.0], [-1.0, 0.0]]))


@pytest.mark.parametrize("n", SIZES)
def test_lyapunov(n: int) -> None:
    a, b = drawn(n, n) - 3.0 * np.sqrt(n) * np.eye(n), drawn(n, 2)
    x = lyapunov(a, b @ b.T)
    np.testing.assert_allclose(a @ x + x @ a.T, -b @ b.T, atol=1e-12)


@pytest.mark.parametrize("n", SIZES)
def test_riccati(n: int) -> None:
    """Also where the plant is unstable."""
    a, b, c, r = 1.5 * drawn(n, n) / np.sqrt(n), drawn(n, 2), drawn(3, n), np.diag([1.0, 4.0])
    x = riccati(a, b, c.T @ c, r)
    expected = scipy.linalg.solve_discrete_are(a, b, c.T @ c, r)
    np.testing.assert_allclose(x, expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize(("moved", "seen"), [(0.0, 1.0), (1.0, 0.0)])
def test_riccati_of_what_is_not_moved_or_not_seen_has_no_solution(moved: float, seen: float) -> None:
    a, b, c = np.diag([1.1, 0.5]), np.array([[moved], [1.0]]), np.array([[seen, 1.0]])
    with pytest.raises(np.linalg.LinAlgError):
        riccati(a, b, c.T @ c, np.eye(1))


@pytest.mark.parametrize("shape", [(1, 1), (7, 4), (4, 7), (40, 40)])
def test_singular_values(shape: tuple[int, int]) -> None:
    a = drawn(*shape)
    u, s, v = singular(a)
    np.testing.assert_allclose(u * s @ v.T, a, atol=1e-12)
    np.testing.assert_allclose(s[: min(shape)], np.linalg.svd(a)[1], atol=1e-12)
    np.testing.assert_allclose(v.T @ v, np.eye(shape[1]), atol=1e-12)


def test_singular_values_that_are_zero() -> None:
    a = np.outer([1.0, 2.0, 3.0], [3.0, 4.0])
    u, s, v = singular(a)
    np.testing.assert_allclose(s, [5.0 * np.sqrt(14.0), 0.0], atol=1e-14)
    np.testing.assert_allclose(u * s @ v.T, a, atol=1e-14)


@pytest.mark.parametrize("digits", [4, 5, 12])
def test_eigenvalue_comes_to_all_its_digits_from_a_few(digits: int) -> None:
    """Of a matrix that is symmetric in its two halves, too: there half of all eigenvectors are antisymmetric."""
    part = drawn(6, 6)
    for a in (drawn(12, 12), np.block([[part, 0.1 * part.T], [0.1 * part.T, part]])):
        for value in np.linalg.eigvals(a):
            eigenvalue, right, left = eigenvalue_near(a, complex(np.round(value, digits)))
            assert abs(eigenvalue - value) < 1e-11
            np.testing.assert_allclose(a @ right, eigenvalue * right, atol=1e-11)
            np.testing.assert_allclose(left @ a, eigenvalue * left, atol=1e-11)


def test_guesses_that_differ_by_less_than_the_grid_give_the_same_bits() -> None:
    a = drawn(12, 12)
    value = complex(np.linalg.eigvals(a)[0])
    exact, other = eigenvalue_near(a, value), eigenvalue_near(a, value + 1e-10)
    assert exact[0] == other[0]
    assert np.array_equal(exact[1:], other[1:])
