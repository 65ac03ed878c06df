"""What `reproduce` leaves: the page and the tables in Markdown, both as one page of HTML, CSV files, pictures."""

from __future__ import annotations

import base64
import re
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader
from markdown_it import MarkdownIt
from pyarrow import csv

from facts_damping.output.writing import write_whole
from facts_damping.version import __version__
from facts_damping_reproduction import charts, extracts, side_by_side
from facts_damping_reproduction.agreement import flat, markdown, name
from facts_damping_reproduction.ensembles import Interval
from facts_damping_reproduction.printed import LLC
from facts_damping_reproduction.results import LINK, TITLES
from facts_damping_reproduction.templates import render
from facts_damping_studies.pages import save
from facts_damping_studies.sweeps.results import table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from facts_damping_reproduction.findings import Findings
    from facts_damping_reproduction.results import Results

PAGE, SIDE, WEB = "reproduction.md", "tables.md", "reproduction.html"


def write(results: Results, findings: Findings, folder: Path) -> list[Path]:
    """Everything into a folder: the files, pictures last."""
    command = " ".join(["facts-damping reproduce", *(results.tables if len(results.tables) < len(TITLES) else ())])
    command += "" if results.draws is None else f" --draws {results.draws}"
    pictures = [*_charts(results, findings, folder), *results.pictures]
    page = _page(results, findings, command, [path.name for path in pictures])
    tables = "\n".join(side_by_side.page(results, findings, command)).rstrip() + "\n"
    write_whole(folder / PAGE, page)
    write_whole(folder / SIDE, tables)
    write_whole(folder / WEB, _html(f"{page}\n{tables}", folder))
    return [folder / PAGE, folder / SIDE, folder / WEB, *_csv(results, findings, folder), *pictures]


def document(results: Results, findings: Findings) -> dict[str, Any]:
    """The figures as JSON."""
    parts = _lists(results, findings)
    return {"tables": list(results.tables), **{stem: [_row(row) for row in rows] for stem, rows in parts.items()}}


def _lists(results: Results, findings: Findings) -> dict[str, Sequence[Any]]:
    """Rows by the stem of their file."""
    return {
        "agreement": extracts.agreed(findings),
        "complexity": results.complexity,
        "cells": findings.plain.compared,
        "cells_ensemble": findings.drawn.compared,
        "signs": findings.plain.signs,
        "signs_ensemble": findings.drawn.signs,
        "statements": findings.plain.statements,
        "rankings": findings.plain.rankings,
        "rankings_ensemble": findings.drawn.rankings,
        "ensembles": findings.spreads,
        "firmness": findings.firmness,
        "decided": findings.decided,
        "reached": findings.reached,
        "variants": results.told,
    }


def _row(row: Any) -> dict[str, Any]:
    """A named tuple as scalars: an interval as three of them, names as one text."""
    scalars: dict[str, Any] = {}
    for field, value in row._asdict().items():
        if isinstance(value, Interval):
            scalars |= {f"{field}_{end}": number for end, number in value._asdict().items()}
        elif hasattr(value, "_asdict"):
            scalars |= flat(value)
        else:
            scalars[field] = ", ".join(map(str, value)) if isinstance(value, tuple) else value
    return scalars


def _csv(results: Results, findings: Findings, folder: Path) -> list[Path]:
    paths = []
    for stem, rows in _lists(results, findings).items():
        if rows:
            paths.append(folder / f"{stem}.csv")
            csv.write_csv(table([_row(row) for row in rows]), paths[-1])
    return paths


def _charts(results: Results, findings: Findings, folder: Path) -> list[Path]:
    """Pictures of the agreement."""
    figures: dict[str, Any] = {}
    if findings.plain.signs_by_reference and any(order.rho is not None for order in findings.plain.rankings):
        figures["verdict"] = charts.verdict(findings.plain.signs_by_reference, findings.plain.rankings)
    for number in dict.fromkeys(cell.table for cell in results.cells):
        cells = [c for c in findings.plain.compared if c.cell.table == number]
        figures[f"table_{number.replace('.', '_')}"] = charts.of_table(number, TITLES[number], cells)
    for system in dict.fromkeys(spread.system for spread in findings.spreads):
        plain = {
            (c.cell.scenario, name(c.cell.who)): c.ours
            for c in findings.plain.compared
            if (c.cell.system, c.cell.against, c.cell.quantity) == (system, LLC, charts.SHOWN)
        }
        spreads = [
            spread
            for spread in findings.spreads
            if (spread.system, spread.link, spread.quantity) == (system, "ideal", charts.SHOWN)
        ]
        figures[f"ensemble_{system}"] = charts.ensemble(system, spreads, plain)
    if results.told:
        figures["variants"] = charts.variants(results.told)
    for stem, figure in figures.items():
        save(figure, folder / f"{stem}.png")
    return [folder / f"{stem}.png" for stem in figures]


def _page(results: Results, findings: Findings, command: str, pictures: Sequence[str]) -> str:
    """The paper: its text with the figures in it."""
    functions = {extract.__name__: extract for extract in extracts.ALL}
    return render(
        "page.md", results=results, findings=findings, command=command, pictures=pictures, link=LINK, titles=TITLES,
        whole=len(results.tables) == len(TITLES), version=__version__, markdown=markdown, **functions,
    )  # fmt: skip


def _html(text: str, folder: Path) -> str:
    """Markdown as a page by itself, pictures inside."""
    body = MarkdownIt("commonmark").enable(["table", "strikethrough"]).render(text)
    inside = re.sub(r'src="([^":]+\.png)"', lambda match: f'src="{_data(folder / match[1])}"', body)
    wide = inside.replace("<table>", '<div class="scroll" tabindex="0"><table>').replace("</table>", "</table></div>")
    templates = Environment(loader=PackageLoader("facts_damping_reproduction", "."), autoescape=False)  # noqa: S701
    style = files("facts_damping_views.report") / "page.css"
    return templates.get_template("page.html").render(
        body=wide, style=style.read_text(encoding="utf-8"), version=__version__
    )


def _data(path: Path) -> str:
    return f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}"
