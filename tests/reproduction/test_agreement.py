"""Ours beside theirs: worlds where everything holds, nothing holds, or one cell differs."""

from __future__ import annotations

import csv
import io
import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import spearmanr

from facts_damping_reproduction.agreement import (
    ALL,
    ComparedRun,
    Figures,
    Statement,
    compare,
    contradictions,
    flat,
    markdown,
    signs,
    statements,
)
from facts_damping_reproduction.agreement import value_text as text_of
from facts_damping_reproduction.printed import DIRECT, LLC, Cell, ControllerId, cells
from facts_damping_reproduction.ranking import correlation, mean_ranks, rankings, totals

CELLS = cells()
Found = dict[ComparedRun, dict[str, float]]
INDIRECT = ControllerId("MISO", "ANFLeC", "indirect")


def as_printed() -> Found:
    """Figures that give every corrected cell: LLC's indices are 1, the others follow from the improvement over it."""
    figures: Found = {}
    for cell in CELLS:
        run = ComparedRun(cell.system, cell.scenario, cell.who)
        if cell.against is None:
            figures.setdefault(run, {})["roughness"] = cell.corrected
        elif cell.against == LLC:
            figures.setdefault(run, {})[cell.quantity] = 1 - cell.corrected / 100
            figures.setdefault(run._replace(who=LLC), {})[cell.quantity] = 1.0
    return figures


def reversed_cells() -> list[Cell]:
    """What would be printed if every statement were the other way round."""
    return [
        c._replace(printed=-c.printed, corrected=-c.corrected)
        if c.against is not None
        else c._replace(printed=1 / c.printed, corrected=1 / c.corrected)
        for c in CELLS
    ]


def stated(figures: Figures, cells_given: list[Cell] | None = None) -> list[Statement]:
    return statements(compare(cells_given or CELLS, figures))


def test_ours_is_the_cell_itself_where_the_runs_are_theirs() -> None:
    for c in compare(CELLS, as_printed()):
        assert c.ours is not None
        assert c.difference == pytest.approx(0, abs=0.11 if c.cell.against == DIRECT else 1e-9)
        assert c.ours - c.cell.corrected == c.difference


def test_improvement_is_4_109_and_a_roughness_stands_as_it_is() -> None:
    figures = as_printed()
    run = ComparedRun("smib", "heavy", INDIRECT)
    figures[run] |= {"ITAE": 3.0, "roughness": 7.0}
    figures[run._replace(who=LLC)]["ITAE"] = 4.0
    figures[run._replace(who=DIRECT)]["ITAE"] = 2.0
    ours = {
        (c.cell.quantity, c.cell.against): (c.figure, c.ours)
        for c in compare(CELLS, figures)
        if ComparedRun(c.cell.system, c.cell.scenario, c.cell.who) == run
    }
    assert ours["ITAE", LLC] == (3.0, 25.0)
    assert ours["ITAE", DIRECT] == (3.0, -50.0)
    assert ours["roughness", None] == (7.0, 7.0)


def test_thesis_agrees_with_itself() -> None:
    stated_here = stated(as_printed())
    assert contradictions(stated_here) == []
    rows = signs(stated_here)
    assert all(row.fraction == 1.0 and row.missing == 0 for row in rows)
    assert {(row.table, row.what): row.statements for row in rows} == {
        ("4.1", "improvement"): 336,
        ("4.2", "improvement"): 252,
        ("5.1", "improvement"): 352,
        ("5.2", "smoother than LLC"): 4 * 22,
        ("5.2", "smoother than direct"): 4 * 11,
        ("5.3", "improvement"): 264,
        ("5.4", "smoother than LLC"): 3 * 22,
        ("5.4", "smoother than direct"): 3 * 11,
        ("6.1", "smoother than MISO"): 3 * 4,
        ("6.1", "smoother than LLC"): 3 * 3,
        ("6.2", "improvement"): 84,
        (ALL, "improvement"): 1288,
        (ALL, "smoother than LLC"): 163,
        (ALL, "smoother than direct"): 77,
        (ALL, "smoother than MISO"): 12,
        (ALL, ALL): 1540,
    }


def test_thesis_turned_round_agrees_nowhere() -> None:
    stated_here = stated(as_printed(), reversed_cells())
    assert [row.fraction for row in signs(stated_here)] == [0.0] * 16
    assert len(contradictions(stated_here)) == len(stated_here) == 1540


def test_roughness_claims_of_the_thesis_itself() -> None:
    """Of figures 5.39 and 6.22 by hand."""
    sizes_stated = {(s.table, s.scenario, s.controller, s.scheme, s.what): s.theirs for s in stated(as_printed())}
    indirect = sizes_stated["5.4", "multiple", "HBsWC", "indirect", "smoother than direct"]
    assert indirect == pytest.approx(100 * (70.535 - 69.173) / 70.535)
    direct = sizes_stated["5.4", "multiple", "HBsWC", "direct", "smoother than LLC"]
    assert direct == pytest.approx(100 * (7.827 - 70.535) / 7.827)
    assert sizes_stated["6.1", "multiple", "LLC", "", "smoother than MISO"] == pytest.approx(
        100 * (7.827 - 14.94) / 7.827
    )
    assert sizes_stated["6.1", "small", "HBsWC", "indirect", "smoother than MISO"] > 0


