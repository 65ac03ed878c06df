"""Complex arithmetic against Python's and NumPy's, which differ from it in the last digits at most."""

from __future__ import annotations

import cmath

import numpy as np
import pytest

from facts_damping.numerics import phasors

DRAWN = np.random.default_rng(1).standard_normal((2, 50, 3)) @ np.array([1.0, 0.3, 1j])
A, B = DRAWN[0], DRAWN[1]


def test_products_quotients_and_parts_are_numpys() -> None:
    np.testing.assert_allclose(phasors.times(A, B), A * B, rtol=1e-15)
    np.testing.assert_allclose(phasors.over(A, B), A / B, rtol=1e-15)
    np.testing.assert_allclose(phasors.magnitudes(A), np.abs(A), rtol=1e-15)
    np.testing.assert_allclose(phasors.angles(A), np.angle(A), rtol=1e-15)
    np.testing.assert_allclose(phasors.polar(np.abs(A), np.angle(A)), A, rtol=1e-14)
    np.testing.assert_allclose(phasors.exponentials(A), np.exp(A), rtol=1e-14)


def test_arrays_are_broadcast_and_numbers_stay_numbers() -> None:
    assert phasors.times(A[:, None], B).shape == (50, 50)
    np.testing.assert_allclose(phasors.over(1.0, B), 1.0 / B, rtol=1e-15)
    assert complex(phasors.times(2.0, 3j)) == 6j
    assert phasors.times(np.zeros((0, 2)), np.zeros(2)).shape == (0, 2)
    np.testing.assert_array_equal(phasors.times(A[::-1], A[::-1]), phasors.times(A, A)[::-1])


def test_of_two_numbers_the_bits_are_those_of_arrays() -> None:
    """Of any size, zeros, infinities and NaN."""
    random = np.random.default_rng(2)
    special = np.array([0.0, -0.0, 5e-324, np.inf, -np.inf, np.nan])
    parts = random.choice([-1.0, 1.0], 6000) * 10.0 ** random.integers(-308, 308, 6000)
    z = np.where(random.random(6000) < 0.1, random.choice(special, 6000), parts).view(complex)
    for function in (phasors.times, phasors.over):
        single = [function(number, other) for number, other in zip(z.tolist(), z[::-1].tolist(), strict=True)]
        single_bits, whole = np.array(single).view(float), function(z, z[::-1]).view(float)
        assert np.all((single_bits.view(int) == whole.view(int)) | (np.isnan(single_bits) & np.isnan(whole)))


@pytest.mark.parametrize("n", [0, 1, 2, 7, 60])
def test_powers(n: int) -> None:
    z = 0.97 * cmath.exp(0.3j)
    assert phasors.power(z, n) == pytest.approx(z**n, rel=1e-14)


@pytest.mark.parametrize("g", [1e-9 + 1e-9j, 0.01 + 0.2j, 0.3 + 1.5j, 2.0 + 0.1j, 0.1 + 4.0j])
def test_factors_of_a_line(g: complex) -> None:
    series, shunt = phasors.line_factors(g * g)
    assert series == pytest.approx(cmath.sinh(g) / g, rel=1e-14)
    assert shunt == pytest.approx(cmath.tanh(g / 2) / (g / 2), rel=1e-14)
