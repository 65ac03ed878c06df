"""The comparison of the controllers: the page in the docs is what the command gives, and what it must show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from facts_damping.control.table import CONTROLLERS
from facts_damping.studies.compare import SYSTEMS, compare, page
from tests.studies.pages import assert_same_lines

PAGE = Path(__file__).parents[2] / "docs" / "comparison.md"
# Scenarios that stay in synchronism without control.
CALM = [("two_area", "small"), ("smib", "nominal"), ("smib", "light")]
# Rows that are not damped, or do not beat no control, after the search: findings (docs/controllers.md).
NOT_DAMPED: set[tuple[str, str, str, str]] = set()
NOT_BETTER: set[tuple[str, str, str, str]] = set()


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    return [row for system in SYSTEMS for row in compare(system, [], [], 2, lambda _done, _of: None)]


def place(row: dict[str, Any]) -> tuple[str, str, str, str]:
    return row["system"], row["scenario"], row["controller"], row["scheme"]


def test_all_controllers_are_there_in_both_schemes_on_all_scenarios(rows: list[dict[str, Any]]) -> None:
    networks = [name for name, row in CONTROLLERS.items() if row.network is not None]
    assert len(networks) == 11
    scenarios = {(row["system"], row["scenario"]) for row in rows}
    assert len(scenarios) == 7
    wanted: set[tuple[str, str | None]] = {(name, scheme) for name in networks for scheme in ("direct", "indirect")}
    wanted |= {("none", None), ("LLC", None), ("LLC-tuned", None), ("LQG", None)}
    for one in scenarios:
        assert {(r["controller"], r["scheme"]) for r in rows if (r["system"], r["scenario"]) == one} == wanted


def test_none_leaves_its_limits(rows: list[dict[str, Any]]) -> None:
    for row in rows:
        assert row["max_injected_voltage_pu"] <= 0.1 * (1 + 1e-9), place(row)


def test_every_adaptive_controller_damps_every_scenario_but_the_findings(rows: list[dict[str, Any]]) -> None:
    assert {place(row) for row in rows if row["scheme"] and not row["damped"]} == NOT_DAMPED


def test_the_lqg_damps_every_scenario_and_has_less_of_the_squares_than_lead_lags(rows: list[dict[str, Any]]) -> None:
    for system, scenario in {(row["system"], row["scenario"]) for row in rows}:
        own = {r["controller"]: r for r in rows if (r["system"], r["scenario"]) == (system, scenario)}
        assert own["LQG"]["damped"]
        assert own["LQG"]["indices"]["ISE"] < own["LLC"]["indices"]["ISE"]


def test_every_adaptive_controller_beats_no_control_but_the_findings(rows: list[dict[str, Any]]) -> None:
    worse = set()
    for system, scenario in CALM:
        own = [row for row in rows if (row["system"], row["scenario"]) == (system, scenario)]
        (none,) = [row for row in own if row["controller"] == "none"]
        assert none["stable"]
        worse |= {
            place(row)
            for row in own
            if row["scheme"]
            and not (row["stable"] and all(row["indices"][k] < none["indices"][k] for k in none["indices"]))
        }
    assert worse == NOT_BETTER


def test_the_page_in_the_docs_is_what_the_command_gives(rows: list[dict[str, Any]]) -> None:
    written = PAGE.read_text(encoding="utf-8").splitlines()
    assert_same_lines(written, page(rows)[:-1])  # the last line is empty


def test_changes_of_controllers_are_for_networks_only() -> None:
    changed = compare("smib", ["ANFTSC"], ["controllers.0.parameters.eta=0.0", "duration=3"], 1, lambda _a, _b: None)
    plain = compare("smib", ["ANFTSC"], ["duration=3"], 1, lambda _a, _b: None)
    assert len(changed) == len(plain) == 4 * 4
    same = {(one["controller"], one["scheme"]) for one, other in zip(changed, plain, strict=True) if one == other}
    assert same == {("none", None), ("LLC", None)}