@pytest.mark.parametrize("seed", range(5))
def test_single_differing_cell_is_the_only_contradiction(seed: int) -> None:
    rng = np.random.default_rng(seed)
    changed_cells = list(CELLS)
    i = int(rng.choice([i for i, c in enumerate(changed_cells) if c.against is not None]))
    changed_cells[i] = changed_cells[i]._replace(
        corrected=-changed_cells[i].corrected, printed=-changed_cells[i].printed
    )
    (row,) = contradictions(stated(as_printed(), changed_cells))
    assert (row.table, row.scenario, row.controller, row.quantity) == (
        changed_cells[i].table,
        changed_cells[i].scenario,
        changed_cells[i].controller,
        changed_cells[i].quantity,
    )
    assert row.theirs == changed_cells[i].corrected
    assert row.ours == pytest.approx(-changed_cells[i].corrected, abs=0.11)
    assert sum(s.statements - s.agree for s in signs(stated(as_printed(), changed_cells))) == 3  # table, kind, all


def test_slip_whose_sign_is_wrong_counts_in_one_reading_only() -> None:
    changed_cells = [c._replace(printed=-c.printed) if c.reason else c for c in CELLS]
    last = signs(stated(as_printed(), changed_cells))[-1]
    assert (last.agree, last.agree_as_printed) == (1540, 1540 - 25)
    assert last.fraction_as_printed == pytest.approx(1515 / 1540)


def test_unstable_run_contradicts_everything_that_is_said_of_it() -> None:
    run = ComparedRun("smib", "light", INDIRECT)
    figures: Figures = {**as_printed(), run: None}
    stated_here = stated(figures)
    said = contradictions(stated_here)
    assert all(s.ours is None and not s.agrees for s in said)
    assert {(s.scenario, s.controller, s.scheme) for s in said} == {("light", "ANFLeC", "indirect")}
    assert len(said) == 8 + 2
    assert signs(stated_here)[-1].missing == 10
    ranked = [r for r in rankings(compare(CELLS, figures)) if r.missing]
    assert {(r.table, r.quantity, r.scenario) for r in ranked} == {
        (table, q, "light")
        for table, names in (("5.1", ("ITAE", "IAE", "ITSE", "ISE")), ("5.2", ("roughness",)))
        for q in names
    }
    assert all(r.ours[r.controllers.index("ANFLeC")] == 11 and r.missing == ("ANFLeC",) for r in ranked)


def test_run_that_is_not_converged_has_no_place_in_an_order() -> None:
    figures, run = as_printed(), ComparedRun("smib", "light", INDIRECT)
    plain, without = (rankings(compare(CELLS, figures, frozenset(unsure))) for unsure in ([], [run]))
    shorter = [(a, b) for a, b in zip(plain, without, strict=True) if a != b]
    assert {(b.table, b.scenario) for _, b in shorter} == {("5.1", "light"), ("5.2", "light")}
    for before, after in shorter:
        assert set(before.controllers) - set(after.controllers) == {"ANFLeC"}
        assert after.rho == pytest.approx(1.0)
        assert sorted(after.ours) == [*range(1, 11)] or len(set(after.ours)) < 10


def test_without_the_reference_nothing_can_be_said_but_the_order_is_known() -> None:
    figures: Figures = {k: None if k.who == LLC else v for k, v in as_printed().items()}
    over = [s for s in stated(figures) if s.over == "MISO LLC"]
    assert over
    assert all(s.ours is None for s in over)
    assert all(r.rho == pytest.approx(1.0) for r in rankings(compare(CELLS, figures)))


def test_figure_that_is_no_number_is_missing_and_a_run_that_was_not_made_is_an_error() -> None:
    figures = as_printed()
    figures[ComparedRun("smib", "light", INDIRECT)]["ITAE"] = math.nan
    missing = [c.cell for c in compare(CELLS, figures) if c.ours is None]
    assert {(c.scenario, c.who, c.quantity) for c in missing} == {("light", INDIRECT, "ITAE")}
    del figures[ComparedRun("smib", "light", INDIRECT)]
    with pytest.raises(KeyError, match="ANFLeC"):
        compare(CELLS, figures)


def test_orders_of_the_thesis_are_its_own() -> None:
    orders = rankings(compare(CELLS, as_printed()))
    sizes = {"4.1": 16, "4.2": 12, "5.1": 16, "5.2": 8, "5.3": 12, "5.4": 6, "6.1": 3, "6.2": 12}
    assert {t.table: t.rankings for t in totals(orders)} == {**sizes, "all": 85}
    assert all(len(r.controllers) == (4 if r.table in ("6.1", "6.2") else 11) for r in orders)
    assert all(r.rho == pytest.approx(1.0) and not r.far and r.same_best and r.same_two for r in orders)
    last = totals(orders)[-1]
    assert (last.same_best, last.same_second, last.same_two, last.far) == (85, 85, 85, 0)
    assert last.mean_rho == pytest.approx(1.0)
    assert all(
        r.p is not None and (r.p < 1e-3 if len(r.controllers) == 11 else r.p == pytest.approx(2 / 24)) for r in orders
    )


