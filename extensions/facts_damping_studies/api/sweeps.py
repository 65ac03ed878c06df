"""Studies: many runs in parallel, as tables."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from facts_damping.analysis.indices import INDICES
from facts_damping.api.cases import plain, short_traceback
from facts_damping.extras import library
from facts_damping.output.tables import table
from facts_damping.output.terminal import Progress
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.yaml_text import dump
from facts_damping_studies.parameters import Study
from facts_damping_studies.sweeps import sweep as studies
from facts_damping_studies.sweeps import sweep_plots
from facts_damping_studies.sweeps.control_outcomes import tripped
from facts_damping_studies.sweeps.pool import refuse_within
from facts_damping_studies.sweeps.results import cell, sweep_tables

if TYPE_CHECKING:
    from os import PathLike

    from facts_damping_studies.sweeps.sweep import SweepPlan
    from facts_damping_studies.sweeps.sweep_rows import MarginRow, SweepRow

SHOWN = 20  # runs, in a notebook


@dataclass(frozen=True, repr=False)
class Sweep:
    """A study that was carried out."""

    name: str
    _rows: list[SweepRow] = field(repr=False)
    _margins: list[MarginRow] = field(repr=False)
    _plan: SweepPlan = field(repr=False)

    @cached_property
    def rows(self) -> list[dict[str, Any]]:
        """A run each: columns of its point, figures (docs/studies.md)."""
        return [row.cells for row in self._rows]

    @cached_property
    def margins(self) -> list[dict[str, Any]]:
        """A margin each, where the study asks for them."""
        return [row.cells for row in self._margins]

    def to_pandas(self) -> Any:
        """The rows as a DataFrame. Needs pandas."""
        return library("pandas", "pandas").DataFrame(self.rows)

    def margins_to_pandas(self) -> Any:
        """The margins as a DataFrame. Needs pandas."""
        return library("pandas", "pandas").DataFrame(self.margins)

    def plot(self, folder: str | PathLike[str]) -> list[Path]:
        """Pictures of margins, figures and latencies as PNG files in a folder: their paths."""
        place = Path(folder)
        place.mkdir(parents=True, exist_ok=True)
        across = studies.across(self._plan)
        return list(sweep_plots.plot(self._rows, studies.swept(self._plan), self._margins, across, place))

    def __repr__(self) -> str:
        """In a line."""
        failed = sum(row.error is not None for row in self._rows)
        trips = sum(map(tripped, self._rows))
        parts = [f"{len(self._rows)} runs", *([f"{failed} failed"] if failed else [])]
        parts += [f"{trips} tripped"] if trips else []
        parts += [f"{len(self._margins)} margins"] if self._margins else []
        return f"<Sweep {self.name}: {', '.join(parts)}>"

    def _repr_html_(self) -> str:
        """Its tables, for a notebook: margins, and figures of the first runs."""
        columns = [*dict.fromkeys((*self._plan.points[0].columns, "controller", "verdict", *INDICES))]
        cells = [[cell(row.get(name)) for name in columns] for row in self.rows[:SHOWN]]
        lines = [*sweep_tables(self._rows, self._margins, [], studies.across(self._plan)), "", *table(columns, cells)]
        return f"<pre>{chr(10).join(lines)}</pre>"


@short_traceback
def sweep(
    study: str | PathLike[str] | dict[str, Any],
    *,
    jobs: int | None = None,
    out: str | PathLike[str] | None = None,
    progress: bool = False,
) -> Sweep:
    """Many runs of a study in parallel, each in a process of its own; none of it on the terminal unless asked.

    `study`: name under config/studies, path, or its content (docs/studies.md); `jobs`: processes, none: all cores;
    `out`: folder in which it goes on where it was interrupted; `progress`: on the terminal. Raises `InputError`.
    """
    refuse_within()
    if isinstance(study, dict):
        content = plain(study)
        plan = studies.planned(check(Study, content, "study"), "study", "study", dump(content))
    else:
        plan = studies.plan(str(study), [])
    shown = Progress(plan.name, "runs", shown=progress)
    with TemporaryDirectory() as passing:
        try:
            states = studies.run(plan, Path(out or passing), jobs or os.cpu_count() or 1, None, shown)
        finally:
            shown.close()
    return Sweep(plan.name, studies.rows(states), studies.found_margins(plan, states), plan)
