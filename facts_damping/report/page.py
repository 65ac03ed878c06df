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
from facts_damping.errors import InputError
from facts_damping.escaping import escaped
from facts_damping.output.writing import write_whole
from facts_damping.report.build import MAX_EVENTS, build
from facts_damping.report.contents import ReportTable
from facts_damping.report.plotting import plot
from facts_damping.version import __version__

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bokeh.models import Model

    from facts_damping.report.contents import Report, ReportedRun

LONG = 24  # characters: longer table entries are wrapped
MARKS = {"best": "▲", "worst": "▼"}


def write(path: Path, runs: Sequence[ReportedRun], baseline: int = 0) -> None:
    """Write the report of several runs.

    `baseline`: index of the run that improvement refers to. Raises InputError if the file cannot be written.
    """
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
        loader=PackageLoader("facts_damping.report", "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, finalize=_shown,
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
