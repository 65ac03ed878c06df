"""The command as users type it, on a small table with few draws, and the page that it has made."""

import csv
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.simulation import loop
from facts_damping_reproduction import pictures, results
from facts_damping_reproduction.printed import SCENARIOS, cells
from facts_damping_reproduction.results import TITLES

WHO = {"LLC", "ANFTSC"}
CELLS = [cell for cell in cells(["6.1"]) if cell.controller in WHO and cell.scenario != "multiple"]


@pytest.fixture(scope="module", autouse=True)
def few() -> Iterator[None]:
    """Of table 6.1 two controllers in two of three scenarios; of what was found two run files; one picture."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setitem(SCENARIOS, "two_area", {"I": "small", "II": "large"})
        patched.setattr(results, "cells", lambda tables: CELLS if tables else [])
        patched.setitem(results.FOUND, "two_area", results.FOUND["two_area"][:2])
        shown = [
            picture
            for picture in pictures.wanted(["6.1"])
            if (picture.kind, picture.scenario) == ("mimo_jacobian", "small")
        ]
        patched.setattr(pictures, "wanted", lambda _tables: shown)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("reproduce")
    options = ["--draws", "2", "--jobs", "1", "--out", str(out), "--json", str(out / "told.json")]
    assert main(["reproduce", "3.1", "6.1", *options]) == 0
    return out


def test_second_run_that_goes_on_from_most_of_the_runs_in_another_order_gives_the_same(
    folder: Path, tmp_path: Path
) -> None:
    again = tmp_path / "again"
    shutil.copytree(folder / "runs", again / "runs")
    journals = sorted((again / "runs").glob("*/rows.jsonl"))
    assert len(journals) >= 6
    for number, journal in enumerate(journals):
        head, *rows = journal.read_bytes().splitlines(keepends=True)
        journal.write_bytes(b"".join([head, *reversed(rows[number % 2 :])]))
    shutil.rmtree(journals[0].parent)
    assert main(["reproduce", "3.1", "6.1", "--draws", "2", "--jobs", "1", "--out", str(again)]) == 0
    names = sorted(path.name for path in folder.iterdir() if path.suffix in (".md", ".csv", ".html", ".png"))
    assert {"reproduction.md", "tables.md", "cells.csv", "ensembles.csv", "complexity.csv"} <= set(names)
    for name in names:
        assert (folder / name).read_bytes() == (again / name).read_bytes(), name


def test_reproduction_json_has_the_cells_of_the_csv_file(folder: Path) -> None:
    content = json.loads((folder / "told.json").read_text())
    assert content["tables"] == ["3.1", "6.1"]
    with (folder / "cells.csv").open() as file:
        assert len(content["cells"]) == len(list(csv.DictReader(file))) == len(CELLS)


def test_reproduction_pages_have_all_pictures_tables_and_ensembles(folder: Path) -> None:
    page = "\n".join((folder / name).read_text() for name in ("reproduction.md", "tables.md"))
    for picture in re.findall(r"\]\(([^)]+\.png)\)", page):
        assert (folder / picture).is_file(), picture
    web = (folder / "reproduction.html").read_text()
    assert not re.search(r'(src|href)="https?:', web)
    assert web.count("<table>") == len(re.findall(r"^\| ?-", page, re.MULTILINE))
    assert web.count("data:image/png;base64,") == len(re.findall(r"!\[", page))
    with (folder / "ensembles.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["draws"] for row in rows} == {"2"}
    assert {row["link"] for row in rows} == {"ideal", "pdci_100ms"}
    assert {"MISO LLC-tuned", "MISO LQG", "MIMO LQG"} <= {row["who"] for row in rows}


def test_unknown_table_is_one_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["reproduce", "4.3", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"facts-damping: TABLE: '4.3' given; allowed: {', '.join(TITLES)}\n"


def test_cells_are_those_of_a_run(folder: Path) -> None:
    """Of the MIMO ANFTSC, by hand."""
    with (folder / "cells.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if (row["architecture"], row["controller"]) == ("MIMO", "ANFTSC")]
    assert {row["quantity"] for row in rows} == {"roughness"}
    assert {row["scenario"] for row in rows} == {"small", "large"}
    for row in rows:
        sets = [f"scenario={row['scenario']}", "controllers.0.name=ANFTSC", "link=ideal"]
        summary = summarise(loop.run(load_case("two_area_centralised", sets)))
        assert float(row["ours"]) == pytest.approx(summary.roughness, rel=1e-9)
