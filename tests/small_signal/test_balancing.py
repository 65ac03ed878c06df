"""What an LQG leaves out of the plant: the error is within the bound of balanced truncation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from facts_damping.small_signal.lqg import KEPT, balancing


@pytest.mark.parametrize("seed", range(5))
def test_truncated_model_is_within_twice_the_sum_of_the_hankel_singular_values_left_out(seed: int) -> None:
    """K. Glover, All optimal Hankel-norm approximations, Int. J. Control 39(6), 1984; gramians by SciPy."""
    random = np.random.default_rng(seed)
    states = 12
    S = random.normal(size=(states, states))
    A = S @ np.diag(-np.logspace(-1, 3, states)) @ np.linalg.inv(S)
    B, C = random.normal(size=(states, 2)), random.normal(size=(3, states))
    reach, observe = (solve_continuous_lyapunov(M, -Q) for M, Q in ((A, B @ B.T), (A.T, C.T @ C)))
    values = np.sort(np.sqrt(np.linalg.eigvals(reach @ observe).real.clip(0.0)))[::-1]
    T, back = balancing(A, B, C)
    left_out = values[T.shape[1] :]
    assert len(left_out) > 0
    assert (left_out < KEPT * values[0] * (1 + 1e-3)).all()
    errors = []
    for s in 1j * np.logspace(-3, 5, 200):
        whole = C @ np.linalg.solve(s * np.eye(states) - A, B)
        small = C @ T @ np.linalg.solve(s * np.eye(T.shape[1]) - back @ A @ T, back @ B)
        errors.append(np.linalg.norm(whole - small, 2))
    assert max(errors) <= 2.0 * left_out.sum() * (1 + 1e-6) + 1e-9 * values[0]
    assert max(errors) > 0.0
