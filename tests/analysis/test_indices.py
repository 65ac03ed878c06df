"""Performance indices against closed forms and numerical integration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate

from facts_damping.analysis.indices import INDICES, performance_indices


@pytest.mark.parametrize(("name", "exponents"), INDICES.items())
def test_damped_sines(name: str, exponents: tuple[int, int]) -> None:
    r, s = exponents
    t = np.linspace(0, 20, 200_001)

    def waves(t: float) -> tuple[float, float]:
        return np.exp(-0.2 * t) * np.sin(3 * t), 0.5 * np.exp(-0.4 * t) * np.sin(7 * t)

    found = performance_indices(t, np.column_stack([np.broadcast_to(w, t.shape) for w in waves(t)]))[name]  # type: ignore[arg-type]
    kinks = sorted([*np.arange(0, 20, np.pi / 3), *np.arange(0, 20, np.pi / 7)])
    parts = [
        integrate.quad(lambda t: t**r * sum(abs(w) ** s for w in waves(t)), low, high)[0]
        for low, high in zip(kinks, [*kinks[1:], 20], strict=True)
    ]
    assert found == pytest.approx(sum(parts), rel=1e-6)


def test_constant() -> None:
    t = np.linspace(0, 2, 2001)
    assert performance_indices(t, np.full(2001, -3.0)) == pytest.approx(
        {"ITAE": 6.0, "IAE": 6.0, "ITSE": 18.0, "ISE": 18.0}
    )


@given(amplitude=st.floats(1e-6, 1e3), shift=st.integers(0, 300), seed=st.integers(0, 2**32 - 1), n=st.integers(1, 4))
def test_scaling_addition_and_shift(amplitude: float, shift: int, seed: int, n: int) -> None:
    t = np.arange(600) / 60
    x = np.random.default_rng(seed).standard_normal((600, n))
    whole = performance_indices(t, x)
    scaled = performance_indices(t, amplitude * x)
    for name, (_, s) in INDICES.items():
        assert scaled[name] == pytest.approx(amplitude**s * whole[name])
        columns = [performance_indices(t, x[:, i])[name] for i in range(n)]
        assert sum(columns) == pytest.approx(whole[name])
    late = performance_indices(t, x, since=float(t[shift]))
    assert late == pytest.approx(performance_indices(t[: 600 - shift], x[shift:]))
