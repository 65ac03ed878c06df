"""Performance indices against closed forms and numerical integration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate

from facts_damping.analysis.indices import INDICES, Index, improvement, index_curves, performance_indices, regions


@pytest.mark.parametrize(("name", "index"), INDICES.items())
def test_damped_sines(name: str, index: Index) -> None:
    r, s, _ = index
    t = np.linspace(0, 20, 200_001)

    def waves(t: float) -> tuple[float, float]:
        return np.exp(-0.2 * t) * np.sin(3 * t), 0.5 * np.exp(-0.4 * t) * np.sin(7 * t)

    index_value = performance_indices(t, np.column_stack([np.broadcast_to(w, t.shape) for w in waves(t)]))[name]  # type: ignore[arg-type]
    kinks = sorted([*np.arange(0, 20, np.pi / 3), *np.arange(0, 20, np.pi / 7)])
    parts = [
        integrate.quad(lambda t: t**r * sum(abs(w) ** s for w in waves(t)), low, high)[0]
        for low, high in zip(kinks, [*kinks[1:], 20], strict=True)
    ]
    assert index_value == pytest.approx(sum(parts), rel=1e-6)


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
    for name, (_, s, _) in INDICES.items():
        assert scaled[name] == pytest.approx(amplitude**s * whole[name])
        columns = [performance_indices(t, x[:, i])[name] for i in range(n)]
        assert sum(columns) == pytest.approx(whole[name])
    late = performance_indices(t, x, since=float(t[shift]))
    assert late == pytest.approx(performance_indices(t[: 600 - shift], x[shift:]))


@given(amplitude=st.floats(1e-6, 1e3), since=st.floats(0, 5), seed=st.integers(0, 2**32 - 1))
def test_curves_grow_to_the_totals(amplitude: float, since: float, seed: int) -> None:
    t = np.arange(600) / 60
    x = amplitude * np.random.default_rng(seed).standard_normal((600, 2))
    times, curves = index_curves(t, x, since)
    assert times == pytest.approx(t[t >= since])
    totals = performance_indices(t, x, since)
    for name, curve in curves.items():
        assert curve[0] == 0.0
        assert (np.diff(curve) >= 0).all()
        assert curve[-1] == pytest.approx(totals[name])


def test_curve_at_any_instant_is_the_index_up_to_it() -> None:
    t = np.linspace(0, 20, 20_001)
    _, curves = index_curves(t, np.exp(-0.3 * t))
    for name, (r, s, _) in INDICES.items():
        exact, _ = integrate.quad(lambda t, r=r, s=s: t**r * np.exp(-0.3 * s * t), 0, 7)
        assert curves[name][7000] == pytest.approx(exact, rel=1e-6)


def test_regions_of_an_error_that_comes_at_one_instant_and_decays() -> None:
    """|dw| = exp(-(t - 2)) from 2 s on: IAE grows as 1 - exp(-(t - 2)), ISE as (1 - exp(-2 (t - 2)))/2."""
    t = np.linspace(0, 60, 60_001)
    times, curves = index_curves(t, np.where(t < 2, 0.0, np.exp(-(t - 2))))
    for name, rate in (("IAE", 1.0), ("ISE", 2.0)):
        bounds = regions(times, curves[name])
        assert bounds is not None
        assert bounds.cliff_from_s == pytest.approx(2 - np.log(0.95) / rate, abs=1e-3)
        assert bounds.cliff_to_s == pytest.approx(2 - np.log(0.05) / rate, abs=1e-3)
        assert bounds.slope == pytest.approx(0.9 / rate / (bounds.cliff_to_s - bounds.cliff_from_s), rel=2e-3)
    # As the thesis observes below figure 4.4: the squares' cliff is the shorter.
    lengths = {
        name: region_bounds.cliff_to_s - region_bounds.cliff_from_s
        for name, c in curves.items()
        if (region_bounds := regions(times, c))
    }
    assert lengths["ITSE"] < lengths["ITAE"]
    assert lengths["ISE"] < lengths["IAE"]


def test_index_that_stays_zero_has_no_regions() -> None:
    assert regions(np.arange(5.0), np.zeros(5)) is None
    assert regions(np.zeros(0), np.zeros(0)) is None


def test_improvement() -> None:
    """(4.109): a quarter of the reference is 75 % better; half as much again is worse, so negative."""
    assert improvement({"ITAE": 4.0, "ISE": 2.0}, {"ITAE": 1.0, "ISE": 3.0}) == {"ITAE": 75.0, "ISE": -50.0}
    assert improvement({"ITAE": 0.0}, {"ITAE": 1.0}) == {"ITAE": None}


@given(a=st.floats(0.1, 10), b=st.floats(0, 10), c=st.floats(0.1, 10))
def test_improvements_chain(a: float, b: float, c: float) -> None:
    """What is left over is the product: 1 - p_ab = (1 - p_ac)(1 - p_cb), by which errata of the tables are found."""
    whole, first, second = (improvement({"": x}, {"": y})[""] for x, y in ((a, b), (a, c), (c, b)))
    assert whole is not None
    assert first is not None
    assert second is not None
    assert 1 - whole / 100 == pytest.approx((1 - first / 100) * (1 - second / 100), rel=1e-6, abs=1e-9)
