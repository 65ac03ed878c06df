"""A chain of stages, each with its own delay model; compiled.

A chain is a table of stages. A stage's model is a code that `traverse` branches on; it answers with
the time at which an entry leaves, so delays are exact and never rounded to frames.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.signals import to_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.run import Stage

MODELS = {"constant": 0}  # chains are filled up with stages of zeros, which must not delay

STAGE = np.dtype([("model", "i8"), ("delay_ns", "i8")])


def chain(stages: Sequence[Stage], most: int = 0) -> NDArray[Any]:
    """Table of STAGE from a link's stages, filled up to `most` with stages that do not delay."""
    table = np.zeros(max(len(stages), most), STAGE)
    for i, stage in enumerate(stages):
        table[i] = (MODELS[stage.model], to_ns(stage.delay))
    return table


def longest_delay_ns(table: NDArray[Any]) -> int:
    """Longest delay that a chain can give, ns."""
    return int(table["delay_ns"].sum())


@compiled
def traverse(table: NDArray[Any], sent_ns: int) -> int:
    """Time at which an entry that enters the chain at `sent_ns` leaves it, ns."""
    now = sent_ns
    for i in range(table.size):
        now += table[i].delay_ns
    return now