def test_best_and_second_by_hand() -> None:
    orders = {(r.table, r.scenario, r.quantity, r.scheme): r for r in rankings(compare(CELLS, as_printed()))}
    first = orders["5.1", "nominal", "ITAE", "indirect"]
    assert (first.best, first.second) == (("HBsWC",), ("ANFLeWC",))  # by the corrected 69.90, printed are 68.32
    assert orders["5.2", "multiple", "roughness", "direct"].best == ("ANFTrMeC",)
    assert orders["6.2", "small", "ISE", "indirect"].controllers == ("HBsWC", "ANFLeWC", "ANFTSC", "LLC")
    means = mean_ranks(list(orders.values()))
    hbs = next(m for m in means if (m.table, m.quantity, m.controller) == ("4.2", "ITAE", "HBsWC"))
    assert hbs.theirs == hbs.ours == 1.0
    assert sum(m.theirs for m in means if (m.table, m.quantity) == ("4.1", "IAE")) == 66


def test_controller_far_from_its_place_is_named_and_ties_share_it() -> None:
    figures = as_printed()
    figures[ComparedRun("two_area", "large", ControllerId("MISO", "HBsWC", "direct"))]["ITAE"] = 0.99
    changed = [r for r in rankings(compare(CELLS, figures)) if r.rho != pytest.approx(1.0)]
    (r,) = changed
    assert (r.table, r.scenario, r.quantity) == ("4.2", "large", "ITAE")
    assert r.far == ("HBsWC (1, ours 11)",)
    assert not r.same_best
    assert r.best_ours == ("ANFLeWC",)
    equal = {k: {**v, "ITAE": 1.0} for k, v in figures.items()}
    flatly = next(r for r in rankings(compare(CELLS, equal)) if r.quantity == "ITAE")
    assert (flatly.rho, flatly.p, set(flatly.ours)) == (None, None, {6.0})


@given(order=st.permutations(range(1, 12)))
def test_rank_correlation_is_the_formula_without_ties(order: list[int]) -> None:
    d2 = sum((a - b) ** 2 for a, b in zip(range(1, 12), order, strict=True))
    rho, p = correlation([float(k) for k in range(1, 12)], [float(k) for k in order])
    assert rho == pytest.approx(1 - 6 * d2 / (11 * (11**2 - 1)))
    assert p is not None
    assert 0 < p <= 1


@pytest.mark.parametrize("order", [(1, 2, 3, 5, 4, 6), (6, 4, 5, 3, 1, 2), (3, 1, 6, 4, 2, 5)])
def test_p_of_few_is_the_share_of_all_orders_that_are_as_far_from_zero(order: tuple[int, ...]) -> None:
    def rho(b: tuple[int, ...]) -> float:
        return 1 - 6 * sum((i - k) ** 2 for i, k in enumerate(b, start=1)) / (6 * 35)

    everybody = [rho(b) for b in itertools.permutations(range(1, 7))]
    low, high = (np.mean([sign * x >= sign * rho(order) - 1e-9 for x in everybody]) for sign in (-1, 1))
    coefficient, p = correlation([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [float(k) for k in order])
    assert coefficient == pytest.approx(rho(order))
    assert p == pytest.approx(min(1.0, 2 * min(low, high)))


def test_p_of_eleven_is_near_that_of_the_t_distribution_and_the_same_each_time() -> None:
    places = [float(k) for k in range(1, 12)]
    other = [1.0, 2.0, 8.0, 4.0, 3.0, 6.0, 11.0, 5.0, 9.0, 10.0, 7.0]
    rho, p = correlation(places, other)
    assert p == pytest.approx(spearmanr(places, other).pvalue, abs=0.01)
    assert correlation(places, other) == (rho, p)
    assert correlation(places, places[::-1])[0] == pytest.approx(-1.0)


def test_rows_go_into_markdown_csv_and_json() -> None:
    compared = compare(CELLS, as_printed())
    stated_here = statements(compared)
    for rows in (compared, stated_here, signs(stated_here), rankings(compared), totals(rankings(compared))):
        flattened = [flat(row) for row in rows]
        text = io.StringIO()
        writer = csv.DictWriter(text, list(flattened[0]))
        writer.writeheader()
        writer.writerows({field: text_of(value) for field, value in row.items()} for row in flattened)
        text.seek(0)
        assert len(list(csv.DictReader(text))) == len(rows)
        assert len(json.loads(json.dumps(flattened, allow_nan=False))) == len(rows)
    assert text_of(("HBsWC", "ANFLeWC")) == "HBsWC, ANFLeWC"
    lines = markdown(compared[:2], ["controller", "against", "reason"], ["printed", "ours"])
    assert lines[0] == "| controller | against | reason | printed | ours |"
    assert lines[2] == "| ANFTSC | MISO LLC |  | 47.01 | 47.01 |"
    assert markdown(signs(stated_here)[-1:], ["what"], ["agree", "fraction"], ".1%")[2] == "| all | 1540 | 100.0% |"
