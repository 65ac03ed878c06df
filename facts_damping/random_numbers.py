"""Random numbers of a run: the distributions of NumPy's `Generator` with the same bits on all processors.

Bit generators give integers that are the same everywhere and in every version of NumPy. NumPy converts them to a
distribution with the C library's logarithms and exponentials, whose rounding depends on the processor, and may change
its method in later versions. The functions here take the same steps with their own elementary functions, so they give
NumPy's numbers up to the last digits and leave the stream at the same position:

- normal and exponential numbers by the ziggurat (`ziggurat`);
- gamma numbers by G. Marsaglia, W. W. Tsang, A Simple Method for Generating Gamma Variables, ACM Trans. Mathematical
  Software 26(3), 2000; below a shape of 1 by J. H. Ahrens, U. Dieter, Computer Methods for Sampling from Gamma, Beta,
  Poisson and Binomial Distributions, Computing 12, 1974;
- whole numbers below a bound by D. Lemire, Fast Random Integer Generation in an Interval, ACM Trans. Modeling and
  Computer Simulation 29(1), 2019.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Array, Float1, Int1
from facts_damping.elementary import exp, log, log1p, power
from facts_damping.numerics.ziggurat import EXPONENTIAL_R, NORMAL_R, Ziggurat, exponential_layers, normal_layers

if TYPE_CHECKING:
    Size = int | tuple[int, ...]

Raw = Annotated[NDArray[np.uint64], Array(np.uint64, 1)]
UNIT = 2.0**-53  # a double is made of 53 bits
HALF = 2**32


@compiled
def _next(raw: Raw, at: Int1) -> np.uint64:
    """The next number of the stream; zero beyond the numbers at hand, which ends any draw."""
    at[0] += 1
    return raw[at[0] - 1] if at[0] <= raw.size else np.uint64(0)  # type: ignore[no-any-return]


@compiled
def _double(raw: Raw, at: Int1) -> float:
    return (_next(raw, at) >> np.uint64(11)) * UNIT  # type: ignore[no-any-return]


@compiled
def _standard_normal(n: Ziggurat, raw: Raw, at: Int1) -> float:
    """A normal number of mean 0 and standard deviation 1."""
    while True:
        word = _next(raw, at)
        layer = np.int64(word & np.uint64(0xFF))
        negative = (word >> np.uint64(8)) & np.uint64(1) != np.uint64(0)
        bits = (word >> np.uint64(9)) & np.uint64(2**52 - 1)
        x = bits * n.width[layer]
        if negative:
            x = -x
        if bits < n.inside[layer]:
            return x  # type: ignore[no-any-return]
        if layer == 0:
            while at[0] <= raw.size:
                beyond = -log1p(-_double(raw, at)) / NORMAL_R
                height = -log1p(-_double(raw, at))
                if height + height > beyond * beyond:
                    low = (bits >> np.uint64(8)) & np.uint64(1) != np.uint64(0)
                    return -(NORMAL_R + beyond) if low else NORMAL_R + beyond  # type: ignore[no-any-return]
            return x  # type: ignore[no-any-return] # the stream at hand has ended: it is drawn anew
        height = (n.density[layer - 1] - n.density[layer]) * _double(raw, at) + n.density[layer]
        if height < exp(-0.5 * x * x):
            return x  # type: ignore[no-any-return]


@compiled
def _standard_exponential(e: Ziggurat, raw: Raw, at: Int1) -> float:
    """An exponential number of mean 1."""
    while True:
        word = _next(raw, at) >> np.uint64(3)
        layer, bits = np.int64(word & np.uint64(0xFF)), word >> np.uint64(8)
        x = bits * e.width[layer]
        if bits < e.inside[layer]:
            return x  # type: ignore[no-any-return]
        if layer == 0:
            return EXPONENTIAL_R - log1p(-_double(raw, at))  # type: ignore[no-any-return]
        if (e.density[layer - 1] - e.density[layer]) * _double(raw, at) + e.density[layer] < exp(-x):
            return x  # type: ignore[no-any-return]


@compiled
def _standard_gamma(shape: float, n: Ziggurat, e: Ziggurat, raw: Raw, at: Int1) -> float:
    """A number of the gamma distribution of scale 1."""
    if shape == 0.0:
        return 0.0
    if shape == 1.0:
        return _standard_exponential(e, raw, at)
    if shape < 1.0:
        while True:
            u, v = _double(raw, at), _standard_exponential(e, raw, at)
            if u <= 1.0 - shape:
                x = power(u, 1.0 / shape)
                if x <= v:
                    return x  # type: ignore[no-any-return]
            else:
                y = -log((1.0 - u) / shape)
                x = power(1.0 - shape + shape * y, 1.0 / shape)
                if x <= v + y:
                    return x  # type: ignore[no-any-return]
    b = shape - 1.0 / 3.0
    c = 1.0 / math.sqrt(9.0 * b)
    while True:
        x = _standard_normal(n, raw, at)
        v = 1.0 + c * x
        if v <= 0.0:
            continue
        v = v * v * v
        u = _double(raw, at)
        if u < 1.0 - 0.0331 * (x * x) * (x * x):
            return b * v
        if u > 0.0 and log(u) < 0.5 * x * x + b * (1.0 - v + log(v)):
            return b * v


NORMAL, LOGNORMAL, EXPONENTIAL, GAMMA = range(4)


@compiled
def _one(kind: int, a: float, b: float, n: Ziggurat, e: Ziggurat, raw: Raw, at: Int1) -> float:
    if kind == EXPONENTIAL:
        return b * _standard_exponential(e, raw, at)
    if kind == GAMMA:
        return b * _standard_gamma(a, n, e, raw, at)
    number = a + b * _standard_normal(n, raw, at)
    return exp(number) if kind == LOGNORMAL else number


@entry_point
def _fill(kind: int, a: float, b: float, n: Ziggurat, e: Ziggurat, raw: Raw, at: Int1, out: Float1) -> int:
    """Draw until `out` is full or the stream at hand runs out; returns the number drawn, `at` points behind them."""
    for i in range(out.size):
        begun = at[0]
        out[i] = _one(kind, a, b, n, e, raw, at)
        if at[0] > raw.size:
            at[0] = begun
            return i
    return out.size


@entry_point
def _bounded(bound: int, raw: Raw, at: Int1, out: Int1) -> int:
    """Integers below a bound from 32 bits each: each number's lower half first; `at` counts halves."""
    minimum = np.uint64((HALF - bound) % bound)  # smaller values would make some numbers more frequent
    for i in range(out.size):
        while True:
            if at[0] >= 2 * raw.size:
                return i
            half = raw[at[0] // 2] >> np.uint64(32 * (at[0] % 2)) & np.uint64(HALF - 1)
            at[0] += 1
            product = half * np.uint64(bound)
            if product & np.uint64(HALF - 1) >= minimum:
                break
        out[i] = np.int64(product >> np.uint64(32))
    return out.size


def random(generator: np.random.Generator, size: Size) -> NDArray[np.float64]:
    """Uniform numbers in [0, 1)."""
    raw = np.asarray(generator.bit_generator.random_raw(math.prod(np.atleast_1d(size).tolist())), np.uint64)
    return np.reshape((raw >> np.uint64(11)) * UNIT, size)


def uniform(generator: np.random.Generator, low: float, high: float, size: Size) -> NDArray[np.float64]:
    """Uniform numbers in [low, high)."""
    return low + (high - low) * random(generator, size)


def _drawn(generator: np.random.Generator, kind: int, a: float, b: float, size: Size) -> NDArray[np.float64]:
    """Draws of a kind; the generator then points behind the numbers used."""
    numbers, source = np.zeros(size), generator.bit_generator
    flat, before, raw, at = numbers.reshape(-1), source.state, np.zeros(0, np.uint64), np.zeros(1, np.int64)
    done = used = 0
    while done < flat.size:
        more = flat.size - done + (flat.size - done) // 16 + 64
        raw, at[0] = np.concatenate([raw[at[0] :], source.random_raw(more)]), 0
        done += _fill(kind, float(a), float(b), normal_layers(), exponential_layers(), raw, at, flat[done:])
        used += int(at[0])
    source.state = before
    source.random_raw(used, output=False)
    return numbers


def normal(generator: np.random.Generator, mean: float, std: float, size: Size) -> NDArray[np.float64]:
    """Normally distributed numbers."""
    return _drawn(generator, NORMAL, mean, std, size)


def standard_normal(generator: np.random.Generator, size: Size) -> NDArray[np.float64]:
    """Normally distributed numbers of mean 0 and standard deviation 1."""
    return _drawn(generator, NORMAL, 0.0, 1.0, size)


def lognormal(generator: np.random.Generator, mean: float, sigma: float, size: Size) -> NDArray[np.float64]:
    """Numbers whose logarithm is normal with mean `mean` and standard deviation `sigma`."""
    return _drawn(generator, LOGNORMAL, mean, sigma, size)


def exponential(generator: np.random.Generator, mean: float, size: Size) -> NDArray[np.float64]:
    """Numbers of the exponential distribution."""
    return _drawn(generator, EXPONENTIAL, 0.0, mean, size)


def gamma(generator: np.random.Generator, shape: float, scale: float, size: Size) -> NDArray[np.float64]:
    """Numbers of the gamma distribution."""
    return _drawn(generator, GAMMA, shape, scale, size)


def integers(generator: np.random.Generator, bound: int, size: Size) -> NDArray[np.int64]:
    """Integers from 0 to below a bound, which is less than 2^32; the stream must have no half number left."""
    numbers, source = np.zeros(size, np.int64), generator.bit_generator
    flat, before, at, done = numbers.reshape(-1), source.state, np.zeros(1, np.int64), 0
    raw = np.zeros(0, np.uint64)
    while done < flat.size:
        raw = np.concatenate([raw, source.random_raw((flat.size - done) // 2 + 64)])
        done += _bounded(bound, raw, at, flat[done:])
    source.state = before
    used = int(at[0])
    source.random_raw((used + 1) // 2, output=False)
    if used % 2:  # the upper half of the last number is for the next draw of halves
        state: Any = source.state
        state["has_uint32"], state["uinteger"] = 1, int(raw[used // 2]) >> 32
        source.state = state
    return numbers
