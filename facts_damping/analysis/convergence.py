"""Convergence of a run's figures with the integration step, and the number of digits that hold.

A run is converged if halving the step keeps its verdict and changes no index by more than 1 %. Runs of controllers that
chatter may not converge: the side of a jump on which a sample falls changes all that follows.
"""

from __future__ import annotations

from dataclasses import replace
from math import floor, inf, isfinite, log10
from typing import TYPE_CHECKING

from facts_damping.analysis.indices import INDICES

if TYPE_CHECKING:
    from facts_damping.analysis.summary import Summary

TOLERANCE = 0.01  # largest relative change of an index when the step is halved
DIGITS = 4  # printed at most
MARK = "~"  # prefix of a figure that is not converged
FIGURES = ("settling_time_s", "roughness", "max_injected_voltage_pu")  # their changes only set the digits shown


def compare(summary: Summary, finer: Summary) -> Summary:
    """A summary with its `converged` and `step_change`, by the summary of half the step.

    The change is infinite if only one of the two has the figure, or if it is zero in the second alone. There is one
    more warning if the run is not converged.
    """
    pairs = {name: ((summary.indices or {}).get(name), (finer.indices or {}).get(name)) for name in INDICES}
    pairs |= {name: (getattr(summary, name), getattr(finer, name)) for name in FIGURES}
    changes = {name: _change(*pair) for name, pair in pairs.items()}
    words = {"verdict": (summary.verdict, finer.verdict), "instability": (summary.instability, finer.instability)}
    flaws = [f"the {what} is {other} instead of {word}" for what, (word, other) in words.items() if word != other]
    flaws += [f"{name} changes by {100 * changes[name]:.0f} %" for name in INDICES if changes[name] > TOLERANCE]
    line = [f"not converged: at half the integration step {', '.join(flaws)}"] if flaws else []
    return replace(summary, converged=not flaws, step_change=changes, warnings=summary.warnings + line)


def text(value: float, change: float, form: str = f".{DIGITS}g") -> str:
    """A figure with the digits that hold: the last is worth more than twice the change. `~`: not certain to 1 %."""
    digits = 1 if change >= 1 else DIGITS if change <= 0 else floor(-log10(2 * change))
    mark = MARK if change > TOLERANCE else ""
    return mark + format(value, form if digits >= DIGITS else f".{max(digits, 1)}g")


def _change(value: float | None, finer: float | None) -> float:
    """Change relative to the finer value."""
    if value == finer:
        return 0.0
    if value is None or not finer or not isfinite(value - finer):
        return inf
    return abs(value - finer) / abs(finer)
