"""The drawing of docs/architecture.md: layers, packages and their imports, from pyproject.toml and the code.

The wings are at the top, then the rooms of the core.
"""

from __future__ import annotations

import ast
import re
import sys
from html import escape
from pathlib import Path
from typing import NamedTuple

import grimp

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PACKAGE = "facts_damping"
WINGS = sorted(file.parent.name for file in (ROOT / "extensions").glob("*/__init__.py"))
OF_WINGS, OF_ROOMS = "Wings", "Layers"  # how the names of the two contracts begin
NOT_DRAWN = {PACKAGE, "facts_damping_bench", "facts_damping_reproduction"}  # of the wings' contract
WIDTH, TOP, ROW, STEP = 800, 34, 20, 9.5  # of the drawing, of a row, from one rail to the next; px
LEFT, TEXTS, BARS = 12.0, 706, 714  # first rail; where texts end; where bars begin
LETTER, SMALL = 7.6, 6.0  # width of a letter of names and of texts, px, at most on average
ROUNDED = 500  # lines of code are told in multiples of it
STYLE = """
text { font: 11px system-ui, sans-serif; fill: #4a4a4a }
.name { font-weight: 600; font-size: 12px; fill: #222 }
.name.frame, circle.frame { fill: #1660b8 }
line { stroke: #c3c8d0; stroke-width: 1.2 }
line.frame { stroke: #7fa9dc; stroke-width: 1.6 }
circle { fill: #8d949e }
.bar { fill: #b9bec6 }
"""


class Row(NamedTuple):
    """A package, or the modules of a layer that are single files; what it is for, and its lines of code."""

    names: list[str]  # full names of modules
    layer: int
    purpose: str
    lines: int


def rows() -> list[Row]:
    """From top to bottom, as import-linter's contracts have them."""
    table_rows: list[Row] = []
    for number, names in enumerate([*_layers(OF_WINGS), *_layers(OF_ROOMS)]):
        folders = [name for name in names if (_path(name) / "__init__.py").is_file()]
        table_rows += [Row([name], number, _purpose(name), _lines(name)) for name in folders]
        files = [name for name in names if name not in folders]
        if files:
            table_rows.append(Row(files, number, _purpose(files[0]) if len(files) == 1 else "", 0))
    return table_rows


def _layers(contract: str) -> list[list[str]]:
    """Layers of a contract, each with the full names of its modules; those of a checkout alone are left out."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    (content,) = (
        contract_table for contract_table in settings["contracts"] if contract_table["name"].startswith(f"{contract}: ")
    )
    of = f"{content['containers'][0]}." if "containers" in content else ""
    layers = [[of + name.strip() for name in layer.split("|")] for layer in content["layers"]]
    return [names for names in layers if not set(names) & NOT_DRAWN]


def _path(name: str) -> Path:
    """Folder of a package, or where it would be."""
    places = (ROOT / name.replace(".", "/"), ROOT / "extensions" / name.replace(".", "/"))
    return next((place for place in places if (place / "__init__.py").is_file()), places[0])


def _purpose(name: str) -> str:
    """The first sentence of its docstring."""
    path = _path(name)
    file = path / "__init__.py" if (path / "__init__.py").is_file() else path.with_suffix(".py")
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return re.sub(r" \(docs/\w+\.md\)|`", "", text.partition(". ")[0].splitlines()[0]).rstrip(".")


def _lines(name: str) -> int:
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in _path(name).rglob("*.py"))


def _fitting(text: str, room: float) -> str:
    """As much of a sentence as there is room for, up to a colon or a comma."""
    while len(text) * SMALL > room and (cut := max(text.rfind(","), text.rfind(":"))) > 0:
        text = text[:cut]
    return text


def imports(drawn: list[Row]) -> set[tuple[int, int]]:
    """Numbers of rows: the first imports the second."""
    graph = grimp.build_graph(PACKAGE, *WINGS, cache_dir=None)

    def any_of(above: Row, below: Row) -> bool:
        return any(
            graph.direct_import_exists(importer=a, imported=b, as_packages=True)
            for a in above.names
            for b in below.names
        )

    pairs = ((i, k) for i in range(len(drawn)) for k in range(i + 1, len(drawn)))
    return {(i, k) for i, k in pairs if any_of(drawn[i], drawn[k])}


def way_of_a_frame() -> set[str]:
    """The packages in the table of docs/architecture.md that follows a frame."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = text.partition("\n## The path of one frame")[2].partition("\n## ")[0]
    return {f"{PACKAGE}.{name}" for name in re.findall(r"`(\w+)/[\w/]+\.py`", table)}


def drawing() -> str:
    """The SVG: under each package a rail, with a dot beside every package below that it imports."""
    table_rows, frame = rows(), way_of_a_frame()
    used, height = imports(table_rows), TOP + ROW * len(table_rows) + 12
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}">',
        f"<style>{STYLE}</style>",
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
    ]
    for number in {row.layer for row in table_rows if row.layer % 2}:
        members = [i for i, row in enumerate(table_rows) if row.layer == number]
        parts.append(
            f'<rect y="{TOP + ROW * members[0]}" width="{WIDTH}" height="{ROW * len(members)}" fill="#f2f4f7"/>'
        )
    parts.append(f'<text x="{WIDTH - 10}" y="20" text-anchor="end">lines of code, about</text>')
    for i, row in enumerate(table_rows):
        x, y = LEFT + STEP * i, TOP + ROW * (i + 0.5)
        seen = [k for above, k in sorted(used) if above == i]
        kind = ' class="frame"' if frame & set(row.names) else ""
        if seen:
            parts.append(f'<line{kind} x1="{x:g}" y1="{y:g}" x2="{x:g}" y2="{TOP + ROW * (seen[-1] + 0.5):g}"/>')
        parts += [f'<circle{kind} cx="{x:g}" cy="{TOP + ROW * (k + 0.5):g}" r="3"/>' for k in seen]
        name = ", ".join(name.removeprefix(f"{PACKAGE}.") for name in row.names)
        purpose = escape(_fitting(row.purpose, TEXTS - x - LETTER * len(name) - 14), quote=False)
        title = f'<tspan class="name{" frame" if kind else ""}">{name}</tspan>'
        parts.append(f'<text x="{x + 6:g}" y="{y + 4:g}">{title}<tspan dx="8">{purpose}</tspan></text>')
        if row.lines:
            rounded = max(1, round(row.lines / ROUNDED))
            parts.append(f'<rect class="bar" x="{BARS}" y="{y - 4:g}" width="{rounded * 2.4:g}" height="8"/>')
            parts.append(f'<text x="{WIDTH - 10}" y="{y + 4:g}" text-anchor="end">{rounded * ROUNDED}</text>')
    return "\n".join([*parts, "</svg>", ""])
