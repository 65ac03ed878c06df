"""The page on faults at inverters says of every case how it ended."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from facts_damping_reproduction.inverter_faults import cases, pages, runs

DOCS = Path(__file__).parents[2] / "docs"
BESIDE = {"infinite": "infinite bus", "forming": "grid-forming inverter alone", "machine": "machine"}


def test_every_case_is_on_the_page_once(tmp_path: Path) -> None:
    page, table = pages.write(tmp_path, 6)
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert [int(row["case"]) for row in rows] == list(range(6))
    assert all(row["ends"] in pages.HOW for row in rows)
    by_source = [line.split("|")[1:-1] for line in page.read_text(encoding="utf-8").splitlines() if line[:2] == "| "]
    counts = [[int(cell) for cell in row[1:]] for row in by_source if row[0].strip() in cases.SOURCES]
    assert sum(row[0] for row in counts) == 6 + 3  # of the rule, and below its short-circuit ratio
    assert all(row[0] == sum(row[1:7]) for row in counts)
    assert "**0 runs ended by numerics**" in page.read_text(encoding="utf-8")


def test_case_is_drawn_from_its_number_alone() -> None:
    assert cases.case(3) == cases.case(3)
    assert cases.case(3) != cases.case(4)
    assert runs.outcome(cases.case(3), 0.0).how in pages.HOW


def test_page_in_docs_has_the_counts_of_its_table() -> None:
    text = (DOCS / "inverters.md").read_text(encoding="utf-8")
    rows = list(csv.DictReader((DOCS / "images/inverters/faults.csv").read_text(encoding="utf-8").splitlines()))
    ends = pages.HOW[:5]  # none by numerics
    counts = [
        [sum(row["ends"] == how and row["source"] == source for row in rows) for how in ends] for source in BESIDE
    ]
    table = re.findall(rf"^\| (?:{'|'.join(BESIDE.values())}) \|(.*)\|$", text, re.MULTILINE)
    assert [[int(cell) for cell in row.split("|")] for row in table] == [[sum(row), *row] for row in counts]
    assert len(rows) == sum(map(sum, counts)) == pages.CASES
    without = sum(float(row["without current s"]) > 0.0 for row in rows)
    assert f"In {without} cases" in text
