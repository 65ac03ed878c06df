"""Matrices of a user's linear controller, from matrices or transfer functions, and their checks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.errors import InputError
from facts_damping.numerics.phasors import times

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float2
    from facts_damping.parameters.linear_law import LinearLaw

MAX_STATES = 200
EDGE = 1e-9  # 1/s or of its magnitude: a pole this close to the stability limit counts as on it (integrator)


class Matrices(NamedTuple):
    """dx = A x + B u, y = C x + D u; of a controller the inputs are signals, the outputs setpoints, p.u."""

    A: Float2  # (states, states)
    B: Float2  # (states, inputs)
    C: Float2  # (outputs, states)
    D: Float2  # (outputs, inputs)


def matrices(law: LinearLaw, signals: int, devices: int) -> Matrices:
    """The matrices of a law. Raises `InputError` if their size is wrong or they are unstable."""
    abcd = _of_matrices(law, signals, devices) if law.num is None and law.zeros is None else _of_fractions(law)
    if abcd.D.shape != (devices, signals):
        raise InputError(
            f"{abcd.D.shape[0]} outputs and {abcd.D.shape[1]} inputs given; allowed: {devices} and {signals}, one a "
            "device and one a signal"
        )
    if len(abcd.A) > MAX_STATES:
        raise InputError(f"{len(abcd.A)} states given; allowed: at most {MAX_STATES}")
    if not all(np.isfinite(part).all() for part in abcd):
        raise InputError("numbers too large given, results are not finite; allowed: smaller ones")
    poles = np.linalg.eigvals(abcd.A) if len(abcd.A) else np.zeros(0)
    beyond = poles.real if law.dt is None else np.abs(poles) - 1.0
    if len(poles) and beyond.max() > EDGE * max(1.0, float(np.abs(poles).max())):
        worst, unit = poles[int(np.argmax(beyond))], "" if law.dt else " 1/s"
        raise InputError(f"a pole at {worst:.4g}{unit} given: unstable; allowed: stable controllers, and integrators")
    return abcd


def _of_matrices(law: LinearLaw, signals: int, devices: int) -> Matrices:
    parts = {name: _matrix(name, getattr(law, name)) for name in ("A", "B", "C", "D")}
    n = 0 if parts["A"] is None else len(parts["A"])
    shapes = {"A": (n, n), "B": (n, signals), "C": (devices, n), "D": (devices, signals)}
    for name, shape in shapes.items():
        part = parts[name]
        if part is not None and part.shape != shape:
            raise InputError(
                f"{name}: {part.shape[0]} x {part.shape[1]} given; allowed: {shape[0]} x {shape[1]}, with {n} states, "
                f"{signals} signals and {devices} devices"
            )
    return Matrices(*(np.zeros(shapes[name]) if matrix is None else matrix for name, matrix in parts.items()))


def _matrix(name: str, rows: list[list[float]] | None) -> Float2 | None:
    if rows is None:
        return None
    if len({len(row) for row in rows}) > 1:
        raise InputError(
            f"{name}: rows of {', '.join(str(len(row)) for row in rows)} numbers given; allowed: rows of one length"
        )
    return np.array(rows, np.float64).reshape(len(rows), len(rows[0]) if rows else 0)


def _of_fractions(law: LinearLaw) -> Matrices:
    """Realise one transfer function or a matrix of them, each with its own states."""
    if law.zeros is not None:
        above, below = (_polynomial(name, getattr(law, name)) for name in ("zeros", "poles"))
        num, den = [[[(law.gain or 0.0) * coefficient for coefficient in above]]], [[below]]
    else:
        num, den = _table(law.num or []), _table(law.den or [])
    shape = [len(row) for row in num]
    if not shape or len(set(shape)) > 1 or shape != [len(row) for row in den]:
        raise InputError(
            "num and den: tables of another shape given; allowed: one polynomial for each device and signal"
        )
    whole = [[_realised(n, d) for n, d in zip(*rows, strict=True)] for rows in zip(num, den, strict=True)]
    parts = [element for row in whole for element in row]
    sizes = [len(part.A) for part in parts]
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    n, signals, devices = int(starts[-1]), shape[0], len(shape)
    full = Matrices(np.zeros((n, n)), np.zeros((n, signals)), np.zeros((devices, n)), np.zeros((devices, signals)))
    for i, part in enumerate(parts):
        d, s = divmod(i, signals)
        at = slice(starts[i], starts[i + 1])
        full.A[at, at], full.B[at, s], full.C[d, at], full.D[d, s] = part.A, part.B[:, 0], part.C[0], part.D[0, 0]
    return full


def _table(polynomials: Any) -> list[list[list[float]]]:
    """Polynomials as one row per device; a single polynomial is for one signal and device."""
    return [[polynomials]] if not polynomials or not isinstance(polynomials[0], list) else polynomials


def _polynomial(name: str, roots: list[float | str]) -> list[float]:
    """Coefficients of the product of (s - root), the highest power first."""
    try:
        complex_roots = np.array([complex(number) for number in roots], complex)
    except ValueError as error:
        raise InputError(f"{name}: {roots} given; allowed: numbers, complex ones as text such as '-1+2j'") from error
    if not np.allclose(np.sort_complex(complex_roots), np.sort_complex(complex_roots.conj())):
        raise InputError(f"{name}: {roots} given; allowed: complex ones in conjugate pairs")
    product = np.ones(1, complex)
    for root in complex_roots:
        product = np.append(product, 0.0) - np.append(0.0, times(root, product))
    return [float(coefficient) for coefficient in product.real]


def _realised(num: list[float], den: list[float]) -> Matrices:
    """Realise a transfer function in controller canonical form (without SciPy, which is slow to import)."""
    above, below = np.trim_zeros(np.array(num, float), "f"), np.trim_zeros(np.array(den, float), "f")
    if not below.size:
        raise InputError("den: 0 given; allowed: a polynomial other than 0")
    if above.size > below.size:
        raise InputError(
            f"num of degree {above.size - 1} over den of degree {below.size - 1} given: improper; allowed: a numerator "
            "of no higher degree"
        )
    n = below.size - 1 if above.size else 0
    high = np.concatenate([np.zeros(below.size - above.size), above])[: n + 1] / below[0]
    low = below[1 : n + 1] / below[0]
    A = np.vstack([-low, np.eye(n)[:-1]]) if n else np.zeros((0, 0))
    return Matrices(A, np.eye(n, 1), (high[1:] - high[0] * low)[None, :], high[None, :1])
