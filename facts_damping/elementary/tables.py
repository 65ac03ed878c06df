"""Constants and tables of the elementary functions, from integers of any length: the same on every computer.

A value v stands here as the integer v 2^PLACES, off by some units at most; a quotient of two integers is the nearest
float. Series are those of Taylor, of which the last term is below a unit:

- atan(1/n) = 1/n - 1/(3 n^3) + ..., and pi = 16 atan(1/5) - 4 atan(1/239) (Machin 1706);
- ln((a + b) / (a - b)) = 2 atanh(b/a) = 2 (b/a + (b/a)^3 / 3 + ...).

Tables are rows of floats one after the other, as one array: compiled functions hold it as a constant.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1


PLACES = 1400  # bits after the point: of 2/pi the largest number needs 1024 - 53, and as many as it is to be exact to
FINE = 200  # the same for entries of tables
CELLS = 128  # of a turn, of an octave
LIMB = 30  # bits


def _arctangent(a: int, b: int, places: int, sign: int = -1) -> int:
    """Atan(a/b), or atanh(a/b) with `sign` 1."""
    power = (a << places) // b
    total, n = 0, 1
    while power:
        total += power // n
        power, n = sign * power * a * a // (b * b), n + 2
        if abs(power) <= 1:
            break
    return total


def _logarithm(a: int, b: int, places: int) -> int:
    return 2 * _arctangent(a - b, a + b, places, 1)


def _rounded(value: int, bits: int) -> int:
    """A value to its first bits."""
    drop = max(abs(value).bit_length() - bits, 0)
    return (value + (1 << drop >> 1)) >> drop << drop


def _parts(value: int, places: int, *bits: int) -> list[float]:
    """A value as a sum of floats: the first ones of so many bits, the last one of what is left."""
    parts = []
    for n in bits:
        part = _rounded(value, n)
        parts.append(part / (1 << places))
        value -= part
    return [*parts, value / (1 << places)]


def _on_grid(value: int, places: int, grid: int) -> list[float]:
    """A value as a multiple of 2^-grid and what is left."""
    part = (value + (1 << (places - grid - 1))) >> (places - grid) << (places - grid)
    return [part / (1 << places), (value - part) / (1 << places)]


def _table(rows: list[list[float]]) -> Float1:
    table = np.array(rows).ravel()
    table.setflags(write=False)
    return table


_PI = 16 * _arctangent(1, 5, PLACES) - 4 * _arctangent(1, 239, PLACES)
_FINE_PI = _PI >> (PLACES - FINE)
_LN2 = _logarithm(2, 1, FINE)
_ONE = 1 << FINE

PI_HIGH, PI_LOW = _parts(_FINE_PI, FINE, 53)


# Sine and cosine: cells of 1/128 turn, pi/64.
def _sines() -> Float1:
    """Rows of j: sin(2 pi j / 128) as the nearest float and the rest, the cosine as 26 bits and the rest."""
    quarter = CELLS // 4
    step = _FINE_PI * 2 // CELLS
    sine, cosine, term, n = 0, 0, _ONE, 0
    while term:  # of the first cell
        if n % 2:
            sine += term if n % 4 == 1 else -term
        else:
            cosine += term if n % 4 == 0 else -term
        n += 1
        term = term * step // (n << FINE)
    sines, s, c = [], 0, _ONE
    for _ in range(quarter):
        sines.append(s)
        s, c = (s * cosine + c * sine) >> FINE, (c * cosine - s * sine) >> FINE
    turn = [*sines, _ONE, *sines[:0:-1]]
    turn += [-value for value in turn]
    return _table([[*_parts(turn[j], FINE, 53), *_parts(turn[(j + quarter) % CELLS], FINE, 26)] for j in range(CELLS)])


SINES = _sines()
CELL_BITS = 36  # of the parts of pi/64 of which multiples by up to 2^17 are exact
CELL_1, CELL_2, CELL_3 = _parts(_FINE_PI >> 6, FINE, CELL_BITS, CELL_BITS)
CELL_HIGH, CELL_LOW = _parts(_FINE_PI >> 6, FINE, 53)
CELLS_PER_RADIAN = (64 << FINE) / _FINE_PI
# Two zeros and 2/pi, in limbs of 30 bits: the zeros are for numbers below 2^54, of which all limbs count.
_TWO_OVER_PI = (2 << 2 * PLACES) // _PI
TWO_OVER_PI = np.array([_TWO_OVER_PI >> (PLACES - LIMB * (i - 1)) & ((1 << LIMB) - 1) for i in range(44)])
TWO_OVER_PI.setflags(write=False)


# Exponential: cells of 1/128 octave.
def _powers() -> Float1:
    """Rows of j: 2^(j/128) as the nearest float, the rest over it, 26 bits, the rest of these."""
    step, term, n = 0, _ONE, 0
    while term:
        step += term
        n += 1
        term = term * _LN2 // (CELLS * n << FINE)
    rows, value = [], _ONE
    for _ in range(CELLS):
        high, low = _parts(value, FINE, 53)
        rows.append([high, low / high, *_parts(value, FINE, 26)])
        value = value * step >> FINE
    return _table(rows)


POWERS = _powers()
OCTAVE_HIGH, OCTAVE_LOW = _on_grid(_LN2 // CELLS, FINE, 42)  # multiples of the first by 2^18 are exact
CELLS_PER_UNIT = (CELLS << FINE) / _LN2

# Logarithm: z from 0.69 to 1.38 in cells of 1/128 of its octave, of which one lies around 1.
LOWEST = 0x3FE6100000000000  # bits of the least z


def _logarithms() -> Float1:
    """Rows of cells: about 1/z, of 12 bits, and its -ln as a multiple of 2^-42 and the rest."""
    rows = []
    for i in range(CELLS):
        middle = float(np.int64(LOWEST + (2 * i + 1 << 44)).view(np.float64))
        inverse = round(2048 / middle)
        rows.append([inverse / 2048, *_on_grid(_logarithm(2048, inverse, FINE), FINE, 42)])
    return _table(rows)


LOGARITHMS = _logarithms()
LN2_HIGH, LN2_LOW = _on_grid(_LN2, FINE, 42)


# Arctangent: cells of 1/64.
def _angles() -> Float1:
    """Rows of j: atan(j/64) as the nearest float and the rest."""
    rows, value = [], 0
    for j in range(65):
        rows.append(_parts(value, FINE, 53))
        value += _arctangent(64, 4096 + j * (j + 1), FINE)
    return _table(rows)


ANGLES = _angles()
