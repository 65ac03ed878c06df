"""What became of control in the runs of a study: trips, refusals to arm, setpoints at their limits, missing runs."""

from __future__ import annotations

from collections import Counter
from statistics import median
from typing import TYPE_CHECKING

from facts_damping.analysis.run_warnings import MOSTLY, NEVER_ARMED
from facts_damping_studies.sweeps.enumerated_axes import NONE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping_studies.sweeps.sweep_rows import SweepRow

    Rows = Sequence[SweepRow]

TRIPPED, AT_LIMITS = "tripped", "at its limits"
WORDS = {
    NEVER_ARMED: f"a controller that was {NEVER_ARMED}",
    AT_LIMITS: "setpoints at their limits to the end or most of the time",
}
APART_MS = 17.0  # spread of the latencies from which on frames come apart: a frame at 60 frames/s
ALIGN = "a PDC aligns frames of a jittery link: a `wait` stage in `link.up`"
HELP = {  # what helps against trips by monitors that a link with jitter exceeds
    "misaligned": f"{ALIGN}; or raise `supervision.monitors.misaligned.limit`",
    "missing": f"{ALIGN}; or raise `supervision.monitors.missing.limit`",
}


def tripped(row: SweepRow) -> bool:
    """Whether a supervisor tripped a controller of the run."""
    return row.figures is not None and row.figures.trips > 0


def marks(row: SweepRow) -> list[str]:
    """Words for what kept control from acting as intended in a run; empty: nothing did."""
    if row.figures is None:
        return []
    limited = row.at_limits or (row.figures.saturation_duty or 0.0) > MOSTLY
    never = NEVER_ARMED in (row.figures.warnings or "")
    return [word for word, is_so in ((TRIPPED, tripped(row)), (NEVER_ARMED, never), (AT_LIMITS, limited)) if is_so]


def trip_line(rows: Rows) -> str | None:
    """How many controlled runs were tripped, by which monitor most, its median value and its limit; None: no run."""
    trips, controlled = [row for row in rows if tripped(row)], _controlled(rows)
    if not trips:
        return None
    line = f"{len(trips)} of {len(controlled)} controlled runs {_were(len(trips))} tripped"
    first = [row.first_trip for row in trips if row.first_trip is not None]
    if not first:  # rows of an earlier version
        return line
    causes = Counter(trip.cause for trip in first)
    cause, _ = causes.most_common(1)[0]
    beyond = [(trip.value, trip.limit, trip.unit) for trip in first if trip.cause == cause and trip.value is not None]
    line += f", {'most ' if len(causes) > 1 else ''}by `{cause}`"
    if not beyond:
        return line
    _, limit, unit = beyond[0]
    value = median(number for number, *_ in beyond)
    return f"{line} ({value:.3g}{'' if unit in ('-', None) else f' {unit}'}; limit {limit:g})"


def outcome_lines(rows: Rows, *, hints: bool = True) -> list[str]:
    """Lines on what became of control: trips and what helps, refusals to arm, setpoints at their limits."""
    trips, controlled = trip_line(rows), len(_controlled(rows))
    lines = [] if trips is None else [trips, *(f"hint: {hint}" for hint in (_hints(rows) if hints else []))]
    for mark, text in WORDS.items():
        marked = [row for row in rows if mark in marks(row)]
        if marked:
            lines.append(f"{len(marked)} of {controlled} controlled runs {_had(len(marked))} {text}")
    return lines


def missing_line(rows: Rows) -> str | None:
    """The runs that failed, with the first reason; None: there are none."""
    failed = [row.error for row in rows if row.error]
    return f"{len(failed)} of {len(rows)} runs could not be made, the first: {failed[0]}" if failed else None


def _controlled(rows: Rows) -> list[SweepRow]:
    return [row for row in rows if row.figures is not None and row.columns.get("controller") != NONE]


def _hints(rows: Rows) -> list[str]:
    """What helps against the trips of a link with jitter, by the monitor that tripped most."""
    causes: Counter[str] = Counter()
    for row in rows:
        if row.first_trip is None or row.figures is None:
            continue
        low, high = (row.figures.latency.get(f"latency_{end}_ms") for end in ("p0", "max"))
        apart = low is not None and high is not None and high - low > APART_MS
        causes[row.first_trip.cause] += apart and row.first_trip.cause in HELP
    return [HELP[cause] for cause, count in causes.most_common(1) if count]


def _were(count: int) -> str:
    return "was" if count == 1 else "were"


def _had(count: int) -> str:
    return "has" if count == 1 else "have"
