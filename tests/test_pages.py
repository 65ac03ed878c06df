"""What the pages show exists: what their examples import, and the rows of the tables that they print."""

from __future__ import annotations

import ast
import re
import runpy
from pathlib import Path

import pytest

from facts_damping.analysis.summary import ROWS

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
EXAMPLES = [
    pytest.param(text, id=f"{page.stem}-{i}")
    for page in PAGES
    for i, text in enumerate(re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL))
]


@pytest.mark.parametrize("example", EXAMPLES)
def test_what_an_example_imports_is_there(example: str) -> None:
    for statement in ast.walk(ast.parse(example)):
        if isinstance(statement, (ast.Import, ast.ImportFrom)):
            exec(ast.unparse(statement), {})


@pytest.mark.parametrize("name", ["README.md", "docs/tutorial_nine_bus.md"])
def test_the_tables_of_runs_have_the_rows_that_are_printed(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    tables = re.findall(r"^    \$ facts-damping simulate .*\n((?:    .*\n)+)", text, re.MULTILINE)
    labels = {label.strip() for label, *_ in ROWS} | {"..."}
    assert tables
    for table in tables:
        rows = [row.strip() for row in table.rpartition("----\n")[2].splitlines()]
        shown = {re.split(r"  +", row)[0] for row in rows if not row.startswith("plot:")}
        assert len(shown) > 1
        assert shown <= labels


def test_the_reference_page_is_what_docstrings_say() -> None:
    made = runpy.run_path(str(ROOT / "docs" / "reference.py"))["page"]()
    assert (ROOT / "docs" / "api.md").read_text(encoding="utf-8") == made, "python docs/reference.py"


def test_the_tutorials_class_is_the_templates() -> None:
    text = (ROOT / "docs" / "tutorial_controller.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    template = (ROOT / "facts_damping" / "templates" / "controller" / "controller.py.txt").read_text(encoding="utf-8")
    lines = [line for line in block.splitlines()[2:] if line.strip()]
    assert len(lines) == 6
    assert all(line in template for line in lines)
