"""Runs and recordings, with what one wants of them at hand."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import dataclass, fields
from functools import cached_property
from html import escape
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping import findings
from facts_damping.analysis import summary as figures
from facts_damping.api.cases import case_of, short_traceback
from facts_damping.case.names import asked_label
from facts_damping.digest import digest
from facts_damping.extras import library
from facts_damping.record import Record
from facts_damping.recording import reader
from facts_damping.simulation import loop
from facts_damping.simulation.twins import twin_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from os import PathLike

    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Result(Record):
    """A run's record: all signals as arrays (`arrays`, with `units`), figures, tables and pictures of them."""

    @property
    def name(self) -> str:
        """System, scenario, controllers, links."""
        return asked_label(self.asked) if self.configuration else "recording"

    @cached_property
    def _summary(self) -> figures.Summary:
        return figures.summarise(self, twin=twin_of(self))

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The figures of the run, as JSON has them (docs/results_json.md)."""
        return figures.as_json(self._summary)

    @property
    def indices(self) -> dict[str, float] | None:
        """ITAE, IAE, ITSE, ISE of the speed differences (4.108); None of a run that has lost synchronism."""
        return self._summary.indices

    @property
    def digest(self) -> str:
        """The same digits for the same signals, to the last bit (docs/architecture.md)."""
        return digest(self)

    def to_pandas(self) -> Any:
        """All of `arrays` as a DataFrame over `time_s`; units in `.attrs["units"]`. Needs pandas."""
        frame = library("pandas", "pandas").DataFrame(self.arrays).set_index("time_s")
        frame.attrs["units"] = dict(self.units)
        return frame

    @short_traceback
    def plot(self, *names: str, beside: Mapping[str, Record | Sequence[Record]] | None = None) -> Figure:
        """A picture: names of `arrays`, over time, or one of `PICTURES` (docs/running.md), `differences` by default.

        `beside`: other records by their names, drawn over it; of several of one name, seeds of a run say, the median in
        a band. Matplotlib's styles apply. Raises `InputError` for a name that is none.
        """
        from facts_damping.analysis.plotting import plots  # noqa: PLC0415 (pictures' library takes longer than a run)

        others = {name: [runs] if isinstance(runs, Record) else list(runs) for name, runs in (beside or {}).items()}
        title = findings.names([self, *(run for group in others.values() for run in group)])[0] if others else ""
        shown = [(title, self), *((name, run) for name, group in others.items() for run in group)]
        return plots.figure(names or ("differences",), shown)

    @cached_property
    def findings(self) -> list[str]:
        """What came out, in lines of words and numbers: those that the commands print."""
        if not len(self.time_ns):
            return ["empty"]
        return findings.findings(self, self._summary, findings.run_to_compare(self, self._summary))

    def __str__(self) -> str:
        """What came out."""
        return "\n".join(self.findings)

    def __repr__(self) -> str:
        """In a line."""
        if not len(self.time_ns):
            return f"<Result {self.name}: empty>"
        ended = "" if self.in_synchronism.all() else ", out of synchronism"
        return f"<Result {self.name}: {len(self.time_ns)} ticks, {self.time_s[-1]:.3f} s{ended}>"

    def _repr_html_(self) -> str:
        """What came out, with a picture, for a notebook."""
        lines = "".join(f"<p>{escape(line)}</p>" for line in self.findings)
        if not len(self.time_ns):
            return lines
        held = BytesIO()
        self.plot().savefig(held, format="png", dpi=100)
        picture = b64encode(held.getvalue()).decode()
        return f'{lines}<img alt="{escape(self.findings[0])}" src="data:image/png;base64,{picture}">'


def of(record: Record) -> Result:
    """A record as a result."""
    return Result(**{field.name: getattr(record, field.name) for field in fields(Record)})


def summarise(record: Record) -> dict[str, Any]:
    """The figures of a record (docs/results_json.md), its verdict free of noise (docs/measures.md)."""
    return of(record).summary


@short_traceback
def simulate(run: str | PathLike[str] | None = None, **changes: Any) -> Result:
    """The closed loop of a run, in process: the bits of the lockstep graph.

    `run`: name under config/runs, or a path; none: all defaults. `changes`: of the run that differ, as a run file has
    them (`link="delay_100ms"`, `controllers=[{"name": "LLC", "parameters": {"gain": 12}}]`), or by path
    (`**{"controllers.0.name": "HBsWC"}`); a `policy` may be a class. Raises `InputError` as the commands do, in one
    line, and `RunError` where a controller of the user's own fails.
    """
    return of(loop.run(case_of(run, changes)))


@short_traceback
def load_recording(path: str | PathLike[str]) -> Result:
    """A recording, folder or file. Raises `RecordingError` where it is none."""
    return of(reader.load(Path(path)))
