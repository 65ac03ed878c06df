"""How much delay controllers bear with each kind of compensation: by runs of the scenarios over a grid of delays."""

from __future__ import annotations

from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping import loop
from facts_damping.analysis.measures import columns, event_times, speed_differences
from facts_damping.analysis.oscillation import is_damped
from facts_damping.configuration import load_case
from facts_damping.control.compensation import COMPENSATIONS
from facts_damping.studies.compare import scenarios
from facts_damping.studies.margins import edge
from facts_damping.studies.pages import heads, line
from facts_damping.studies.pool import run_all
from facts_damping.studies.tune import Scheme, every_scheme

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

SYSTEM = "two_area"
CONTROLLERS = ("LLC", "LLC-tuned", "HBsWC")
CRITERIA = ("damped", "in synchronism")
STEP, CLOSE = 0.02, 2e-3  # s, of the grid of delays, and of the margin


def met(sets: Sequence[str], scenario: str, delay: float) -> dict[str, bool]:
    """What a run meets with a constant delay, s, half of it on each way."""
    half = f"[{{delay: {delay / 2.0!r}}}]"
    changes = [f"system={SYSTEM}", f"scenario={scenario}", *sets, f"link.up={half}", f"link.down={half}"]
    record = loop.run(load_case(None, changes))
    t, sound = record.time_s, bool(record.in_synchronism.all())
    damped = sound and is_damped(t, columns(speed_differences(record)), event_times(record)[-1])
    return {"damped": damped, "in synchronism": sound}


def one(longest: float, more: Sequence[str], what: tuple[str, str, Scheme, str]) -> dict[str, Any]:
    """The margins of one contender; `what`: scenario, controller, scheme, compensation.

    A margin is the smallest delay that does not meet a criterion, s, none where all on the grid do: on the grid, then
    halved. `share`: of the grid's delays, that meet it.
    """
    scenario, name, scheme, compensation = what
    sets = [f"controllers.0.name={name}", f"controllers.0.compensation={compensation}", *more]
    if scheme is not None:
        sets.append(f"controllers.0.scheme={scheme}")
    looked = cache(partial(met, sets, scenario))
    grid = np.round(np.arange(0.0, longest + 1e-9, STEP), 9).tolist()
    row: dict[str, Any] = {"scenario": scenario, "controller": name, "scheme": scheme, "compensation": compensation}
    for criterion in CRITERIA:
        _, high = edge(looked, criterion, grid, CLOSE)
        row[criterion] = {"margin_s": high, "share": float(np.mean([looked(delay)[criterion] for delay in grid]))}
    return row


def study(
    names: Sequence[str], longest: float, sets: Sequence[str], jobs: int, progress: Callable[[int, int], None]
) -> list[dict[str, Any]]:
    """A row for each scenario, controller (none: CONTROLLERS), scheme and compensation, in this order."""
    asked = every_scheme(names or CONTROLLERS)
    todo = [(s, *own, compensation) for s in scenarios(SYSTEM) for own in asked for compensation in COMPENSATIONS]
    return run_all(partial(one, longest, list(sets)), todo, jobs, progress)


def text(found: Sequence[dict[str, Any]], longest: float) -> list[str]:
    """Tables in Markdown, one a scenario."""
    lines = []
    for scenario in dict.fromkeys(row["scenario"] for row in found):
        lines += [f"### {SYSTEM}, {scenario}", ""]
        lines += heads(
            ["controller", "scheme", "compensation"],
            [f"{criterion}{what}" for criterion in CRITERIA for what in (" to [ms]", " at [%]")],
        )
        for row in (row for row in found if row["scenario"] == scenario):
            cells = [cell for criterion in CRITERIA for cell in _cells(row[criterion], longest)]
            lines.append(line([row["controller"], row["scheme"] or "", row["compensation"], *cells]))
        lines.append("")
    return lines


def _cells(found: dict[str, Any], longest: float) -> list[str]:
    margin = f"> {1e3 * longest:.0f}" if found["margin_s"] is None else f"{1e3 * found['margin_s']:.0f}"
    return [margin, f"{100.0 * found['share']:.0f}"]
