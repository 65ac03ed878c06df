"""Reward of an agent: damping minus a cost of control effort."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from facts_damping.analysis.indices import INDICES
from facts_damping.errors import check_known

if TYPE_CHECKING:
    from numpy.typing import NDArray

UNIT = 0.01  # p.u.: unit of a speed difference


class Reward(Protocol):
    """Reward of a tick from its length dt (s), its end t_s (s), the true speed differences then (p.u.), its action.

    Actions are from -1 to 1.

    In the vector environment all arguments and the result have a leading axis.
    """

    def __call__(
        self, dt: float, t_s: NDArray[np.float64], deviations: NDArray[np.float64], action: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """The reward."""


class IndexReward(NamedTuple):
    """Minus the integrand of a performance index (4.108), minus a cost of effort, over the tick.

        -dt (t^r sum_i |dw_i / 0.01|^s + effort sum_d a_d^2)

    The sum over a whole episode is minus the index, in units of 0.01 p.u., by the rectangle rule.
    """

    of: str = "ISE"
    effort: float = 0.01

    def __call__(
        self, dt: float, t_s: NDArray[np.float64], deviations: NDArray[np.float64], action: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """The reward, (...)."""
        check_known("reward.of", self.of, INDICES)
        r, s, _ = INDICES[self.of]
        deviated, effort = (np.abs(deviations / UNIT) ** s).sum(-1), (action**2).sum(-1)
        return np.asarray(-dt * (np.asarray(t_s) ** r * deviated + self.effort * effort))
