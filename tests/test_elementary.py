"""Elementary functions: errors against mpmath, special values as C has them, the same bits compiled and in Python."""

from __future__ import annotations

import hashlib
import itertools
import math
from functools import cache
from types import FunctionType
from typing import TYPE_CHECKING, Any, NamedTuple

import mpmath
import numpy as np
import pytest
from mpmath import mpf

from facts_damping import elementary
from facts_damping.compiling import bits_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Samples = list[tuple[float, ...]]

COUNT = 300  # samples of each range
INF, NAN, MINIMUM, MAXIMUM = math.inf, math.nan, 5e-324, 1.7976931348623157e308
SPECIAL = [0.0, 1.0, INF, MINIMUM, 2.0**-1022, MAXIMUM, 0.25, 2.0, 2.5, 3.0, 2.0**53 - 1.0, 2.0**53, 1e300]
SPECIAL = [*SPECIAL, *(-x for x in SPECIAL), NAN]
RANDOM = np.random.default_rng(20)


def signed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values with either sign at random."""
    return np.where(RANDOM.integers(0, 2, values.size) == 1, values, -values)


def spread(low: float, high: float) -> NDArray[np.float64]:
    """Positive numbers, as many of each power of two: random bits, so that no function of a processor is needed."""
    return RANDOM.integers(bits_of(low), bits_of(high), COUNT, endpoint=True).view(np.float64)


def even(low: float, high: float) -> NDArray[np.float64]:
    return RANDOM.uniform(low, high, COUNT)


def near(centre: NDArray[np.floating[Any]] | float) -> NDArray[np.float64]:
    """The nearest floats and their neighbours."""
    values = np.ravel(centre)
    return np.concatenate([values, np.nextafter(values, -INF), np.nextafter(values, INF)])


def columns(*arguments: NDArray[np.float64]) -> Samples:
    return list(zip(*(column.tolist() for column in arguments), strict=True))


def together(*ranges: NDArray[np.float64]) -> Samples:
    return columns(np.concatenate(ranges))


QUARTERS = np.pi / 2.0 * np.concatenate([np.arange(1.0, 200.0), RANDOM.integers(200, 2**24, 300)])
BOUNDARIES = np.pi / 128.0 * (2.0 * RANDOM.integers(0, 80000, COUNT) + 1.0)
WORST = np.array([6381956970095103.0 * 2.0**797, 5.31937264832654141671e255, 2.0**1023, MAXIMUM])  # next to n pi/2
ANGLES = together(
    *(even(-10.0, 10.0), even(-4000.0, 4000.0), signed(spread(MINIMUM, MAXIMUM)), signed(spread(2.0**-30, 2.0**30))),
    *(near(QUARTERS), near(BOUNDARIES), near(4000.0), WORST),
)
EXPONENTS = together(
    *(even(-30.0, 5.0), even(-0.02, 0.02), even(-745.2, -700.0), even(600.0, 709.79), even(-20.0, 45.0)),
    *(signed(spread(MINIMUM, 700.0)), near(np.array([709.782712893384, -745.1332191019412, -708.3964185322641]))),
)
BASE = spread(MINIMUM, MAXIMUM)
POWERS = [
    *columns(even(0.0, 10.0), even(-10.0, 10.0)),
    *columns(BASE, even(-745.0, 709.7) / np.array([math.log(x) for x in BASE])),
    *columns(1.0 + signed(spread(2.0**-52, 0.5)), signed(spread(0.1, 2.0**53))),
    *columns(-even(0.0, 3.0), RANDOM.integers(-600, 600, COUNT).astype(float)),
]
POINTS = [
    *columns(even(-10.0, 10.0), even(-10.0, 10.0)),
    *columns(even(-0.03, 0.03), even(-1.0, 1.0)),
    *columns(signed(spread(MINIMUM, MAXIMUM)), signed(spread(MINIMUM, MAXIMUM))),
    *columns(signed(spread(MINIMUM, 2.0**-1000)), signed(spread(MINIMUM, 2.0**-1000))),
    *columns(signed(spread(2.0**1000, 2.0**1023)), signed(spread(2.0**1000, 2.0**1023))),
]
POLAR = [
    *columns(even(-30.0, 5.0), even(-10.0, 10.0)),
    *columns(even(-745.0, 709.0), signed(spread(MINIMUM, MAXIMUM))),
    *columns(np.zeros(COUNT), signed(spread(MINIMUM, 1e3))),
    *columns(even(709.0, 745.0), even(-10.0, 10.0)),
]


def exp_complex(x: float, y: float) -> complex:
    return elementary.exp_complex(complex(x, y))


def phase(x: float, y: float) -> float:
    return elementary.phase(complex(x, y))


def magnitude(x: float, y: float) -> float:
    return elementary.magnitude(complex(x, y))


class Case(NamedTuple):
    """A function, what it is compared with, and where."""

    function: Callable[..., Any]
    exact: Callable[..., Any]
    as_in_c: Callable[..., Any]
    samples: Samples
    bound: float = 0.55  # ulp
    subnormal: float = 0.77  # ulp, where a result is


CASES = {
    "sin": Case(elementary.sin, mpmath.sin, np.sin, ANGLES),
    "cos": Case(elementary.cos, mpmath.cos, np.cos, ANGLES),
    "sin_cos": Case(
        elementary.sin_cos, lambda x: (mpmath.sin(x), mpmath.cos(x)), lambda x: (np.sin(x), np.cos(x)), ANGLES
    ),
    "tan": Case(elementary.tan, mpmath.tan, np.tan, ANGLES),
    "exp": Case(elementary.exp, mpmath.exp, np.exp, EXPONENTS),
    "expm1": Case(elementary.expm1, mpmath.expm1, np.expm1, EXPONENTS),
    "tanh": Case(
        *(elementary.tanh, mpmath.tanh, np.tanh),
        together(even(-3.0, 3.0), even(-0.01, 0.01), even(-25.0, 25.0), signed(spread(MINIMUM, MAXIMUM))),
    ),
    "log": Case(
        *(elementary.log, mpmath.log, np.log),
        together(
            even(1e-6, 10.0), spread(MINIMUM, MAXIMUM), even(0.6, 1.5), near(1.0), 1.0 + signed(spread(2.0**-53, 0.01))
        ),
        bound=0.76,
    ),
    "log1p": Case(
        *(elementary.log1p, mpmath.log1p, np.log1p),
        together(
            even(-0.999, 10.0), even(-0.01, 0.01), spread(MINIMUM, MAXIMUM), -spread(MINIMUM, 0.9999999), near(-1.0)[2:]
        ),
    ),
    "power": Case(elementary.power, lambda x, y: mpf(x) ** mpf(y), np.power, POWERS),
    "atan2": Case(elementary.atan2, mpmath.atan2, np.arctan2, POINTS),
    "hypot": Case(elementary.hypot, mpmath.hypot, np.hypot, POINTS),
    "phase": Case(phase, lambda x, y: mpmath.atan2(y, x), lambda x, y: np.arctan2(y, x), POINTS),
    "magnitude": Case(magnitude, mpmath.hypot, np.hypot, POINTS, bound=1.23),
    "rect": Case(
        *(elementary.rect, lambda r, phi: (r * mpmath.cos(phi), r * mpmath.sin(phi))),
        lambda r, phi: complex(r * np.cos(phi), r * np.sin(phi)),
        [*POLAR, *columns(signed(spread(MINIMUM, MAXIMUM)), signed(spread(MINIMUM, MAXIMUM)))],
    ),
    "exp_complex": Case(
        *(exp_complex, lambda x, y: (mpmath.exp(x) * mpmath.cos(y), mpmath.exp(x) * mpmath.sin(y))),
        *(lambda x, y: np.exp(complex(x, y)), POLAR),
    ),
}


def parts(value: Any) -> Sequence[Any]:
    """The numbers of a result."""
    if isinstance(value, tuple):
        return value
    return (value.real, value.imag) if isinstance(value, (complex, np.complexfloating)) else (value,)


def error(computed: float, exact: Any) -> tuple[float, bool]:
    """Distance in units of the last place, and whether the exact value is a normal number."""
    if abs(exact) >= mpf(2) ** 1024 * (1 - mpf(2) ** -54):
        return (0.0 if computed == math.copysign(INF, exact) else INF), True
    exponent = max(mpmath.frexp(exact)[1], -1021) if exact else -1021
    return float(abs(exact - computed) * mpf(2) ** (53 - exponent)), exponent > -1021


@pytest.mark.parametrize("name", CASES)
def test_errors_stay_below_the_bounds_of_the_docstrings(name: str) -> None:
    case = CASES[name]
    with mpmath.workprec(160):
        for arguments in case.samples:
            exact = case.exact(*map(mpf, arguments))
            for computed, value in zip(parts(case.function(*arguments)), parts(exact), strict=True):
                size, normal = error(computed, value)
                assert size < (case.bound if normal else case.subnormal), arguments


@pytest.mark.parametrize("name", CASES)
def test_special_values_are_those_of_c(name: str) -> None:
    case = CASES[name]
    for arguments in itertools.product(SPECIAL, repeat=len(case.samples[0])):
        with np.errstate(all="ignore"):
            expected = parts(case.as_in_c(*map(np.float64, arguments)))
        for computed, value in zip(parts(case.function(*arguments)), expected, strict=True):
            if math.isnan(value):
                assert math.isnan(computed), arguments
            else:
                assert computed == pytest.approx(float(value), rel=4e-16, abs=MINIMUM), arguments
                assert math.copysign(1.0, computed) == math.copysign(1.0, value), arguments


@cache
def interpreted(function: Any) -> Callable[..., Any]:
    """A compiled function as Python runs it, with all that it calls."""
    space, names = function.py_func.__globals__, function.py_func.__code__.co_names
    known = {name: space[name] for name in names if name in space}
    called = {name: interpreted(value) for name, value in known.items() if hasattr(value, "py_func")}
    return FunctionType(function.py_func.__code__, {**known, **called})


def bits(value: Any) -> list[int]:
    """Bits of the numbers of a result; of NaN those of one."""
    return [bits_of(NAN if math.isnan(part) else part) for part in parts(value)]


@pytest.mark.parametrize("name", elementary.__all__)
def test_python_gives_the_bits_of_compiled_code(name: str) -> None:
    compiled: Any = getattr(elementary, name)
    samples = CASES[name].samples
    special = list(itertools.product(SPECIAL, repeat=len(samples[0])))
    for arguments in [*samples[::5], *special]:
        inputs = (complex(*arguments),) if name in {"exp_complex", "phase", "magnitude"} else arguments
        expected = bits(compiled(*inputs))
        with np.errstate(all="ignore"):
            assert bits(interpreted(compiled)(*inputs)) == expected, arguments
            assert bits(compiled.py_func(*inputs)) == expected, arguments


def test_bits_are_those_of_every_other_processor() -> None:
    digest = hashlib.sha256()
    random = np.random.default_rng(1)
    numbers = random.integers(-(2**63), 2**63, (2, 2000)).view(np.float64)
    usual = random.uniform(-30.0, 30.0, (2, 2000))
    for name, case in CASES.items():
        for arguments in np.concatenate([numbers, usual], 1).T[:, : len(case.samples[0])].tolist():
            if not any(map(math.isnan, arguments)):
                digest.update(f"{name} {bits(case.function(*arguments))}".encode())
    assert digest.hexdigest()[:16] == "0189d80386cfb80f"
