"""Small-signal analysis: linearisation of the same compiled functions, modes, participation factors."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import eig

from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.model import workspace

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.plant.build import Built

STEP = 1e-6  # of the central differences, p.u., rad
NEGLIGIBLE = 0.02  # share of a state in a mode below which it is not listed


class Mode(NamedTuple):
    """A mode: eigenvalue (1/s), frequency (Hz), damping ratio, share of each state that takes part."""

    eigenvalue: complex
    frequency_hz: float
    damping_ratio: float
    participation: dict[str, float]


def linearise(built: Built) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """State matrix A (states, states) and input matrix B (states, devices) at the start, 1/s.

    dx = A dx + B du with u the devices' references, p.u.; central differences of `derivatives`.
    """
    plant, state = built.plant, built.state
    work = workspace(plant, state)

    def slope(x: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
        dx = np.zeros_like(x)
        derivatives(plant, x, reference, state.source.copy(), 0, dx, work)
        return dx

    def column(
        moved: NDArray[np.float64], other: NDArray[np.float64], i: int, *, by_state: bool
    ) -> NDArray[np.float64]:
        step = STEP * max(1.0, abs(moved[i]))
        up, down = moved.copy(), moved.copy()
        up[i] += step
        down[i] -= step
        high, low = (slope(v, other) if by_state else slope(other, v) for v in (up, down))
        return np.asarray((high - low) / (up[i] - down[i]))

    A = [column(state.x, state.reference, i, by_state=True) for i in range(len(state.x))]
    B = [column(state.reference, state.x, i, by_state=False) for i in range(len(state.reference))]
    return np.array(A).T, np.array(B).reshape(len(B), len(state.x)).T


def modes(matrix: NDArray[np.float64], names: list[str]) -> list[Mode]:
    """Modes of a state matrix, a conjugate pair once, ordered by falling real part.

    Frequency |Im| / (2 pi), damping ratio -Re / |lambda|; participation |w_k v_k| of state k, left times
    right eigenvector, scaled to sum one (Kundur 1994, 12.2).
    """
    values, left, right = eig(matrix, left=True, right=True)
    found = []
    for i in np.argsort(-values.real):
        if values[i].imag < 0:
            continue
        share = np.abs(left[:, i].conj() * right[:, i])
        share /= share.sum()
        listed = {names[k]: float(share[k]) for k in np.argsort(-share) if share[k] >= NEGLIGIBLE}
        size = abs(values[i])
        ratio = float(-values[i].real / size) if size > 0 else 0.0
        found.append(Mode(complex(values[i]), float(values[i].imag / (2 * np.pi)), ratio, listed))
    return found
