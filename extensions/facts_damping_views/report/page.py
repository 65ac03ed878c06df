"""Writes a report as one HTML page with scripts, style and data inside."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bokeh
from bokeh.document import Document
from bokeh.embed import components
from bokeh.resources import Resources
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.analysis.summary import AUTO, Summary, summarise
from facts_damping.errors import InputError
from facts_damping.escaping import escaped
from facts_damping.output.writing import write_whole
from facts_damping.simulation.twins import twin_of
from facts_damping.version import __version__
from facts_damping_views.analysis.details import improvements
from facts_damping_views.report.contents import ReportedRun, ReportTable
from facts_damping_views.report.plotting import plot
from facts_damping_views.report.sections import MAX_EVENTS, build

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from bokeh.models import Model

    from facts_damping.record import Record
    from facts_damping_views.report.contents import Report

LONG = 24  # characters: longer table entries are wrapped
MARKS = {"best": "▲", "worst": "▼"}


def write(
    path: Path,
    records: Sequence[tuple[str, Record]],
    summaries: Sequence[Summary | Mapping[str, Any]] | None = None,
    baseline: int = 0,
) -> None:
    """Write the report of several records (name, record).

    `summaries`: of each its `Summary`, or the dictionary of `fd.summarise`, which may have the path of the `recording`
    and `improvement_percent`; None: computed, with the improvement over the run of index `baseline`. Raises InputError
    if the file cannot be written.
    """
    if summaries is None:
        figures = [summarise(record, twin=twin_of(record)) for _, record in records]
        rows = zip(records, figures, improvements(figures, baseline), strict=True)
        runs = [ReportedRun(*named, summary, "-", percent) for named, summary, percent in rows]
    else:
        runs = [_reported(*named, summary) for named, summary in zip(records, summaries, strict=True)]
    write_runs(path, runs, baseline)


def _reported(name: str, record: Record, summary: Summary | Mapping[str, Any]) -> ReportedRun:
    if isinstance(summary, Summary):
        return ReportedRun(name, record, summary)
    figures = summarise(record, method=summary.get("modes_method") or AUTO, twin=twin_of(record))
    return ReportedRun(name, record, figures, summary.get("recording") or "-", summary.get("improvement_percent"))


def write_runs(path: Path, runs: Sequence[ReportedRun], baseline: int = 0) -> None:
    """Write the report of several runs."""
    text = page(build(runs, baseline))
    try:
        write_whole(path, text)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; allowed: a file in a folder that can be written") from error


def _shown(value: Any) -> Any:
    return value if isinstance(value, Markup) or not isinstance(value, str) else escaped(value)


def page(report: Report) -> str:
    """A report as HTML. Names and notes come from recordings, so all text but Bokeh's is escaped."""
    charts = plot(report)
    flat: dict[str, Model] = {
        f"{key}-{i}": figure for key, parts in charts.items() for i, (_, figure) in enumerate(parts)
    }
    document = Document()
    with document.models.freeze():  # otherwise every figure traverses all shared models again
        for model in flat.values():
            document.add_root(model)
    script, divs = components(flat) if flat else ("", {})
    figures = {
        key: [(title, Markup(divs[f"{key}-{i}"])) for i, (title, _) in enumerate(parts)]  # noqa: S704 (Bokeh's own)
        for key, parts in charts.items()
    }
    templates = Environment(
        loader=PackageLoader("facts_damping_views.report", "."), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, finalize=_shown,
    )  # fmt: skip
    return templates.get_template("page.html").render(
        report=report,
        figures=figures,
        events=_events(report),
        is_table=lambda item: isinstance(item, ReportTable),
        marks=MARKS,
        long=LONG,
        colours=[COLOURS[i % len(COLOURS)] for i in range(len(report.names))],
        library=Markup(Resources(mode="inline", components=["bokeh"]).render_js()),  # noqa: S704
        script=Markup(script),  # noqa: S704
        versions=f"facts_damping {__version__}, Bokeh {bokeh.__version__}",
    )


def _events(report: Report) -> str:
    named = [f"{at:g} s {what}" for at, what in report.events[:MAX_EVENTS]]
    more = len(report.events) - len(named)
    return "; ".join(named) + (f"; and {more} more" if more else "")
