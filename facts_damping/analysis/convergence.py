"""What a finer integration step changes in the figures of a run, and how many of their digits hold.

A run is converged where halving the step leaves its verdict as it is and changes no index by more than 1 %. Runs of
controllers that chatter need not be: which side of a jump a sample falls on changes all that follows.
"""

from __future__ import annotations

from math import floor, inf, isfinite, log10
from typing import TYPE_CHECKING, Any

from facts_damping.analysis.indices import INDICES

if TYPE_CHECKING:
    from collections.abc import Mapping

TOLERANCE = 0.01  # relative change of an index by half the step
DIGITS = 4  # that are printed at most
MARK = "~"  # before a figure that is not converged
FIGURES = ("settling_time_s", "roughness", "max_injected_voltage_pu")  # beside the indices, for their digits alone


def compare(told: Mapping[str, Any], finer: Mapping[str, Any]) -> dict[str, Any]:
    """`converged`, `step_change`, the relative change of each figure, and `warnings`: of two summaries.

    The second is of half the step. A figure that only one of the two has, or that is zero in the second alone, has
    changed by infinity. The warnings are those of the first, and one more if it is not converged.
    """
    pairs = {name: ((told["indices"] or {}).get(name), (finer["indices"] or {}).get(name)) for name in INDICES}
    pairs |= {name: (told[name], finer[name]) for name in FIGURES}
    changes = {name: _change(*pair) for name, pair in pairs.items()}
    flaws = [
        f"the {what} is {finer[what]} instead of {told[what]}"
        for what in ("verdict", "instability")
        if told[what] != finer[what]
    ]
    flaws += [f"{name} changes by {100 * changes[name]:.0f} %" for name in INDICES if changes[name] > TOLERANCE]
    line = [f"not converged: at half the integration step {', '.join(flaws)}"] if flaws else []
    return {"converged": not flaws, "step_change": changes, "warnings": told["warnings"] + line}


def text(value: float, change: float, form: str = f".{DIGITS}g") -> str:
    """A figure with the digits that hold: the last is worth more than twice the change. `~`: none is sure to 1 %."""
    digits = 1 if change >= 1 else DIGITS if change <= 0 else floor(-log10(2 * change))
    mark = MARK if change > TOLERANCE else ""
    return mark + format(value, form if digits >= DIGITS else f".{max(digits, 1)}g")


def _change(value: float | None, finer: float | None) -> float:
    """Relative change, of the finer one."""
    if value == finer:
        return 0.0
    if value is None or not finer or not isfinite(value - finer):
        return inf
    return abs(value - finer) / abs(finer)
