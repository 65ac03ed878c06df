"""Performance indices (4.108): totals, growth over time (figure 4.4), improvement between runs (4.109)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.extensions import rows

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray


class Index(NamedTuple):
    """A performance index: exponents of time and of deviation, unit."""

    r: float
    s: float
    unit: str


INDICES = {
    "ITAE": Index(1, 1, "p.u. s²"),
    "IAE": Index(0, 1, "p.u. s"),
    "ITSE": Index(1, 2, "p.u.² s²"),
    "ISE": Index(0, 2, "p.u.² s"),
}
INDICES |= rows("indices", Index, INDICES)
THESIS_INDICES = ("ITAE", "IAE", "ITSE", "ISE")  # of the thesis; scores and agreement use only these
EDGE = 0.05  # fraction of an index's final value before its cliff, and after it


class Regions(NamedTuple):
    """Bends of an index's curve over time, and the slope between them (figure 4.4)."""

    cliff_from_s: float  # s, end of the error floor
    cliff_to_s: float  # s, start of the small error
    slope: float  # slope of the cliff, unit of the index per s


def performance_indices(
    time_s: NDArray[np.float64], deviations: NDArray[np.float64], since: float = 0.0
) -> dict[str, float]:
    """Indices `int_0^T t^r sum_i |dw_i|^s dt` by the trapezoidal rule on the recorded frames.

    `time_s`: (ticks,), s; `deviations`: (ticks, n), local and interarea speed differences, p.u.; `since`: s, the time
    that counts as t = 0, such as that of the first event; the integral begins with the first frame at or after it.
    Returns each of `INDICES` in its unit. Source: (4.108), with r and s as there.
    """
    t, integrands = _integrands(time_s, deviations, since)
    return {name: float(np.sum(_steps(t, f))) / 2 for name, f in integrands.items()}


def index_curves(
    time_s: NDArray[np.float64], deviations: NDArray[np.float64], since: float = 0.0
) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """Times (s) and the growth of each index; the last values are the totals of `performance_indices`.

    Arguments and units as there. Source: figure 4.4, the integral of (4.108) to t instead of to the end.
    """
    t, integrands = _integrands(time_s, deviations, since)
    begin = np.zeros(min(1, len(t)))
    return t + since, {name: np.append(begin, np.cumsum(_steps(t, f)) / 2) for name, f in integrands.items()}


def regions(time_s: NDArray[np.float64], curve: NDArray[np.float64]) -> Regions | None:
    """Divide a curve of an index into error floor, cliff and small error.

    `time_s`, `curve`: (ticks,), as from `index_curves`. The error floor lasts until the curve reaches 5 % of its final
    value, the cliff from there to 95 %, the small error to the end; interpolation between frames is linear. The thesis
    draws the three regions without figures for their borders. None if the index stays 0. Source: figure 4.4.
    """
    if not len(curve) or curve[-1] <= 0:
        return None
    first, last = (_crossing(time_s, curve, fraction * float(curve[-1])) for fraction in (EDGE, 1 - EDGE))
    return Regions(first, last, float((1 - 2 * EDGE) * curve[-1] / (last - first)))


def improvement(reference: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float | None]:
    """Reduction of each figure of `other` against `reference`, %: `100 (A - B) / A`; None if A is 0.

    Negative: `other` is worse. Source: (4.109), with A the conventional control and B the one that is judged.
    """
    return {name: 100 * (A - other[name]) / A if A else None for name, A in reference.items()}


def _integrands(
    time_s: NDArray[np.float64], deviations: NDArray[np.float64], since: float
) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """Times from `since` on, and the integrands of the indices."""
    inside = time_s >= since
    t = time_s[inside] - since
    magnitude = np.abs(np.reshape(deviations, (len(time_s), -1))[inside])
    return t, {name: t**r * np.sum(magnitude**s, axis=1) for name, (r, s, _) in INDICES.items()}


def _steps(t: NDArray[np.float64], f: NDArray[np.float64]) -> NDArray[np.float64]:
    """Twice the integral of f over each frame by the trapezoidal rule."""
    return np.asarray(np.diff(t) * (f[1:] + f[:-1]))


def _crossing(t: NDArray[np.float64], curve: NDArray[np.float64], level: float) -> float:
    """Time at which a non-decreasing curve that starts below the level reaches it."""
    i = int(np.searchsorted(curve, level))
    return float(t[i - 1] + (level - curve[i - 1]) / (curve[i] - curve[i - 1]) * (t[i] - t[i - 1]))
