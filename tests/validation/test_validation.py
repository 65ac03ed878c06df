"""`facts-damping validate`: every row passes, and the page in docs is the one that it writes."""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from facts_damping.cli.main import main
from facts_damping_validation import psse, report
from facts_damping_validation.table import Row, ValidationTable, as_csv, compare, furthest, summary, within
from tests.commands import assert_one_line

if TYPE_CHECKING:
    import pytest

PAGE = Path(__file__).parents[2] / "docs" / "validation.md"


def fixed(page: Path) -> tuple[list[str], list[list[str]]]:
    """What is the same on every machine: the page without worst rows, the CSV without ours and differences."""
    lines = [line.split(" | ")[:3] if line.startswith("| ") else [line] for line in page.read_text().splitlines()]
    with page.with_suffix(".csv").open(encoding="utf-8", newline="") as file:
        rows = [[*row[:5], row[6], *row[8:]] for row in csv.reader(file)]
    return ["|".join(line) for line in lines], [
        [re.sub(r"with \S+ p\.u\. s stored", "stored", cell) for cell in row] for row in rows
    ]


def test_validation_rows_pass_and_the_page_in_docs_is_up_to_date(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, figures = tmp_path / "validation.md", tmp_path / "validation.json"
    assert main(["validate", "--out", str(page), "--json", str(figures)]) == 0, capsys.readouterr().err
    tables = json.loads(figures.read_text())
    assert len(tables) == len(report.TABLES)
    assert all(table["passed"] for table in tables)
    assert all(row["passed"] or row["cause"] for table in tables for row in table["rows"])
    assert all(table["rows"] for table in tables)
    assert fixed(page) == fixed(PAGE)


def test_row_that_fails_is_named_and_ends_with_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [compare("mass of the earth", "kg", 6.0, 5.97, 0.01), within("a curve", "m", [0.1, -0.3], 0.5)]
    monkeypatch.setitem(report.TABLES, "equilibrium", lambda: ValidationTable("Planets", "a book", "", rows))
    assert main(["validate", "equilibrium"]) == 1
    out, err = capsys.readouterr()
    assert err == "facts-damping: validate: 1 rows fail: mass of the earth\n"
    assert "FAIL  mass of the earth" in out
    assert "pass  a curve" in out
    table = ValidationTable("Planets", "a book", "", rows)
    assert summary([table])[-1] == "| Planets | a book | **1 of 2** | mass of the earth | 3.0e-02 kg | 1.0e-02 |"
    assert as_csv([table]).splitlines()[1:] == [
        "Planets,a book,,mass of the earth,kg,6.0000,5.9700,3.0e-02,1.0e-02,,fail",
        "Planets,a book,,a curve,m,,,3.0e-01,5.0e-01,,pass",
    ]


def test_row_without_a_model_is_open_and_tells_why(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    nothing = Row("a ring", "", "", "", math.nan, math.nan, "not modelled: RING1")
    rows = [nothing, compare("mass of the earth", "kg", 6.0, 5.97, 0.05)._replace(cause="measured in 1798")]
    monkeypatch.setitem(report.TABLES, "equilibrium", lambda: ValidationTable("Planets", "a book", "", rows))
    assert main(["validate", "equilibrium"]) == 0
    out = capsys.readouterr().out
    assert "open  a ring             not modelled: RING1" in out
    assert "(measured in 1798)" in out
    assert "1 rows pass, 1 are open" in out
    table = ValidationTable("Planets", "a book", "", rows)
    assert summary([table])[-1].startswith("| Planets | a book | 1 of 2, 1 open | mass of the earth |")
    assert as_csv([table]).splitlines()[1] == "Planets,a book,,a ring,,,,nan,nan,not modelled: RING1,open"


def test_every_trace_and_every_pair_of_psse_is_in_the_index() -> None:
    compared = {(psse.folder() / case.folder / case.trace).resolve() for case in psse.cases()}
    assert compared == set(psse.folder().glob("*/*.csv"))
    imported = {path.resolve() for pair in psse.pairs() for path in pair}
    assert imported == {path for kind in ("raw", "dyr") for path in psse.folder().glob(f"*/*.{kind}")}


def test_unknown_table_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert_one_line(2, ["validate", "nonsense"], "TABLE: 'nonsense' given; allowed: power-flow-two-area", capsys)


def test_validation_row_without_a_number_fails() -> None:
    assert not Row("x", "1", "", "", float("nan"), 1.0).passed
    assert not within("x", "1", [0.0, float("nan")], 1.0).passed


def test_furthest_sees_a_missing_eigenvalue() -> None:
    ours = np.array([-1 + 0j, -2 + 0j])
    assert furthest(ours, np.array([-1 + 0j, -2.5 + 0j])) == 0.5
    assert not within("x", "1", furthest(ours, ours[:1]), 1.0).passed
