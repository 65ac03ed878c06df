"""Numbers in docs/results.md and the pages that it names are those of the tables beside them."""

from __future__ import annotations

import csv
import re
import shutil
from pathlib import Path

import pytest
from facts_damping_reproduction import result_figures

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.simulation import loop

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("results", "delay_results", "supervision_results", "reproduction")


def text(page: str) -> str:
    return " ".join((DOCS / f"{page}.md").read_text(encoding="utf-8").split())


def rows(table: str) -> list[dict[str, str]]:
    with (DOCS / "images" / table).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("page", PAGES)
def test_fractions_are_those_of_their_counts(page: str) -> None:
    for part, whole, percent in re.findall(r"\b(\d+) of (\d+)(?: cases)? \(([\d.]+) %", text(page)):
        digits = len(percent.partition(".")[2])
        assert f"{100 * int(part) / int(whole):.{digits}f}" == percent, (part, whole)


@pytest.mark.parametrize("page", PAGES)
def test_tables_that_a_page_links_exist_and_have_rows(page: str) -> None:
    linked = re.findall(r"\]\((images/[^)]+)\)", text(page))
    assert linked
    for name in linked:
        assert (DOCS / name).stat().st_size > 100, name


def test_the_thesis_s_statements_hold_as_often_as_the_table_says() -> None:
    page = text("reproduction")
    for row in rows("reproduction/agreement.csv"):
        count, said = f"{row['here']} of {row['of']}", row["statement"]
        shown = count if said != "the same controller first in an order" else f"of {row['of']} orders"
        assert shown in page, said
    assert "first in 13." in page


def test_rates_of_supervision_are_those_of_the_campaigns() -> None:
    page = text("supervision_results")
    for campaign in ("do_no_harm", "wrong_control"):
        for row in rows(f"{campaign}/table_outcomes.csv")[1:]:
            number, percent = row["with supervision, number"], float(row["with supervision, percent"])
            assert f"{number} of {row['cases']}" in page or f"{number} ({percent:.2f} %)" in page, row
            assert re.search(rf"\b{row['without supervision, number']}\b", page), row
    total = rows("healthy/table_healthy.csv")[-1]
    for name in ("fell back or tripped", "harmful"):
        number, percent = total[f"{name}, number"], float(total[f"{name}, percent"])
        assert re.search(rf"\b{number} .{{0,30}}\({percent:.2f} %\)", page), name
    for campaign, who in (("do_no_harm", "all controllers"), ("healthy", "lead-lags and LQG")):
        for row in rows(f"{campaign}/table_cost.csv"):
            assert " | ".join([f"| {row['the controller']}, {who}", *list(row.values())[1:]]) in page


def test_delay_limits_are_those_of_the_studies() -> None:
    page = text("delay_results")
    for row in rows("deployment_margin/margins.csv"):
        if row["beyond"] != "low" and row["high_s"]:
            assert f"{row['margin_s']} [{row['low_s']}, {row['high_s']}]" in page
    found = {tuple(row[k] for k in ("controller", "scheme", "scenario", "criterion")): row["margin_s"]
             for row in rows("delay_margin/margins.csv")}  # fmt: skip
    for name, scheme in (("LLC", ""), ("LLC-tuned", ""), ("ANFFsC", "indirect"), ("HBsWC", "direct")):
        pairs = [
            " / ".join(
                f"{float(found[name, scheme, scenario, criterion]):.3f}" for criterion in ("not_damped", "unstable")
            )
            for scenario in ("small", "large", "multiple")
        ]
        assert f"| {' | '.join(pairs)} |" in page, name


def test_rates_of_the_summary_are_those_of_the_pages() -> None:
    page = text("results")
    for percent in re.findall(r"(\d+\.\d\d) %", page):
        assert f"({percent} %" in text("supervision_results") or f"{percent} %" in str(
            rows("wrong_control/table_outcomes.csv") + rows("do_no_harm/table_outcomes.csv")
        ), percent


@pytest.mark.parametrize("row", rows("reference_llc.csv")[1::5], ids=lambda row: f"{row['system']} {row['scenario']}")
def test_reference_results_are_those_of_runs(row: dict[str, str]) -> None:
    sets = [f"system={row['system']}", f"scenario={row['scenario']}"]
    sets += ["controllers=[]"] if row["controller"] == "none" else [f"link.up.0.delay={row['delay_s']}"]
    found = summarise(loop.run(load_case(None, sets)))["indices"]
    for name in ("ITAE", "IAE", "ITSE", "ISE"):
        if row[name]:
            assert found[name] == pytest.approx(float(row[name]), rel=1e-3), name


def test_figures_are_drawn_from_the_tables(tmp_path: Path) -> None:
    for table in (DOCS / "images").glob("*/*.csv"):
        (tmp_path / table.parent.name).mkdir(exist_ok=True)
        shutil.copy(table, tmp_path / table.parent.name)
    result_figures.main(tmp_path)
    drawn = {path.name for path in (tmp_path / "results").iterdir()}
    assert drawn == {path.name for path in (DOCS / "images" / "results").iterdir()}
